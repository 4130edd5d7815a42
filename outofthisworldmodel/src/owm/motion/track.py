"""A motion followed through noisy measurements: the estimate that predictions start from, and how noisy it all is.

Every quantity (position, velocity, attitude, rate) is filtered by itself with a scalar gain, as in the local level
model: the truth is what the prior says but for a step of variance `process`, the measurement adds noise of variance
one. The unit, the noise of one axis, is estimated along the way, so that one model serves sensors of any quality and
what the network sees and predicts is of order one for each.

Source: Durbin and Koopman (2012), Time series analysis by state space methods, sec. 2.2 (local level model).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_to_rotation_vector
from owm.checkpoint import LARGEST, Within, positive
from owm.data.windows import Episodes
from owm.motion.kinematics import Motion, advance, apply, apply_inverse, multiply, rotation, to_motion
from owm.motion.linear import LinearMap, linear_increment

FIT_VIEWS, FIT_WINDOWS = 24, 512
"""Length and most windows that a fit uses."""
PROCESS = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0)
"""Process variances to choose from, in units of the measurement's."""
PRIOR_COUNT = 0.05
"""Measurements that the prior of the noise is worth."""
MEMORY = 16
"""Measurements over which the noise is averaged."""
_Statistics = TypeVar("_Statistics")


class FilterStatistics(NamedTuple):
    """What is measured on the training episodes; one number for position, velocity, attitude and rate each.

    Attributes:
        process: variance of the truth's steps, in units of the measurement noise's.
        noise: measurement variance of an axis before anything is seen: m2, (m/s)2, rad2, (rad/s)2.
        shape: root mean square of each of the 12 innovations in their nominal deviations.
    """

    process: Float[Array, "4"]
    noise: Float[Array, "4"]
    shape: Float[Array, "12"]

    @classmethod
    def skeleton(cls, dtype: jnp.dtype) -> "FilterStatistics":
        """Return the shapes."""
        return cls(Within((4,), dtype, 0.0, LARGEST), positive((4,), dtype, 1e-20), positive((12,), dtype))


class Track(NamedTuple):
    """Where a motion stands.

    Attributes:
        motion: the estimate.
        view: what the sensors show, measured or sampled; the estimate itself where it was only predicted.
        gain: the estimate's variance in units of the measurement's: one after a single measurement.
        noise: estimated measurement variance of an axis, as in `FilterStatistics`.
        count: innovations seen.
        innovation: how far the last view was from its prediction, of unit variance; zero if there was none.
    """

    motion: Motion
    view: Motion
    gain: Float[Array, "4"]
    noise: Float[Array, "4"]
    count: Float[Array, ""]
    innovation: Float[Array, "12"]


def displace(motion: Motion, by: Float[Array, "12"]) -> Motion:
    """Move a motion by position, velocity, rotation vector and rate, all in its body frame."""
    turn = rotation(motion.attitude)
    attitude = multiply(motion.attitude, quat_from_rotation_vector(by[6:9]))
    return Motion(
        anchor=motion.anchor,
        position=motion.position + apply(turn, by[:3]),
        velocity=motion.velocity + apply(turn, by[3:6]),
        attitude=attitude * (1.5 - 0.5 * jnp.sum(attitude**2)),
        rate=motion.rate + by[9:],
    )


def displacement(motion: Motion, other: Motion) -> Float[Array, "12"]:
    """Return what `displace` needs to reach another motion of the same anchor."""
    turn = rotation(motion.attitude)
    return jnp.concatenate(
        [
            apply_inverse(turn, other.position - motion.position),
            apply_inverse(turn, other.velocity - motion.velocity),
            quat_to_rotation_vector(multiply(quat_conjugate(motion.attitude), other.attitude)),
            other.rate - motion.rate,
        ]
    )


def start_track(statistics: FilterStatistics, motion: Motion) -> Track:
    """Return the track of a first measurement."""
    zero = jnp.zeros((12,), motion.rate.dtype)
    return Track(motion, motion, jnp.ones_like(zero[:4]), statistics.noise, zero[0], zero)


def next_gain(statistics: FilterStatistics, track: Track) -> Float[Array, "4"]:
    """Return the share of the next innovation that the estimate will take over."""
    variance = track.gain + statistics.process
    return variance / (variance + 1.0)


def innovation_variance(statistics: FilterStatistics, track: Track) -> Float[Array, "4"]:
    """Return the nominal variance of the next innovation on one axis."""
    return track.noise / (1.0 - next_gain(statistics, track))


def increment(
    linear: LinearMap, track: Track, action: Float[Array, "6"]
) -> tuple[Float[Array, "6"], Float[Array, "3"]]:
    """Return what an action is expected to change, as `linear_increment` does."""
    return linear_increment(linear, track.motion, action)


def innovation_scale(statistics: FilterStatistics, track: Track, action: Float[Array, "6"]) -> Float[Array, "12"]:
    """Return the deviation of the innovation that follows an action: m, m/s, rad, rad/s."""
    return _axes(jnp.sqrt(innovation_variance(statistics, track))) * statistics.shape


def correct(
    statistics: FilterStatistics,
    track: Track,
    action: Float[Array, "6"],
    predicted: Motion,
    innovation: Float[Array, "12"],
) -> Track:
    """Take in the view that followed an action, by how far it is from `predicted` in units of `innovation_scale`."""
    gain = next_gain(statistics, track)
    away = innovation_scale(statistics, track, action) * innovation
    size = jnp.mean((innovation * statistics.shape).reshape(4, 3) ** 2, axis=1)
    weight = jnp.maximum(1.0 / (track.count + 1.0 + PRIOR_COUNT), 1.0 / MEMORY)
    return Track(
        motion=displace(predicted, _axes(gain) * away),
        view=displace(predicted, away),
        gain=gain,
        noise=track.noise * (1.0 + weight * (size - 1.0)),
        count=track.count + 1.0,
        innovation=innovation,
    )


def observe(
    statistics: FilterStatistics,
    linear: LinearMap,
    track: Track,
    action: Float[Array, "6"],
    view: Float[Array, "13"],
    dt: float,
) -> Track:
    """Advance a track by one action and the measurement that followed it."""
    change, drift = increment(linear, track, action)
    predicted = advance(track.motion, change, dt, drift)
    away = displacement(predicted, to_motion(view, track.motion.anchor))
    return correct(statistics, track, action, predicted, away / innovation_scale(statistics, track, action))


class Filter(NamedTuple):
    """One way to follow a motion: functions for one example, of statistics of their own and tracks of their own.

    Attributes:
        fit: the statistics of episodes.
        skeleton: the statistics' shapes.
        begin: the track of a first measurement.
        increment: what an action is expected to change, as `linear_increment` does.
        scale: deviation of the innovation that follows an action.
        correct: the track after a view, given by its innovation.
        observe: the track after a view.
    """

    fit: Callable[[Episodes, LinearMap], Any]
    skeleton: Callable[[jnp.dtype], Any]
    begin: Callable[[Any, Motion], Any]
    increment: Callable[[LinearMap, Any, Array], tuple[Array, Array]]
    scale: Callable[[Any, Any, Array], Array]
    correct: Callable[[Any, Any, Array, Motion, Array], Any]
    observe: Callable[[Any, LinearMap, Any, Array, Array, float], Any]


def follow(
    filter: Filter,
    statistics: Any,
    linear: LinearMap,
    observation: Float[Array, "T 13"],
    action: Float[Array, "T-1 6"],
    valid: Bool[Array, "T"],
    dt: float,
) -> Any:
    """Return the tracks at all measurements of a window, stacked; it begins at the first that is valid."""
    anchor = observation[0]

    def advance(track: Any, step: tuple[Array, Array, Array]) -> tuple[Any, Any]:
        view, action, known = step
        observed = filter.observe(statistics, linear, track, action, view, dt)
        begun = filter.begin(statistics, to_motion(view, anchor))
        track = jax.tree.map(lambda a, b: jnp.where(known, a, b), observed, begun)
        return track, track

    first = filter.begin(statistics, to_motion(anchor, anchor))
    _, rest = jax.lax.scan(advance, first, (observation[1:], action, valid[:-1]))
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


@partial(jax.jit, static_argnames="filter")
def follow_windows(
    filter: Filter,
    statistics: Any,
    linear: LinearMap,
    observation: Float[Array, "N T 13"],
    action: Float[Array, "N T-1 6"],
    dt: float,
) -> Any:
    """Return `follow` of each of N windows that are valid throughout."""
    known = jnp.ones(observation.shape[1], bool)
    return jax.vmap(lambda o, a: follow(filter, statistics, linear, o, a, known, dt))(observation, action)


def fit_filter(episodes: Episodes, linear: LinearMap) -> FilterStatistics:
    """Choose the process variances that predict best, and measure noise and shape."""
    flown = (linear, *fit_windows(episodes, FIT_VIEWS, FIT_WINDOWS), episodes.dt)
    one = jnp.ones(12, episodes.view.dtype)
    statistics = choose_process(_late_squares, FilterStatistics(one[:4], one[:4], one), *flown)
    return statistics._replace(
        shape=root_mean_square(follow_windows(LOCAL_LEVEL, statistics, *flown).innovation[:, 1:])
    )


def _late_squares(
    statistics: FilterStatistics, linear: LinearMap, observation: Array, action: Array, dt: float
) -> tuple[Float[Array, "N 4"], Float[Array, "N 4"]]:
    """Return the mean square innovation of each window's later half, and what of it is measurement noise."""
    track = follow_windows(LOCAL_LEVEL, statistics, linear, observation, action, dt)
    unit = track.noise[:, :-1] / (1.0 - track.gain[:, 1:])
    square = unit * jnp.mean(track.innovation[:, 1:].reshape(*unit.shape, 3) ** 2, axis=-1)
    late = jnp.mean(square[:, observation.shape[1] // 2 :], axis=1)
    return late, late * (1.0 - track.gain[:, -1])


def fit_windows(episodes: Episodes, views: int, most: int) -> tuple[Float[Array, "N V 13"], Float[Array, "N V-1 6"]]:
    """Return observations and actions of evenly spread windows, shorter than wanted if no episode is so long."""
    views = min(views, episodes.longest)
    starts = episodes.starts(views)
    rows = starts[:: -(-len(starts) // most)][:, None] + np.arange(views)
    return jnp.asarray(episodes.view[rows]), jnp.asarray(episodes.action[rows[:, :-1]])


def choose_process(squares: Callable[..., tuple[Array, Array]], statistics: _Statistics, *flown: Any) -> _Statistics:
    """Return the statistics with those process variances of `PROCESS` that predict best, and the noise then.

    The score is the mean over windows of the logarithm of the mean square innovation: windows count alike whatever
    their noise.

    Args:
        squares: gives, for statistics and what was flown, each window's mean square innovation of each of the four
            quantities (windows, 4), and what of it is measurement noise (windows, 4).
    """
    choices = jnp.asarray(PROCESS, statistics.process.dtype)
    process = jnp.ones_like(statistics.process)
    # Attitude follows from rate and position from velocity, so the filters are chosen in this order.
    for k in (3, 2, 1, 0):
        tried = jnp.tile(process, (len(choices), 1)).at[:, k].set(choices)
        score, noise = _mean_logs(squares, statistics, tried, *flown)
        best = jnp.argmin(score[:, k])
        process = tried[best]
    noise = jnp.maximum(jnp.exp(noise[best]), 1e-18)  # the noise of nothing but rounding
    return statistics._replace(process=process, noise=noise)


@partial(jax.jit, static_argnames="squares")
def _mean_logs(
    squares: Callable[..., tuple[Array, Array]], statistics: _Statistics, process: Float[Array, "P 4"], *flown: Any
) -> tuple[Float[Array, "P 4"], Float[Array, "P 4"]]:
    """Return the means over windows of the logarithms of what `squares` gives for each choice of variances."""

    def one(process: Float[Array, "4"]) -> tuple[Float[Array, "4"], Float[Array, "4"]]:
        return jax.tree.map(
            lambda x: jnp.mean(jnp.log(x), axis=0), squares(statistics._replace(process=process), *flown)
        )

    return jax.vmap(one)(process)


def root_mean_square(innovation: Float[Array, "N V 12"]) -> Float[Array, "12"]:
    """Return the `shape` of innovations that were scaled without one."""
    mean = np.mean(np.square(innovation, dtype=np.float64), axis=(0, 1))
    return jnp.asarray(np.sqrt(mean), innovation.dtype)


def _axes(x: Float[Array, "4"]) -> Float[Array, "12"]:
    return jnp.repeat(x, 3)


LOCAL_LEVEL = Filter(fit_filter, FilterStatistics.skeleton, start_track, increment, innovation_scale, correct, observe)
"""The vehicle is that of the training flights."""
