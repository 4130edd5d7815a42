"""The kinematic stream: a learned residual on analytic rigid-body kinematics, filtered from noisy measurements."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from owm.checkpoint import positive
from owm.data.windows import Episodes
from owm.model.config import ModelConfig
from owm.model.transformer import MLP
from owm.motion.kinematics import (
    advance,
    apply_inverse,
    motion_error,
    multiply,
    rotation,
    to_motion,
    to_station,
    to_view,
)
from owm.motion.linear import LinearMap, fit_linear_map
from owm.motion.track import LOCAL_LEVEL, Filter, Track, displacement, follow, innovation_variance, next_gain
from owm_envs.view import View


class Statistics(NamedTuple):
    """What is measured on the training episodes once and held fixed.

    Attributes:
        linear: the least-squares map under the network.
        filter: what measurements are filtered with, of the stream's `Filter`.
        action_scale: root mean square of each action component.
        position_scale: root mean square of station-frame position, m.
        velocity_scale: root mean square of velocity, m/s.
        rate_scale: root mean square of body rate, rad/s.
    """

    linear: LinearMap
    filter: Any
    action_scale: Float[Array, "6"]
    position_scale: Float[Array, ""]
    velocity_scale: Float[Array, ""]
    rate_scale: Float[Array, ""]


class KinematicStream(eqx.Module):
    """A learned residual on analytic kinematics: one token, whose residual is the innovation of the next measurement.

    The carry is a filtered motion relative to the pose at the start of the window, and what the filter knows of the
    sensors. The network never sees that arbitrary frame: it gets velocity and rate in the body frame, on which thrust
    and gyroscopic terms depend, and position, velocity and attitude in the station frame, on which orbital terms
    depend. So nothing it sees grows with the distance from the anchor.

    The residual is how far the next measurement is from the linear map's prediction, in the body frame and in units
    of the filter's. A sample of it is a sample of the measurement, and moves the estimate as a measurement would:
    sampled tracks are to the network what measured ones are, and their noise does not add up. Its expectation moves
    velocity and rate alone, as increments of a step: position and attitude follow by kinematics.
    """

    encoder: MLP
    variant: "Variant" = eqx.field(static=True)
    token_count: ClassVar[int] = 1
    residual_size: ClassVar[int] = 12

    def __init__(self, variant: "Variant", config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        self.encoder = MLP(variant.features, 2 * config.width, config.width, dtype, key=key)
        self.variant = variant

    @property
    def filter(self) -> Filter:
        """What measurements are filtered with."""
        return self.variant.filter

    def follow(
        self,
        statistics: Statistics,
        observation: Float[Array, "T 13"],
        action: Float[Array, "T-1 6"],
        valid: Bool[Array, "T"],
        dt: float,
    ) -> Track:
        """Return the tracks at all measurements of a window, stacked."""
        return follow(self.filter, statistics.filter, statistics.linear, observation, action, valid, dt)

    def observe(
        self, statistics: Statistics, track: Track, action: Float[Array, "6"], view: Float[Array, "13"], dt: float
    ) -> Track:
        """Return the track after an action and the measurement that followed it."""
        return self.filter.observe(statistics.filter, statistics.linear, track, action, view, dt)

    def tokens(self, statistics: Statistics, track: Track) -> Float[Array, "1 d"]:
        """Return the token of a track."""
        return self.encoder(self.variant.inputs(statistics, track))

    def target(
        self, statistics: Statistics, before: Track, after: Track, action: Float[Array, "6"], dt: float
    ) -> Float[Array, "1 12"]:
        """Return the unit-variance residual that leads from a track to the view of the next one."""
        change, drift = self.filter.increment(statistics.linear, before, action)
        away = displacement(advance(before.motion, change, dt, drift), after.view)
        return (away / self.filter.scale(statistics.filter, before, action))[None]

    def change_loss(
        self, statistics: Statistics, before: Track, after: Track, action: Float[Array, "6"], dt: float
    ) -> Float[Array, ""]:
        """Return zero: the map under the network is not trained."""
        return jnp.zeros((), action.dtype)

    def advance(
        self,
        statistics: Statistics,
        track: Track,
        residual: Float[Array, "1 12"],
        action: Float[Array, "6"],
        dt: float,
        *,
        sampled: bool,
    ) -> Track:
        """Advance the track by one step under a sampled (or measured) residual, or under the expected one."""
        change, drift = self.filter.increment(statistics.linear, track, action)
        if sampled:
            predicted = advance(track.motion, change, dt, drift)
            after = self.filter.correct(statistics.filter, track, action, predicted, residual[0])
            return self.variant.then(after, action)
        away = self.filter.scale(statistics.filter, track, action) * residual[0]
        motion = advance(track.motion, change + jnp.concatenate([away[3:6], away[9:]]), dt, drift)
        after = track._replace(motion=motion, view=motion, innovation=jnp.zeros_like(track.innovation))
        return self.variant.then(after, action)

    def decode(self, statistics: Statistics, track: Track) -> dict[str, Array]:
        """Read out what the sensors show."""
        return {"state": to_view(track.view)}

    def decode_loss(self, statistics: Statistics, track: Track, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare a prediction with a measurement: quadratic up to three innovations of an axis, linear beyond."""
        error = motion_error(track.view, to_motion(view, track.view.anchor))
        # What counts is what grows beyond the noise, however small that is.
        return jnp.mean(jnp.sqrt(1.0 + error / (9.0 * innovation_variance(statistics.filter, track))) - 1.0)

    def round_trip_loss(self, statistics: Statistics, track: Track, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Return zero: nothing is lost on the way from view to track and back."""
        return jnp.zeros((), view.dtype)


@dataclass(frozen=True)
class Variant:
    """What kinematic streams of one name have of their own; makes and fits them.

    Attributes:
        filter: what measurements are filtered with.
        features: how many numbers a token is made of.
        inputs: those numbers (1, features), of statistics and track.
        then: the track after a step under an action, of the track that the filter gives.
    """

    filter: Filter
    features: int
    inputs: Callable[[Statistics, Track], Float[Array, "1 f"]]
    then: Callable[[Track, Float[Array, "6"]], Track]

    def __call__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]) -> KinematicStream:
        """Draw the initial weights of one."""
        return KinematicStream(self, config, dtype, key=key)

    def fit(self, episodes: Episodes) -> Statistics:
        """Measure the statistics on training episodes."""
        linear = fit_linear_map(episodes)

        def size(x: np.ndarray, axis: int | None = None) -> Array:
            mean = np.mean(np.square(x, dtype=np.float64), axis=axis)
            return jnp.asarray(np.maximum(np.sqrt(mean), 1e-9), episodes.view.dtype)

        position, velocity, _, rate = View.of(episodes.view)
        return Statistics(
            linear,
            self.filter.fit(episodes, linear),
            size(episodes.action, 0),
            size(position),
            size(velocity),
            size(rate),
        )

    def skeleton(self, dtype: jnp.dtype) -> Statistics:
        """Return the shapes of the statistics."""
        scales = (positive(shape, dtype) for shape in ((6,), (), (), ()))
        return Statistics(LinearMap.skeleton(dtype), self.filter.skeleton(dtype), *scales)


def motion_inputs(statistics: Statistics, track: Track) -> Float[Array, "1 41"]:
    """Return what the token is made of, each of order one and blind to the sign of q."""
    motion = track.motion
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
            # Bounded, for sensors unlike any of the training episodes.
            5.0 * jnp.tanh(track.innovation / 5.0),
            jnp.tanh(0.25 * jnp.log(track.noise / statistics.filter.noise)),
            next_gain(statistics.filter, track),
        ]
    )[None]


def _as_it_is(track: Track, action: Float[Array, "6"]) -> Track:
    return track


KINEMATIC = Variant(LOCAL_LEVEL, 41, motion_inputs, _as_it_is)
"""For one vehicle: what its actions do is measured once, on the training episodes."""
