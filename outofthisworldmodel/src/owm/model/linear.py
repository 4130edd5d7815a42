"""The part of the dynamics that least squares finds: a baseline by itself, and the skip under the network."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from owm.data import Episodes
from owm.model.kinematics import Motion, advance, apply, apply_inverse, increments, rotation, to_motion, to_station

FIT_ROWS = 200_000
"""Most transitions that a fit uses; more would not change a digit that matters."""


class LinearMap(NamedTuple):
    """What changes over one step, linear in the action and in the station-frame position and velocity.

    Attributes:
        action: body-frame velocity (m/s) and rate (rad/s) change per N and N m.
        bias: the same without any action.
        station: station-frame velocity change per metre and per m/s of station-frame position and velocity; zero in
            a map fitted to the actions alone.
    """

    action: Float[Array, "6 6"]
    bias: Float[Array, "6"]
    station: Float[Array, "3 6"]


def linear_increment(
    linear: LinearMap, motion: Motion, action: Float[Array, "6"]
) -> tuple[Float[Array, "6"], Float[Array, "3"]]:
    """Return the body-frame increment and the anchor-frame velocity drift of one step, as `advance` takes them."""
    position, velocity, turn = to_station(motion)
    drift = apply_inverse(turn, apply(linear.station, jnp.concatenate([position, velocity])))
    return apply(linear.action, action) + linear.bias, drift


def linear_advance(linear: LinearMap, motion: Motion, action: Float[Array, "6"], dt: float) -> Motion:
    """Advance a motion by one step of the linear map on the analytic kinematics."""
    increment, drift = linear_increment(linear, motion, action)
    return advance(motion, increment, dt, drift)


def transitions(episodes: Episodes, limit: int = FIT_ROWS) -> tuple[Array, Array, Array]:
    """Return up to `limit` evenly spread transitions: views before, views after, actions between."""
    rows = episodes.starts(2)
    rows = rows[:: -(-len(rows) // limit)]
    views = jnp.asarray(episodes.observation)
    return views[rows], views[rows + 1], jnp.asarray(episodes.action)[rows]


@jax.jit
def _body_increments(before: Array, after: Array, dt: Array) -> tuple[Array, Array]:
    """Return increments in the body frame and the rotation from there to the station frame, for a batch of views."""

    def one(before: Array, after: Array) -> tuple[Array, Array]:
        first = to_motion(before, before)
        return increments(first, to_motion(after, before), dt), rotation(before[6:10])

    return jax.vmap(one)(before, after)


def fit_linear_map(episodes: Episodes, *, station: bool = True) -> LinearMap:
    """Fit the linear map to measured transitions by least squares.

    Args:
        episodes: training episodes; measurements are used, not the truth.
        station: fit the station-frame terms too; otherwise only action and bias.
    """
    before, after, action = transitions(episodes)
    change, turn = (np.asarray(x, np.float64) for x in _body_increments(before, after, episodes.dt))
    before, action = np.asarray(before, np.float64), np.asarray(action, np.float64)
    rows = len(action)
    # Columns are scaled to order one so that the normal equations stay well conditioned.
    unit = np.maximum(np.abs(action).max(axis=0), 1e-9)
    inputs = np.concatenate([action / unit, np.ones((rows, 1))], axis=1)
    rate, *_ = np.linalg.lstsq(inputs, change[:, 3:], rcond=None)

    # Velocity: row i of a sample holds the inputs in block i, and the station terms turned into the body frame.
    where = np.maximum(np.abs(before[:, :6]).max(axis=0), 1e-9)
    columns = 21 + (18 if station else 0)
    normal, moment = np.zeros((columns, columns)), np.zeros(columns)
    for part in np.array_split(np.arange(rows), max(rows // 20_000, 1)):
        design = np.zeros((len(part), 3, columns))
        for i in range(3):
            design[:, i, 7 * i : 7 * i + 7] = inputs[part]
        if station:
            terms = turn[part].transpose(0, 2, 1)[:, :, :, None] * (before[part, :6] / where)[:, None, None, :]
            design[:, :, 21:] = terms.reshape(len(part), 3, 18)
        design = design.reshape(-1, columns)
        normal += design.T @ design
        moment += design.T @ change[part, :3].reshape(-1)
    solution, *_ = np.linalg.lstsq(normal, moment, rcond=None)
    velocity = solution[:21].reshape(3, 7)
    dtype = episodes.observation.dtype
    return LinearMap(
        action=jnp.asarray(np.concatenate([velocity[:, :6], rate[:6].T]) / unit, dtype),
        bias=jnp.asarray(np.concatenate([velocity[:, 6], rate[6]]), dtype),
        station=jnp.asarray(solution[21:].reshape(3, 6) / where if station else np.zeros((3, 6)), dtype),
    )
