"""A motion followed through noisy measurements: the estimate that predictions start from, and how noisy it all is.

Every quantity (position, velocity, attitude, rate) is filtered by itself with a scalar gain, as in the local level
model: the truth is what the prior says but for a step of variance `process`, the measurement adds noise of variance
one. The unit, the noise of one axis, is estimated along the way, so that one model serves sensors of any quality and
what the network sees and predicts is of order one for each.

Source: Durbin and Koopman (2012), Time series analysis by state space methods, sec. 2.2 (local level model).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_to_rotation_vector
from owm.data import Episodes
from owm.model.kinematics import Motion, apply, apply_inverse, multiply, rotation, to_motion
from owm.model.linear import LinearMap, linear_advance

FIT_VIEWS, FIT_WINDOWS = 24, 512
"""Length and most windows that a fit uses."""
PROCESS = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0)
"""Process variances to choose from, in units of the measurement's."""
PRIOR_COUNT = 0.05
"""Measurements that the prior of the noise is worth."""
MEMORY = 16
"""Measurements over which the noise is averaged."""


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


def innovation_scale(statistics: FilterStatistics, track: Track) -> Float[Array, "12"]:
    """Return the deviation of the next innovation: m, m/s, rad, rad/s."""
    return _axes(jnp.sqrt(innovation_variance(statistics, track))) * statistics.shape


def correct(statistics: FilterStatistics, track: Track, predicted: Motion, innovation: Float[Array, "12"]) -> Track:
    """Take in a view, given by how far it is from the predicted motion in units of `innovation_scale`."""
    gain = next_gain(statistics, track)
    away = innovation_scale(statistics, track) * innovation
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
    predicted = linear_advance(linear, track.motion, action, dt)
    away = displacement(predicted, to_motion(view, track.motion.anchor))
    return correct(statistics, track, predicted, away / innovation_scale(statistics, track))


def follow(
    statistics: FilterStatistics,
    linear: LinearMap,
    observation: Float[Array, "T 13"],
    action: Float[Array, "T-1 6"],
    valid: Bool[Array, "T"],
    dt: float,
) -> Track:
    """Return the tracks at all measurements of a window, stacked; it begins at the first that is valid."""

    def advance(track: Track, step: tuple[Array, Array, Array]) -> tuple[Track, Track]:
        view, action, known = step
        observed = observe(statistics, linear, track, action, view, dt)
        begun = start_track(statistics, to_motion(view, track.motion.anchor))
        track = jax.tree.map(lambda a, b: jnp.where(known, a, b), observed, begun)
        return track, track

    first = start_track(statistics, to_motion(observation[0], observation[0]))
    _, rest = jax.lax.scan(advance, first, (observation[1:], action, valid[:-1]))
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


def fit_filter(episodes: Episodes, linear: LinearMap) -> FilterStatistics:
    """Choose the process variances that predict best, and measure noise and shape.

    The score is the mean over windows of the logarithm of the mean square innovation: windows count alike whatever
    their noise.
    """
    views = min(FIT_VIEWS, episodes.longest)
    starts = episodes.starts(views)
    rows = starts[:: -(-len(starts) // FIT_WINDOWS)][:, None] + np.arange(views)
    observation, action = jnp.asarray(episodes.observation[rows]), jnp.asarray(episodes.action[rows[:, :-1]])
    dtype = observation.dtype
    known = jnp.ones(views, bool)

    @jax.jit
    def tracks(statistics: FilterStatistics) -> Track:
        return jax.vmap(lambda o, a: follow(statistics, linear, o, a, known, episodes.dt))(observation, action)

    @jax.jit
    def squares(process: Array) -> tuple[Array, Array]:
        """Return the mean square innovation (windows, 4) in the later half, and what of it is measurement noise."""
        track = tracks(FilterStatistics(process, jnp.ones_like(process), jnp.ones(12, dtype)))
        unit = track.noise[:, :-1] / (1.0 - track.gain[:, 1:])
        square = unit * jnp.mean(track.innovation[:, 1:].reshape(*unit.shape, 3) ** 2, axis=-1)
        late = jnp.mean(square[:, views // 2 :], axis=1)
        return late, late * (1.0 - track.gain[:, -1])

    process, choices = np.ones(4), np.asarray(PROCESS)
    # Attitude follows from rate and position from velocity, so the filters are chosen in this order.
    for k in (3, 2, 1, 0):
        tried = np.repeat(process[None], len(choices), axis=0)
        tried[:, k] = choices
        scores = [np.log(np.asarray(squares(jnp.asarray(p, dtype))[0][:, k], np.float64)).mean() for p in tried]
        process[k] = choices[int(np.argmin(scores))]
    noise = np.exp(np.log(np.asarray(squares(jnp.asarray(process, dtype))[1], np.float64)).mean(axis=0))
    noise = np.maximum(noise, 1e-18)  # the noise of nothing but rounding
    statistics = FilterStatistics(jnp.asarray(process, dtype), jnp.asarray(noise, dtype), jnp.ones(12, dtype))
    innovation = np.asarray(tracks(statistics).innovation[:, 1:], np.float64)
    shape = np.sqrt(np.mean(innovation**2, axis=(0, 1)))
    return statistics._replace(shape=jnp.asarray(shape, dtype))


def _axes(x: Float[Array, "4"]) -> Float[Array, "12"]:
    return jnp.repeat(x, 3)
