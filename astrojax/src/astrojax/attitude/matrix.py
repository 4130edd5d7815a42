"""Rotation matrices, axis and angle, and the time derivative of a rotation matrix."""

import jax
import jax.numpy as jnp

from astrojax._types import FloatScalar, Matrix3, Quaternion, Scalar, Vector3, dot
from astrojax.attitude.quaternion import (
    quat_from_rotation_vector,
    quat_to_rotation,
    quat_to_rotation_vector,
    rotation_to_quat,
)


def skew(v: Vector3) -> Matrix3:
    """The matrix (3, 3) of a cross product: skew(v) @ x = v x x."""
    zero = jnp.zeros_like(v[0])
    rows = [[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]]
    return jnp.stack([jnp.stack(row) for row in rows])


def axis_angle_to_quat(axis: Vector3, angle: Scalar) -> Quaternion:
    """Unit quaternion, body to world, of a turn about an axis.

    Args:
        axis: (3,) unit vector.
        angle: [rad], right-handed about it; any number of turns.
    """
    half = 0.5 * jnp.asarray(angle, axis.dtype)
    return jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * axis])


def quat_to_axis_angle(q: Quaternion) -> tuple[Vector3, FloatScalar]:
    """Axis (3,) and angle [rad, 0 to pi] of the shortest rotation, the same for q and -q.

    Args:
        q: (4,) quaternion; its length does not matter.

    Validity: the identity has no axis; it is given the x axis, and gradients there are zero.
    """
    phi = quat_to_rotation_vector(q)
    square = dot(phi, phi)
    turned = square > jnp.finfo(q.dtype).tiny
    inverse = jax.lax.rsqrt(jnp.where(turned, square, 1.0))
    rest = jnp.array([1.0, 0.0, 0.0], q.dtype)
    return jnp.where(turned, phi * inverse, rest), jnp.where(turned, square * inverse, 0.0)


def rotation_from_rotation_vector(phi: Vector3) -> Matrix3:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad]: the exponential of its skew matrix."""
    return quat_to_rotation(quat_from_rotation_vector(phi))


def rotation_to_rotation_vector(rotation: Matrix3) -> Vector3:
    """Rotation vector (3,) [rad] of a rotation matrix (3, 3): its logarithm, |phi| <= pi."""
    return quat_to_rotation_vector(rotation_to_quat(rotation))


def rotation_derivative(rotation: Matrix3, omega_body: Vector3) -> Matrix3:
    """Time derivative [1/s] of a rotation matrix, body to world, for body rates: R skew(omega).

    Args:
        rotation: (3, 3), body to world.
        omega_body: (3,) angular velocity of the body with respect to the world, body axes [rad/s].

    Source: Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, sec. 3.1.
    """
    return rotation @ skew(omega_body)
