"""A motion followed through noisy measurements, and with it what this vehicle makes of its actions.

The filters are those of `owm.motion.track`. Their innovations also tell the vehicle's response: by how much the changes
of velocity and rate that an action and the one before it bring differ from the linear map's. So a heavier vehicle, a
weaker thruster, a turned one or a late one is found from its history, as far as the training flights differed in such
ways, for their spread is the prior. Innovations are linear in what the response lacks: recursive least squares, exact
for given gains.

Source: Durbin and Koopman (2012), Time series analysis by state space methods, sec. 6.2 (regression coefficients beside
the state); Maybeck (1979), Stochastic models, estimation, and control, vol. 1, sec. 7.3 (Potter's square root update,
without which float32 loses the rate's response).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from owm.checkpoint import LARGEST, Within
from owm.data.windows import Episodes
from owm.motion.kinematics import Motion, advance, apply, to_motion
from owm.motion.linear import LinearMap, linear_increment
from owm.motion.track import (
    MEMORY,
    PRIOR_COUNT,
    Filter,
    FilterStatistics,
    choose_process,
    displace,
    displacement,
    fit_windows,
    follow_windows,
    innovation_variance,
    next_gain,
    root_mean_square,
)

FIT_VIEWS, FIT_WINDOWS = 128, 64
"""Length and most windows that a fit uses."""
FIT_ROUNDS, RESPONSE_PASSES = 2, 6
"""How often the filters and the response are fitted in turn, and passes that the response's spread takes each time."""
FIRST_SPREAD = 0.3
"""Where that fit begins: deviation of a response as a share of the linear map's largest in its row."""
OUTLIER = 4.0
"""Deviations beyond which an innovation teaches no more: what no response explains must not shape one."""
_CHANGING = np.array([3, 4, 5, 9, 10, 11])
"""Velocity and rate among the 12 components of a displacement."""


class VehicleStatistics(NamedTuple):
    """What is measured on the training episodes: `owm.motion.track.FilterStatistics`, and how far vehicles differ.

    Attributes:
        process: variance of the truth's steps, in units of the measurement noise's.
        noise: measurement variance of an axis before anything is seen: m2, (m/s)2, rad2, (rad/s)2.
        shape: root mean square of each of the 12 innovations in their nominal deviations.
        response: deviation among vehicles of what a unit of each of the `inputs` changes of body-frame velocity (m/s)
            and rate (rad/s).
    """

    process: Float[Array, "4"]
    noise: Float[Array, "4"]
    shape: Float[Array, "12"]
    response: Float[Array, "6 16"]

    @classmethod
    def skeleton(cls, dtype: jnp.dtype) -> "VehicleStatistics":
        """Return the shapes."""
        return cls(*FilterStatistics.skeleton(dtype), Within((6, 16), dtype, 0.0, LARGEST))


class Response(NamedTuple):
    """What is known of this vehicle's response, beside the linear map.

    Attributes:
        mean: change of body-frame velocity (m/s) and rate (rad/s) by a unit of each of the `inputs`.
        root: of the coefficients' covariance, by component.
        trace: by how much the estimates of velocity and of rate are wrong for each unit that a coefficient is.
        previous: action that led here, N and N m; zero if none is known.
    """

    mean: Float[Array, "6 16"]
    root: Float[Array, "6 16 16"]
    trace: Float[Array, "2 16"]
    previous: Float[Array, "6"]


class Track(NamedTuple):
    """Where a motion stands.

    Attributes:
        motion: the estimate.
        view: what the sensors show, measured or sampled; the estimate itself where it was only predicted.
        gain: the estimate's variance in units of the measurement's: one after a single measurement.
        response: of the vehicle.
        noise: estimated measurement variance of an axis, as in `FilterStatistics`.
        count: steps since the first measurement.
        innovation: how far the last view was from its prediction, of unit variance; zero if there was none.
    """

    motion: Motion
    view: Motion
    gain: Float[Array, "4"]
    response: Response
    noise: Float[Array, "4"]
    count: Float[Array, ""]
    innovation: Float[Array, "12"]


def start_track(statistics: VehicleStatistics, motion: Motion) -> Track:
    """Return the track of a first measurement."""
    zero = jnp.zeros((12,), motion.rate.dtype)
    prior = statistics.response[:, :, None] * jnp.eye(16, dtype=zero.dtype)
    response = Response(jnp.zeros_like(statistics.response), prior, jnp.zeros((2, 16), zero.dtype), zero[:6])
    return Track(motion, motion, jnp.ones_like(zero[:4]), response, statistics.noise, zero[0], zero)


def inputs(track: Track, action: Float[Array, "6"]) -> Float[Array, "16"]:
    """Return what a response answers to: an action, the one before, products of body rates yz, zx, xy, and a one."""
    rate = track.view.rate
    products = jnp.roll(rate, -1) * jnp.roll(rate, -2)
    return jnp.concatenate([action, track.response.previous, products, jnp.ones_like(action[:1])])


def increment(
    linear: LinearMap, track: Track, action: Float[Array, "6"]
) -> tuple[Float[Array, "6"], Float[Array, "3"]]:
    """Return what an action changes, as `linear_increment` does for the training flights' vehicle."""
    change, drift = linear_increment(linear, track.motion, action)
    return change + apply(track.response.mean, inputs(track, action)), drift


class Outlook(NamedTuple):
    """What the next innovation is made of.

    Attributes:
        tells: by how much those of velocity and rate are larger for each unit that a coefficient is.
        projected: the root's transpose times that; its square is the variance for want of knowing the response.
        rest: all other variance: m2, (m/s)2, rad2, (rad/s)2.
        variance: of it all.
    """

    tells: Float[Array, "6 16"]
    projected: Float[Array, "6 16"]
    rest: Float[Array, "12"]
    variance: Float[Array, "12"]


def outlook(statistics: VehicleStatistics, track: Track, action: Float[Array, "6"]) -> Outlook:
    """Return what the innovation after an action is made of."""
    tells = _axes(track.response.trace + inputs(track, action))
    projected = jnp.sum(track.response.root * tells[:, :, None], axis=1)
    unknown = jnp.zeros_like(track.innovation).at[_CHANGING].set(jnp.sum(projected**2, axis=1))
    # What came before the first measurement is not known; something like this, probably, and it may still be at work.
    late = jnp.sum((statistics.response[:, 6:12] * action) ** 2, axis=1) * (track.count == 0)
    rest = _axes(innovation_variance(statistics, track)).at[_CHANGING].add(late)
    return Outlook(tells, projected, rest, rest + unknown)


def innovation_scale(statistics: VehicleStatistics, track: Track, action: Float[Array, "6"]) -> Float[Array, "12"]:
    """Return the deviation of the innovation that follows an action: m, m/s, rad, rad/s."""
    return jnp.sqrt(outlook(statistics, track, action).variance) * statistics.shape


def correct(
    statistics: VehicleStatistics,
    track: Track,
    action: Float[Array, "6"],
    predicted: Motion,
    innovation: Float[Array, "12"],
) -> Track:
    """Take in the view that followed an action, by how far it is from `predicted` in units of `innovation_scale`."""
    gain = next_gain(statistics, track)
    ahead = outlook(statistics, track, action)
    away = jnp.sqrt(ahead.variance) * statistics.shape * innovation
    limit = OUTLIER * jnp.sqrt(ahead.variance)
    response, learned = _learn(track.response, ahead, gain[1::2], jnp.clip(away, -limit, limit)[_CHANGING], action)
    # What is expected of the noise's own square, whose share of the innovation's variance is this.
    own = ahead.rest / ahead.variance
    size = jnp.mean((1.0 - own + own * (innovation * statistics.shape) ** 2).reshape(4, 3), axis=1)
    weight = jnp.maximum(1.0 / (jnp.maximum(track.count, 1.0) + PRIOR_COUNT), 1.0 / MEMORY)
    return Track(
        motion=displace(predicted, (_axes(gain) * away).at[_CHANGING].add(learned)),
        view=displace(predicted, away),
        gain=gain,
        response=response,
        noise=track.noise * (1.0 + weight * (size - 1.0)),
        count=track.count + 1.0,
        innovation=innovation,
    )


def _learn(
    response: Response, ahead: Outlook, gain: Float[Array, "2"], away: Float[Array, "6"], action: Float[Array, "6"]
) -> tuple[Response, Float[Array, "6"]]:
    """Take in the innovations of velocity and rate; also return by how much that moves their estimates."""
    variance = ahead.variance[_CHANGING]
    spread = jnp.sum(response.root * ahead.projected[:, None, :], axis=2)  # (6, 16): covariance times `tells`
    change = spread * (away / variance)[:, None]
    shrink = 1.0 / (variance + jnp.sqrt(ahead.rest[_CHANGING] * variance))
    trace = _axes(1.0 - gain)[:, None] * ahead.tells
    root = response.root - spread[:, :, None] * (ahead.projected * shrink[:, None])[:, None, :]
    return Response(response.mean + change, root, trace[::3], action), jnp.sum(trace * change, axis=1)


def observe(
    statistics: VehicleStatistics,
    linear: LinearMap,
    track: Track,
    action: Float[Array, "6"],
    view: Float[Array, "13"],
    dt: float,
) -> Track:
    """Advance a track by one action and the measurement that followed it.

    After the first measurement it begins anew, but for the noise: from now on it is known which action came before.
    The first innovation tells nothing but the noise, and that it must: noise beyond what is known of would be taken for
    the vehicle's doing.
    """
    change, drift = increment(linear, track, action)
    predicted, seen = advance(track.motion, change, dt, drift), to_motion(view, track.motion.anchor)
    innovation = displacement(predicted, seen) / innovation_scale(statistics, track, action)
    followed = correct(statistics, track, action, predicted, innovation)
    begun = start_track(statistics, seen)
    begun = begun._replace(
        response=begun.response._replace(previous=action),
        noise=followed.noise,
        count=followed.count,
        innovation=innovation,
    )
    return jax.tree.map(lambda a, b: jnp.where(track.count == 0, a, b), begun, followed)


def fit_vehicles(episodes: Episodes, linear: LinearMap) -> VehicleStatistics:
    """Choose the process variances that predict best, and measure noise, shape and how far vehicles differ."""
    dtype = episodes.view.dtype
    largest = np.abs(np.asarray(linear.action)).max(axis=1, keepdims=True)
    typical = np.sqrt(np.mean(np.square(episodes.action, dtype=np.float64)))
    response = np.concatenate([np.tile(largest, 12), np.zeros((6, 3)), 0.03 * typical * largest], axis=1)
    response[3:, 12:15] = np.abs(np.asarray(linear.gyroscopic)[:, :6]).max()
    response = np.maximum(FIRST_SPREAD * response, 1e-12)
    statistics = VehicleStatistics(
        *(jnp.asarray(x, dtype) for x in (np.ones(4), np.full(4, 1e-6), np.ones(12), response))
    )
    flown = (linear, *fit_windows(episodes, FIT_VIEWS, FIT_WINDOWS), episodes.dt)
    for _ in range(FIT_ROUNDS):
        statistics = choose_process(_late_squares, statistics, *flown)
        for _ in range(RESPONSE_PASSES):
            statistics = _fit_response(statistics, *flown)
    statistics = choose_process(_late_squares, statistics, *flown)
    return statistics._replace(shape=root_mean_square(follow_windows(VEHICLE, statistics, *flown).innovation[:, 1:]))


def _late_squares(
    statistics: VehicleStatistics, linear: LinearMap, observation: Array, action: Array, dt: float
) -> tuple[Float[Array, "N 4"], Float[Array, "N 4"]]:
    """Return the mean square innovation of each window's later half, and what of it is measurement noise."""
    track = follow_windows(VEHICLE, statistics, linear, observation, action, dt)
    late = observation.shape[1] // 2
    before = jax.tree.map(lambda x: x[:, late - 1 : -1], track)
    variance = jax.vmap(jax.vmap(lambda t, a: innovation_scale(statistics, t, a)))(before, action[:, late - 1 :]) ** 2
    square = variance * track.innovation[:, late:] ** 2
    square, nominal = (jnp.mean(x.reshape(*x.shape[:2], 4, 3), axis=(1, 3)) for x in (square, variance))
    return square, square * jnp.mean(before.noise, axis=1) / nominal


@jax.jit
def _fit_response(
    statistics: VehicleStatistics, linear: LinearMap, observation: Array, action: Array, dt: float
) -> VehicleStatistics:
    """One pass of expectation-maximisation: the mean square of what the windows' vehicles are found to be."""
    last = jax.tree.map(
        lambda x: x[:, -1], follow_windows(VEHICLE, statistics, linear, observation, action, dt).response
    )
    return statistics._replace(response=jnp.sqrt(jnp.mean(last.mean**2 + jnp.sum(last.root**2, axis=-1), axis=0)))


def _axes(x: Float[Array, "n *m"]) -> Float[Array, "3n *m"]:
    return jnp.repeat(x, 3, axis=0)


VEHICLE = Filter(fit_vehicles, VehicleStatistics.skeleton, start_track, increment, innovation_scale, correct, observe)
"""The vehicle may differ from flight to flight."""
