"""Relative navigation: what the chaser measures of its true relative view, and its error to the goal."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int, Key

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_multiply, quat_to_rotation_vector
from astrojax.compilation import stored
from owm_envs.config.params import NavigationParams, NoiseParams
from owm_envs.task.events import safe_norm
from owm_envs.task.noise_stream import standard_normal, standard_uniform
from owm_envs.task.reset import named_key
from owm_envs.task.sensors import STATE, TARGET_RATE, Measurement, Truth
from owm_envs.view import VIEW_SIZE, View


@dataclass(frozen=True)
class RelativeNavigation:
    """The sensor that every chaser has: its relative view, m, m/s, quaternion and rad/s, with the configured errors.

    Where it is quiet the last view is shown again, and `state_valid` beside it is false. The first always comes.
    """

    dtype: str
    """The environment's precision."""
    steps_per_action: int
    may_miss: bool
    """Whether it goes quiet."""
    heavy_tailed: bool
    """Whether it has outliers."""
    name: ClassVar[str] = STATE
    shape: ClassVar[tuple[int, ...]] = (VIEW_SIZE,)
    every: ClassVar[int] = 1

    def measure(self, key: Key[Array, ""], truth: Truth) -> Float[Array, "13"] | Measurement:
        """The measured view; its errors, and when there is none, come from `truth.stream`, not from `key`."""
        params, stream, count = truth.params, truth.stream, truth.count
        factor = outlier_factor(params.navigation, key=stream, count=count) if self.heavy_tailed else None
        view = measure(params.noise, truth.view, truth.bias, factor, key=stream, count=count)
        return Measurement(view, _comes(truth, self.steps_per_action)) if self.may_miss else view


def _comes(truth: Truth, steps_per_action: int) -> Bool[Array, ""]:
    """Whether relative navigation measures at this instant."""
    params, count = truth.params, truth.count
    elapsed = count * (params.dt * steps_per_action)
    return (count == 0) | ~is_quiet(params.navigation, elapsed, key=truth.stream)


def is_quiet(navigation: NavigationParams, elapsed: Float[Array, ""], *, key: Key[Array, ""]) -> Bool[Array, ""]:
    """Whether relative navigation is quiet `elapsed` seconds into an episode.

    Time is cut into periods of duration over share, the first of which began at a random moment before the episode.
    In each is one outage, at a random place. So navigation is quiet at every instant with the same probability, and
    nobody can tell from an outage when the next one comes but for its being in the next period.

    Args:
        key: of the episode's sensor errors.
    """
    key = named_key(key, "outages")
    share = navigation.outage_share
    now = stored(elapsed * (share / navigation.outage_duration)) + standard_uniform(key, 0).astype(share.dtype)
    period = jnp.floor(now)
    begins = (1 - share) * standard_uniform(key, 1 + period.astype(jnp.uint32)).astype(share.dtype)
    since = now - period - begins
    return (since >= 0) & (since < share)


def outlier_factor(
    navigation: NavigationParams, *, key: Key[Array, ""], count: Int[Array, ""] | int
) -> Float[Array, ""]:
    """By what the white errors of a measurement are larger: 1, or now and then `outlier_scale`.

    Errors are then of a contaminated normal distribution. Source: Tukey (1960), A survey of sampling from
    contaminated distributions; Huber (1964), Robust estimation of a location parameter, Ann. Math. Statist. 35, 73.

    Args:
        key, count: which measurement of which stream of errors.
    """
    outlier = standard_uniform(named_key(key, "outliers"), count) < navigation.outlier_share
    return jnp.where(outlier, navigation.outlier_scale, jnp.ones_like(navigation.outlier_scale))


@dataclass(frozen=True)
class TargetRate:
    """The rate of a target that turns, rad/s in its own axes, with the error of the chaser's own measured rate.

    It is quiet when relative navigation is.
    """

    steps_per_action: int
    may_miss: bool
    """Whether it goes quiet."""
    name: ClassVar[str] = TARGET_RATE
    shape: ClassVar[tuple[int, ...]] = (3,)
    dtype: ClassVar[str] = "float32"
    every: ClassVar[int] = 1

    def measure(self, key: Key[Array, ""], truth: Truth) -> Float[Array, "3"] | Measurement:
        """The measured rate."""
        spread = truth.params.noise.rate.astype(jnp.float32) / np.sqrt(3, dtype=np.float32)
        rate = truth.params.target_rate.astype(jnp.float32) + spread * jax.random.normal(key, (3,), jnp.float32)
        return Measurement(rate, _comes(truth, self.steps_per_action)) if self.may_miss else rate


def start_bias(dtype: DTypeLike, *, key: Key[Array, ""]) -> Float[Array, "4 3"]:
    """A time-correlated error of unit variance per axis at the start of an episode: already stationary."""
    return jax.random.normal(key, (4, 3), jnp.float32).astype(dtype)


def advance_bias(
    bias: Float[Array, "4 3"], correlation_time: Float[Array, ""], dt: Float[Array, ""], *, key: Key[Array, ""]
) -> Float[Array, "4 3"]:
    """The time-correlated error `dt` seconds later: exact for a first-order Gauss-Markov process at any step.

    Source: Gelb, Applied Optimal Estimation (1974), sec. 3.6 and 3.8.
    """
    lapse = dt / correlation_time
    fresh = -jnp.expm1(-2 * lapse)
    moving = fresh > 0
    spread = jnp.where(moving, jnp.sqrt(jnp.where(moving, fresh, 1)), 0)
    return jnp.exp(-lapse) * bias + spread * start_bias(bias.dtype, key=key)


def measure(
    noise: NoiseParams,
    view: View,
    bias: Float[Array, "4 3"] | None = None,
    factor: Float[Array, ""] | None = None,
    *,
    key: Key[Array, ""],
    count: Int[Array, ""] | int = 0,
) -> Float[Array, "13"]:
    """Corrupt a true relative view by isotropic Gaussian errors of the given total root-mean-square sizes.

    The attitude error is a rotation in body axes. Source: paper, table of sensor noise models.

    Args:
        bias: time-correlated error of unit variance per axis: position, velocity, attitude, rate; none when None.
        factor: of the white errors' sizes, as `outlier_factor` gives it; 1 when None.
        key, count: which error of which stream, as for `standard_normal`.
    """
    total = jnp.stack(
        [
            noise.position + noise.position_per_range * safe_norm(view.position),
            noise.velocity,
            noise.attitude,
            noise.rate,
        ]
    )
    if factor is not None:
        total = factor * total
    # Seven digits are plenty for an error, its rotation too.
    errors = _per_axis(total)[:, None].astype(jnp.float32) * standard_normal(key, count, 12, jnp.float32).reshape(4, 3)
    if bias is not None:
        errors = errors + (_per_axis(jnp.stack(noise.bias[:4]))[:, None] * bias).astype(jnp.float32)
    dtype = view.position.dtype
    turn = quat_from_rotation_vector(errors[2]).astype(dtype)
    errors = stored(errors.astype(dtype))
    return stored(
        jnp.concatenate(
            [
                view.position + errors[0],
                view.velocity + errors[1],
                quat_multiply(view.attitude, turn),
                view.rate + errors[3],
            ]
        )
    )


def _per_axis(total: Float[Array, "4"]) -> Float[Array, "4"]:
    return total / jnp.sqrt(jnp.asarray(3, total.dtype))


def goal_error(view: Float[Array, "13"], goal: Float[Array, "7"]) -> Float[Array, "12"]:
    """Error of a relative view to a hold pose at rest.

    Returns:
        Position m and velocity m/s (view minus goal, station frame), rotation vector rad from the view's to the
        goal's attitude (body axes, shortest turn whatever the quaternions' signs), body rate rad/s.
    """
    view = View.of(view)
    turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(view.attitude), goal[3:]))
    return jnp.concatenate([view.position - goal[:3], view.velocity, turn, view.rate])
