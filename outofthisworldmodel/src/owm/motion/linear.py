"""The part of the dynamics that least squares finds: a baseline by itself, and the base under the network."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from owm.checkpoint import Within
from owm.data.windows import Episodes
from owm.motion.kinematics import (
    Motion,
    advance,
    apply,
    apply_inverse,
    increments,
    multiply,
    rotation,
    to_motion,
    to_station,
)
from owm_envs.view import View

FIT_ROWS = 200_000
"""Most transitions that a fit uses; more would not change a digit that matters."""
FIT_PASSES = 6
"""Of the weighted fit."""


class LinearMap(NamedTuple):
    """What changes over one step, linear in the action, in station-frame position and velocity, and in rate products.

    Such maps hold the orbital terms of Clohessy and Wiltshire, and Euler's equations in a station frame that turns
    about its x axis, the orbit normal, to first order in the step.

    Attributes:
        action: body-frame velocity (m/s) and rate (rad/s) change per N and N m.
        bias: the same without any action.
        station: station-frame velocity change per metre and per m/s of station-frame position and velocity.
        gyroscopic: body-frame rate change (rad/s) per unit of `rate_products`. Like `station` zero in a map fitted to
            the actions alone.
    """

    action: Float[Array, "6 6"]
    bias: Float[Array, "6"]
    station: Float[Array, "3 6"]
    gyroscopic: Float[Array, "3 15"]

    @classmethod
    def skeleton(cls, dtype: jnp.dtype) -> "LinearMap":
        """Return the shapes."""
        # Generous: a step of a second moves a craft of a hundred grams by 10 m/s for each newton.
        pushed = (Within(shape, dtype, -10.0, 10.0) for shape in ((6, 6), (6,)))
        return cls(*pushed, *(jax.ShapeDtypeStruct(shape, dtype) for shape in ((3, 6), (3, 15))))


def rate_products(rate: Float[Array, "3"], turn: Float[Array, "3 3"]) -> Float[Array, "15"]:
    """Return xx, yy, zz, yz, zx, xy of the body rate, then its products with the station's x axis in body axes.

    Args:
        rate: rad/s, body frame.
        turn: rotation from body to station frame, whose first row is that axis.
    """
    mixed = jnp.roll(rate, -1) * jnp.roll(rate, -2)
    return jnp.concatenate([rate * rate, mixed, (rate[:, None] * turn[:1]).reshape(9)])


def linear_increment(
    linear: LinearMap, motion: Motion, action: Float[Array, "6"]
) -> tuple[Float[Array, "6"], Float[Array, "3"]]:
    """Return the body-frame increment and the anchor-frame velocity drift of one step, as `advance` takes them."""
    position, velocity, turn = to_station(motion)
    drift = apply_inverse(turn, apply(linear.station, jnp.concatenate([position, velocity])))
    body = rotation(multiply(motion.anchor[3:], motion.attitude))
    gyroscopic = apply(linear.gyroscopic, rate_products(motion.rate, body))
    increment = apply(linear.action, action) + linear.bias
    return increment + jnp.concatenate([jnp.zeros_like(gyroscopic), gyroscopic]), drift


def linear_advance(linear: LinearMap, motion: Motion, action: Float[Array, "6"], dt: float) -> Motion:
    """Advance a motion by one step of the linear map on the analytic kinematics."""
    increment, drift = linear_increment(linear, motion, action)
    return advance(motion, increment, dt, drift)


def transition_rows(episodes: Episodes, limit: int = FIT_ROWS) -> Int[np.ndarray, "N"]:
    """Return the rows before up to `limit` evenly spread transitions."""
    rows = episodes.starts(2)
    return rows[:: -(-len(rows) // limit)]


def transitions(episodes: Episodes, limit: int = FIT_ROWS) -> tuple[Array, Array, Array]:
    """Return up to `limit` evenly spread transitions: views before, views after, actions between."""
    rows = transition_rows(episodes, limit)
    views = jnp.asarray(episodes.view)
    return views[rows], views[rows + 1], jnp.asarray(episodes.action)[rows]


@jax.jit
def _body_increments(before: Array, after: Array, dt: Array) -> tuple[Array, Array]:
    """Return increments in the body frame and the rotation from there to the station frame, for a batch of views."""

    def one(before: Array, after: Array) -> tuple[Array, Array]:
        first = to_motion(before, before)
        return increments(first, to_motion(after, before), dt), rotation(View.of(before).attitude)

    return jax.vmap(one)(before, after)


def fit_linear_map(episodes: Episodes, *, motion: bool = True) -> LinearMap:
    """Fit the linear map to measured transitions by least squares.

    Flights are weighted by the inverse of what the fit leaves of them, over and over: those of noisy sensors, whose
    actions answer the noise and so correlate with it, and those of vehicles unlike most, would bias the map of all
    others. Source: iteratively reweighted least squares, Holland and Welsch (1977).

    Args:
        episodes: training episodes; measurements are used, not the truth.
        motion: fit the terms of position, velocity and rate too; otherwise only action and bias.
    """
    before, after, action = transitions(episodes)
    flight = np.unique(episodes.episode[transition_rows(episodes)], return_inverse=True)[1]
    change, turn = (np.asarray(x, np.float64) for x in _body_increments(before, after, episodes.dt))
    before, action = np.asarray(before, np.float64), np.asarray(action, np.float64)
    rows = len(action)
    # Columns are scaled to order one so that the normal equations stay well conditioned.
    unit = np.maximum(np.abs(action).max(axis=0), 1e-9)
    inputs = np.concatenate([action / unit, np.ones((rows, 1))], axis=1)
    products = np.asarray(jax.vmap(rate_products)(View.of(before).rate, turn), np.float64)
    size = np.maximum(np.abs(products).max(axis=0), 1e-12)
    where = np.maximum(np.abs(before[:, :6]).max(axis=0), 1e-9)

    def rate_design(part: np.ndarray) -> np.ndarray:
        return np.concatenate([inputs[part], products[part] / size], axis=1) if motion else inputs[part]

    def velocity_design(part: np.ndarray) -> np.ndarray:
        """Row i of a sample holds the inputs in block i, and the station terms turned into the body frame."""
        design = np.zeros((len(part), 3, 39 if motion else 21))
        for i in range(3):
            design[:, i, 7 * i : 7 * i + 7] = inputs[part]
        if motion:
            terms = turn[part].transpose(0, 2, 1)[:, :, :, None] * (before[part, :6] / where)[:, None, None, :]
            design[:, :, 21:] = terms.reshape(len(part), 3, 18)
        return design.reshape(3 * len(part), -1)

    rate = _weighted_fit(rate_design, change[:, 3:], flight)
    solution = _weighted_fit(velocity_design, change[:, :3], flight)
    velocity = solution[:21].reshape(3, 7)
    fitted = LinearMap(
        action=np.concatenate([velocity[:, :6], rate[:6].T]) / unit,
        bias=np.concatenate([velocity[:, 6], rate[6]]),
        station=solution[21:].reshape(3, 6) / where if motion else np.zeros((3, 6)),
        gyroscopic=rate[7:].T / size if motion else np.zeros((3, 15)),
    )
    return jax.tree.map(lambda x: jnp.asarray(x, episodes.view.dtype), fitted)


def _weighted_fit(
    design: Callable[[np.ndarray], np.ndarray], change: Float[np.ndarray, "N 3"], flight: Int[np.ndarray, "N"]
) -> np.ndarray:
    """Fit `FIT_PASSES` times, each but the first with every flight's inverse mean square residual as its weight.

    Args:
        design: of the samples of an index: one row a sample, to be fitted to the columns of `change`, or three rows a
            sample, to be fitted to its components.
        change: what to fit.
        flight: of each sample.
    """
    parts = np.array_split(np.arange(len(change)), max(len(change) // 20_000, 1))
    weight = np.ones(len(change))
    for number in range(FIT_PASSES):
        normal, moment = 0.0, 0.0
        for part in parts:
            rows = design(part)
            each = len(rows) // len(part)
            weighed = rows * np.repeat(weight[part], each)[:, None]
            normal = normal + weighed.T @ rows
            moment = moment + weighed.T @ change[part].reshape(len(rows), -1)
        solution, *_ = np.linalg.lstsq(normal, moment, rcond=None)
        if number < FIT_PASSES - 1:
            left = [np.sum((change[p] - (design(p) @ solution).reshape(-1, 3)) ** 2, axis=1) for p in parts]
            mean = np.bincount(flight, np.concatenate(left)) / np.bincount(flight)
            weight = 1.0 / np.maximum(mean, 1e-6 * mean.max() + 1e-30)[flight]
            weight = weight / weight.mean()
    return solution if solution.shape[1] > 1 else solution[:, 0]
