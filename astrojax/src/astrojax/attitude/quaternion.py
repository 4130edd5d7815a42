"""Rigid-body attitude: scalar-first unit quaternions and rotational dynamics.

A quaternion `q_bw` takes body axes to world axes: v_world = quat_rotate(q_bw, v_body). Body rates are
expressed in body axes. Nothing here canonicalises the sign of a quaternion.
"""

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from astrojax._types import (
    FloatScalar,
    Matrix3,
    Quaternion,
    Vector3,
    cross,
    dot,
    safe_sqrt,
)

_SMALL = 1e-4  # squared angle below which series stand in for sin(x)/x and its inverse, exact to rounding


def quat_multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p * q: rotate by q first, then by p.

    Args:
        p: (4,) left factor, scalar first.
        q: (4,) right factor, scalar first.
    """
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return jnp.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )


def quat_conjugate(q: Quaternion) -> Quaternion:
    """Conjugate, for a unit quaternion (4,) the inverse rotation."""
    return jnp.stack([q[0], -q[1], -q[2], -q[3]])


def quat_normalize(q: Quaternion) -> Quaternion:
    """Unit quaternion of the same rotation; a zero quaternion (4,) becomes the identity."""
    square = q[0] * q[0] + dot(q[1:], q[1:])
    valid = square > 0
    scaled = q * jax.lax.rsqrt(jnp.where(valid, square, 1.0))
    return jnp.where(valid, scaled, jnp.array([1.0, 0.0, 0.0, 0.0], dtype=q.dtype))


def quat_sign(q: Float[ArrayLike, "... 4"], reference: Float[ArrayLike, "... 4"]) -> Float[ArrayLike, "..."]:
    """The sign, 1 or -1, that brings a quaternion to the side of another: q and -q are one rotation.

    Args:
        q: (..., 4) NumPy or JAX array.
        reference: (..., 4) that it is to be continuous with.
    """
    product = q * reference
    cosine = product[..., 0] + product[..., 1] + product[..., 2] + product[..., 3]
    return 1 - 2 * (cosine < 0).astype(q.dtype)


def quat_rotate(q: Quaternion, v: Vector3) -> Vector3:
    """Rotate a vector: for q = q_bw from body to world axes.

    Args:
        q: (4,) unit quaternion.
        v: (3,) vector, any unit.
    """
    twice = 2.0 * cross(q[1:], v)
    return v + q[0] * twice + cross(q[1:], twice)


def quat_to_rotation(q: Quaternion) -> Matrix3:
    """Rotation matrix with v_world = matrix @ v_body, for a unit quaternion (4,) q_bw."""
    w, x, y, z = q
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def rotation_to_quat(rotation: Matrix3) -> Quaternion:
    """Unit quaternion of a rotation matrix (3, 3), for any angle; its largest component is positive.

    Source: Shepperd (1978), J. Guidance and Control 1(3), 223: the matrix gives 4 q q^T, whose column of the
    largest diagonal entry (at least 1) is normalised, so no branch divides by a small number.
    """
    m = rotation
    a, b, c = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    d, e, f = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    diagonal = jnp.stack(
        [
            1 + m[0, 0] + m[1, 1] + m[2, 2],
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
        ]
    )
    outer = jnp.stack(
        [
            jnp.stack([diagonal[0], a, b, c]),
            jnp.stack([a, diagonal[1], d, e]),
            jnp.stack([b, d, diagonal[2], f]),
            jnp.stack([c, e, f, diagonal[3]]),
        ]
    )
    return quat_normalize(outer[jnp.argmax(diagonal)])


def quat_from_rotation_vector(phi: Vector3) -> Quaternion:
    """Unit quaternion of a rotation vector (axis times angle) (3,) [rad], smooth at zero."""
    square = dot(phi, phi)
    small = square < _SMALL
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    scale = jnp.where(small, 0.5 - square * (1 / 48 - square / 3840), jnp.sin(0.5 * angle) / angle)
    w = jnp.where(small, 1.0 - square * (1 / 8 - square * (1 / 384 - square / 46080)), jnp.cos(0.5 * angle))
    return jnp.concatenate([w[None], scale * phi])


def quat_to_rotation_vector(q: Quaternion) -> Vector3:
    """Rotation vector [rad] of the shortest rotation, |phi| <= pi, the same for q and -q.

    Args:
        q: (4,) quaternion; its length does not matter (zero gives zero).

    Validity: smooth at the identity. A rotation by exactly pi has two equal answers, +-pi about its axis; the
    function jumps there and nowhere else, with finite one-sided gradients.
    """
    q = jnp.where(q[0] < 0, -q, q)
    w, v = q[0], q[1:]
    square = dot(v, v)
    small = square <= _SMALL * w * w
    divisor = jnp.where(small & (w > 0), w, 1.0)
    ratio = jnp.where(small, square, 0.0) / (divisor * divisor)  # tan^2 of the half angle
    series = 2.0 / divisor * (1.0 - ratio * (1 / 3 - ratio * (1 / 5 - ratio / 7)))
    sine = jnp.sqrt(jnp.where(small, 1.0, square))
    return jnp.where(small, series, 2.0 * jnp.arctan2(sine, w) / sine) * v


def quat_derivative(q: Quaternion, omega_body: Vector3) -> Quaternion:
    """Time derivative [1/s] of q_bw for body rates.

    Args:
        q: (4,) unit quaternion, body to world.
        omega_body: (3,) angular velocity of the body with respect to the world, body axes [rad/s].
    """
    w, v = q[0], q[1:]
    return 0.5 * jnp.concatenate([-dot(v, omega_body)[None], w * omega_body + cross(v, omega_body)])


def quat_angle(q1: Quaternion, q2: Quaternion) -> FloatScalar:
    """Total rotation angle [rad, 0 to pi] between two attitudes, sign-invariant.

    Args:
        q1: (4,) quaternion; neither length matters.
        q2: (4,) quaternion.

    Validity: accurate at both ends (atan2, not arccos). At equal attitudes, where the angle has a corner, its
    gradient is zero.
    """
    delta = quat_multiply(quat_conjugate(q1), q2)
    return 2.0 * jnp.arctan2(safe_sqrt(dot(delta[1:], delta[1:])), jnp.abs(delta[0]))
