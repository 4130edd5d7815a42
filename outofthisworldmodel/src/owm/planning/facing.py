"""The attitude to fly in while an axis of force is out: turned so that those that are left push where it matters."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from astrojax.attitude import quat_conjugate, quat_multiply, quat_rotate
from owm.planning.effect import OUT, Effect, forces
from owm_envs.task.events import safe_norm
from owm_envs.view import View

_TOLERATED = 0.004
"""m/s of wanted changes of velocity that may be left missing for the sake of the port's attitude."""
_STAYING = 0.5
"""What is missing in the attitude now counts so much, squared: two turns one after the other cost a minute."""
_LAST_TURN, _TURNED_BY, _COMMITTED = 4.0, 2.0, 0.05
"""m from the goal: where the last turn may begin and where it must be done; and m/s: who is on course then turns to the
port's attitude for good, unless more than that is missing."""
_CLOSING = 0.078
"""m/s, about, of the last metres."""
_BLOCK = 16
"""Steps of a path over which changes of velocity are taken together."""


def missing_forces(effect: Effect, attitude: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Return what of a change of velocity no force can bring: a matrix in body axes, near zero for a sound vehicle.

    Args:
        effect: what actions do, at an attitude (body to station).
    """
    left = jax.vmap(quat_rotate, (None, 1), 1)(quat_conjugate(attitude), forces(effect))
    size = jnp.max(jnp.sum(left * left, axis=0))
    left = left / jnp.sqrt(jnp.maximum(size, 1e-30))
    missing = OUT * jnp.linalg.inv(left @ left.T + OUT * jnp.eye(3, dtype=left.dtype))
    return jnp.where((size > 0) & jnp.all(jnp.isfinite(missing)), missing, 0)


def is_crippled(missing: Float[Array, "3 3"]) -> Bool[Array, ""]:
    """Whether a direction is out: less than a tenth of the best axis's force is left there."""
    return jnp.max(jnp.diag(missing)) > 0.5


def is_turned(view: Float[Array, "13"], pose: Float[Array, "7"]) -> Bool[Array, ""]:
    """Whether a view has the port's attitude to within 10 deg."""
    return jnp.abs(jnp.sum(pose[3:] * View.of(view).attitude)) > 0.996


def facing(
    missing: Float[Array, "3 3"], view: Float[Array, "13"], pose: Float[Array, "7"], path: Float[Array, "T+1 6"]
) -> Float[Array, "4"]:
    """Return the attitude to hold: the port's, or for a crippled vehicle that or a quarter turn from it.

    The quarter turn brings another axis to where the one points that is out. Of both it is the attitude that leaves
    less missing of the changes of velocity on a path, up to its end or the goal.

    Args:
        missing: from `missing_forces`.
        view: now.
        pose: hold pose, m and quaternion.
        path: positions m and velocities m/s to come.
    """
    position, velocity, attitude, _ = View.of(view)
    axis = jnp.linalg.eigh(missing)[1][:, -1]
    # About the nose, unless that is out.
    about = jnp.where(jnp.abs(axis[2]) < 0.7, jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray([1.0, 0.0, 0.0]))
    quarter = jnp.concatenate([jnp.ones(1), about.astype(axis.dtype)]) / jnp.sqrt(2.0)
    choices = jnp.stack([pose[3:], quat_multiply(pose[3:], quarter)]).astype(axis.dtype)
    out = jax.vmap(quat_rotate, (0, None))(choices, axis)
    apart = path[::_BLOCK, :3] - pose[:3]
    squares = jnp.sum(apart * apart, axis=1)
    last = jnp.where(jnp.min(squares) < 1, jnp.argmin(squares), len(apart))
    ahead = jnp.arange(len(apart) - 1) < last
    changes = jnp.where(ahead[:, None], jnp.diff(path[::_BLOCK, 3:], axis=0), 0)
    soon = 0.5 ** jnp.arange(len(changes), dtype=path.dtype)
    costs = soon @ (changes @ out.T) ** 2
    now = jnp.argmax(jnp.abs(choices @ attitude))
    tolerated = _tolerated(position - pose[:3], velocity, out[0], is_turned(view, pose))
    costs = costs + jnp.stack([jnp.zeros_like(tolerated), tolerated**2])
    costs = costs * jnp.where(jnp.arange(2) == now, _STAYING, 1)
    return jnp.where(is_crippled(missing), choices[jnp.argmin(costs)], pose[3:])


def facing_out(
    missing: Float[Array, "3 3"], attitude: Float[Array, "4"], wanted: Float[Array, "3"]
) -> Float[Array, "4"]:
    """Return the attitude in which to leave: as it is, or with the one axis of force that is left along the way out.

    Args:
        missing: from `missing_forces`.
        attitude: now.
        wanted: change of velocity, station frame.
    """
    axis = quat_rotate(attitude, jnp.linalg.eigh(missing)[1][:, 0])
    axis = jnp.where(jnp.sum(axis * wanted) < 0, -axis, axis)
    # Twice the shortest rotation would take one to the other.
    half = axis + wanted / jnp.maximum(safe_norm(wanted), 1e-6)
    half = half / jnp.maximum(safe_norm(half), 1e-6)
    turn = jnp.concatenate([jnp.sum(axis * half)[None], jnp.cross(axis, half)])
    return jnp.where(jnp.trace(missing) > 1.5, quat_multiply(turn, attitude), attitude)


def _tolerated(
    offset: Float[Array, "3"], velocity: Float[Array, "3"], out: Float[Array, "3"], turned: Bool[Array, ""]
) -> Float[Array, ""]:
    """How much change of velocity may be left missing at the port's attitude, m/s.

    Args:
        out: the direction that is out there, unit vector.
        turned: whether that attitude is held already.
    """
    away = jnp.sqrt(jnp.sum(offset * offset) + 1e-12)
    along = jnp.sum(offset * out)
    miss = along + jnp.sum(velocity * out) * away / _CLOSING
    # Along the way in it may come sooner or later.
    on_course = jnp.abs(miss) < 0.1 + 0.4 * jnp.abs(along)
    return jnp.where(on_course & (away < _LAST_TURN) & (turned | (away > _TURNED_BY)), _COMMITTED, _TOLERATED)
