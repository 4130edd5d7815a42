"""The kinematic stream: a learned residual on analytic rigid-body kinematics."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from owm.data import Episodes
from owm.model.config import ModelConfig
from owm.model.kinematics import (
    Motion,
    advance,
    apply_inverse,
    increments,
    motion_error,
    multiply,
    rotation,
    to_motion,
    to_station,
    to_view,
)
from owm.model.linear import LinearMap, fit_linear_map, linear_increment, transitions
from owm.model.transformer import Perceptron


class Statistics(NamedTuple):
    """What is measured on the training episodes once and held fixed.

    Attributes:
        linear: the least-squares map under the network.
        residual_scale: standard deviation of what the map leaves, per component.
        action_scale: root mean square of each action component.
        position_scale: root mean square of station-frame position, m.
        velocity_scale: root mean square of velocity, m/s.
        rate_scale: root mean square of body rate, rad/s.
    """

    linear: LinearMap
    residual_scale: Float[Array, "6"]
    action_scale: Float[Array, "6"]
    position_scale: Float[Array, ""]
    velocity_scale: Float[Array, ""]
    rate_scale: Float[Array, ""]


class KinematicStream(eqx.Module):
    """A learned residual on analytic kinematics: one token, whose residual is a body-frame velocity and rate increment.

    The carry is the motion relative to the pose at the start of the window. The network never sees that arbitrary
    frame: it gets velocity and rate in the body frame, on which thrust and gyroscopic terms depend, and position,
    velocity and attitude in the station frame, on which orbital terms depend. So nothing it sees grows with the
    distance from the anchor, and the anchor may move whenever a measurement arrives.
    """

    encoder: Perceptron
    token_count: ClassVar[int] = 1
    residual_size: ClassVar[int] = 6
    features: ClassVar[int] = 21
    loss_units: ClassVar[tuple[float, ...]] = (0.1, 0.01, 0.005, 0.001)
    """Position m, velocity m/s, attitude rad and rate rad/s that weigh alike in the decode loss."""

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        self.encoder = Perceptron(self.features, 2 * config.width, config.width, dtype, key=key)

    @staticmethod
    def fit(episodes: Episodes) -> Statistics:
        """Measure the statistics on training episodes."""
        linear = fit_linear_map(episodes)
        before, after, action = transitions(episodes)
        unit = jnp.ones(6, before.dtype)

        def residual(before: Array, after: Array, action: Array) -> Array:
            first = to_motion(before, before)
            increment, drift = linear_increment(linear, first, action)
            return increments(first, to_motion(after, before), episodes.dt, drift) - increment

        left = np.asarray(jax.jit(jax.vmap(residual))(before, after, action), np.float64)
        before, action = np.asarray(before, np.float64), np.asarray(action, np.float64)

        def size(x: np.ndarray, axis: int | None = None) -> Array:
            return jnp.asarray(np.maximum(np.sqrt(np.mean(x * x, axis=axis)), 1e-9), unit.dtype)

        return Statistics(
            linear, size(left, 0), size(action, 0), size(before[:, :3]), size(before[:, 3:6]), size(before[:, 10:])
        )

    @staticmethod
    def skeleton(dtype: jnp.dtype) -> Statistics:
        """Return the shapes of the statistics."""
        linear = LinearMap(*(jax.ShapeDtypeStruct(shape, dtype) for shape in ((6, 6), (6,), (3, 6))))
        return Statistics(linear, *(jax.ShapeDtypeStruct(shape, dtype) for shape in ((6,), (6,), (), (), ())))

    def start(self, statistics: Statistics, view: Float[Array, "13"], anchor: Float[Array, "13"]) -> Motion:
        """Return the motion of a measured view in a window that starts at `anchor`."""
        return to_motion(view, anchor)

    def observe(self, statistics: Statistics, motion: Motion, view: Float[Array, "13"]) -> Motion:
        """Return the motion of a new measurement, which becomes the anchor."""
        return to_motion(view, view)

    def tokens(self, statistics: Statistics, motion: Motion) -> Float[Array, "1 d"]:
        """Return the token of a motion."""
        return self.encoder(self.inputs(statistics, motion))

    @staticmethod
    def inputs(statistics: Statistics, motion: Motion) -> Float[Array, "1 21"]:
        """Return what the token is made of, each of order one and blind to the sign of q."""
        position, velocity, _ = to_station(motion)
        turn = rotation(multiply(motion.anchor[3:], motion.attitude))
        body_velocity = apply_inverse(turn, velocity)
        return jnp.concatenate(
            [
                body_velocity / statistics.velocity_scale,
                motion.rate / statistics.rate_scale,
                velocity / statistics.velocity_scale,
                position / statistics.position_scale,
                turn.reshape(9),
            ]
        )[None]

    def target(
        self, statistics: Statistics, before: Motion, after: Motion, action: Float[Array, "6"], dt: float
    ) -> Float[Array, "1 6"]:
        """Return the unit-variance residual that leads from one measured motion to the next."""
        increment, drift = linear_increment(statistics.linear, before, action)
        return ((increments(before, after, dt, drift) - increment) / statistics.residual_scale)[None]

    def advance(
        self,
        statistics: Statistics,
        motion: Motion,
        residual: Float[Array, "1 6"],
        action: Float[Array, "6"],
        dt: float,
    ) -> Motion:
        """Advance the carry by one step under a predicted residual."""
        increment, drift = linear_increment(statistics.linear, motion, action)
        return advance(motion, increment + statistics.residual_scale * residual[0], dt, drift)

    def decode(self, statistics: Statistics, motion: Motion) -> dict[str, Array]:
        """Read the motion out."""
        return {"state": to_view(motion)}

    def decode_loss(self, statistics: Statistics, motion: Motion, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare a prediction with a measurement: quadratic for small errors, linear for large ones, in loss units."""
        units = jnp.asarray(self.loss_units, motion.rate.dtype)
        error = motion_error(motion, to_motion(view, motion.anchor))
        return jnp.mean(jnp.sqrt(1.0 + error / units**2) - 1.0)

    def round_trip_loss(self, statistics: Statistics, motion: Motion, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Return zero: nothing is lost on the way from view to motion and back."""
        return jnp.zeros((), motion.rate.dtype)
