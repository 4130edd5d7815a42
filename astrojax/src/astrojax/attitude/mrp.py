"""Modified Rodrigues parameters: axis times the tangent of a quarter of the angle, and their shadow set.

Source: Schaub and Junkins, Analytical Mechanics of Space Systems, 4th ed., sec. 3.6.
"""

import jax
import jax.numpy as jnp

from astrojax._types import Matrix3, Quaternion, Vector3, cross, dot
from astrojax.attitude.quaternion import quat_to_rotation


def quat_to_mrp(q: Quaternion) -> Vector3:
    """Modified Rodrigues parameters of the shorter rotation, |sigma| <= 1, the same for q and -q.

    Args:
        q: (4,) unit quaternion, body to world.
    """
    q = jnp.where(q[0] < 0, -q, q)
    return q[1:] / (1.0 + q[0])


def mrp_to_quat(mrp: Vector3) -> Quaternion:
    """Unit quaternion, body to world, of modified Rodrigues parameters (3,) of either set."""
    square = dot(mrp, mrp)
    return jnp.concatenate([(1.0 - square)[None], 2.0 * mrp]) / (1.0 + square)


def mrp_to_rotation(mrp: Vector3) -> Matrix3:
    """Rotation matrix, body to world, of modified Rodrigues parameters (3,) of either set."""
    return quat_to_rotation(mrp_to_quat(mrp))


def mrp_shadow(mrp: Vector3) -> Vector3:
    """The other parameters of the same rotation, -sigma / |sigma|^2.

    Args:
        mrp: (3,). The shadow of zero, which is a whole turn, lies at infinity: zero is given.
    """
    square = dot(mrp, mrp)
    apart = square > jnp.finfo(mrp.dtype).tiny
    return jnp.where(apart, -mrp / jnp.where(apart, square, 1.0), 0.0)


def mrp_switch(mrp: Vector3) -> Vector3:
    """The shorter of the two sets, |sigma| <= 1: call it after each integration step, and none is ever singular."""
    return jax.lax.select(jnp.broadcast_to(dot(mrp, mrp) > 1.0, mrp.shape), mrp_shadow(mrp), mrp)


def mrp_derivative(mrp: Vector3, omega_body: Vector3) -> Vector3:
    """Time derivative [1/s] of modified Rodrigues parameters for body rates.

    Args:
        mrp: (3,) of either set, body to world.
        omega_body: (3,) angular velocity of the body with respect to the world, body axes [rad/s].
    """
    square = dot(mrp, mrp)
    turned = (1.0 - square) * omega_body + 2.0 * cross(mrp, omega_body) + 2.0 * dot(mrp, omega_body) * mrp
    return 0.25 * turned
