"""Euler angles: all twelve sequences of turns about body axes, both ways, and their rates.

A sequence such as "ZYX" turns about the body's z axis first, then about its new y, then about its newest x. It
describes the same body-to-world rotation as the quaternion of `quaternion`: v_world = R v_body,
R = R_z(a) R_y(b) R_x(c). The first and third axis may be one ("ZXZ": the middle angle lies in [0, pi]) or differ
("ZYX": the middle angle lies in [-pi/2, pi/2]).

Source: Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, secs. 2.9.4 and 3.1.
"""

import jax.numpy as jnp
import numpy as np

from astrojax._types import Matrix3, Quaternion, Vector3, cross, safe_sqrt
from astrojax.attitude.quaternion import quat_multiply

SEQUENCES = ("XYX", "XYZ", "XZX", "XZY", "YXY", "YXZ", "YZX", "YZY", "ZXY", "ZXZ", "ZYX", "ZYZ")
"""The twelve sequences of turns about body axes."""


def _axes(sequence: str) -> tuple[int, int, int]:
    if sequence not in SEQUENCES:
        raise ValueError(f"sequence: expected one of {', '.join(SEQUENCES)}, got {sequence!r}")
    return tuple("XYZ".index(letter) for letter in sequence)


def _turn(axis: int, angle) -> Matrix3:
    """Rotation matrix about a coordinate axis, body to world."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    rows = [[jnp.zeros_like(c)] * 3 for _ in range(3)]
    rows[axis][axis] = jnp.ones_like(c)
    rows[j][j], rows[j][k], rows[k][j], rows[k][k] = c, -s, s, c
    return jnp.stack([jnp.stack(row) for row in rows])


def euler_to_rotation(angles: Vector3, sequence: str) -> Matrix3:
    """Rotation matrix, body to world, of three turns about body axes.

    Args:
        angles: (3,) first, second and third angle [rad].
        sequence: one of `SEQUENCES`, such as "ZYX" for yaw, pitch, roll; static.

    Raises:
        ValueError: an unknown sequence.
    """
    i, j, k = _axes(sequence)
    return _turn(i, angles[0]) @ _turn(j, angles[1]) @ _turn(k, angles[2])


def euler_to_quat(angles: Vector3, sequence: str) -> Quaternion:
    """Unit quaternion, body to world, of three turns about body axes; arguments as in `euler_to_rotation`."""

    def turn(axis, angle):
        parts = [jnp.cos(0.5 * angle)] + [jnp.zeros_like(angle)] * 3
        parts[1 + axis] = jnp.sin(0.5 * angle)
        return jnp.stack(parts)

    first, second, third = (turn(axis, angle) for axis, angle in zip(_axes(sequence), angles))
    return quat_multiply(quat_multiply(first, second), third)


def rotation_to_euler(rotation: Matrix3, sequence: str) -> Vector3:
    """Euler angles of a rotation matrix, body to world: the first and third in [-pi, pi].

    Args:
        rotation: (3, 3) orthonormal.
        sequence: one of `SEQUENCES`; static.

    Validity: where the middle angle brings first and third axis together (pitch of +-pi/2, or 0 and pi where the two
    axes are one), only their sum or difference is defined: the third angle is then zero and the first takes it all.
    Gradients are finite there, one-sided. The threshold is a middle angle some roundings away.

    Raises:
        ValueError: an unknown sequence.
    """
    i, j, k = _axes(sequence)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    m = rotation
    if i == k:
        other = 3 - i - j
        # First column and row of axis i: cos b; sin b times sine and cosine of the outer angles.
        sine2 = m[i, j] * m[i, j] + m[i, other] * m[i, other]
        first = m[j, i], -sign * m[other, i]
        third = m[i, j], sign * m[i, other]
        middle = jnp.arctan2(safe_sqrt(sine2), m[i, i])
    else:
        # cos b times sine and cosine of the outer angles; sin b alone.
        sine2 = m[i, i] * m[i, i] + m[i, j] * m[i, j]
        first = -sign * m[j, k], m[k, k]
        third = -sign * m[i, j], m[i, i]
        middle = jnp.arctan2(sign * m[i, k], safe_sqrt(sine2))
    tiny = (8.0 * jnp.finfo(m.dtype).eps) ** 2
    locked = sine2 <= tiny
    one, zero = jnp.ones_like(m[0, 0]), jnp.zeros_like(m[0, 0])
    # Third angle zero leaves the first turn in the row and column of the second axis.
    other = 3 - i - j
    alone = sign * m[other, j], m[j, j]
    a = jnp.arctan2(*(jnp.where(locked, x, y) for x, y in zip(alone, first)))
    c = jnp.arctan2(*(jnp.where(locked, x, y) for x, y in zip((zero, one), third)))
    return jnp.stack([a, middle, c])


def _rate_axes(angles: Vector3, sequence: str) -> Matrix3:
    """Matrix from Euler rates to body rates: its columns are the three turning axes in body axes."""
    i, j, k = _axes(sequence)
    unit = np.eye(3)
    last = _turn(k, angles[2])
    both = _turn(j, angles[1]) @ last
    third = jnp.asarray(unit[k], angles.dtype)
    return jnp.stack([both[i], last[j], third], axis=1)


def euler_rates_to_omega(angles: Vector3, rates: Vector3, sequence: str) -> Vector3:
    """Body rates [rad/s] of Euler angles and their rates.

    Args:
        angles: (3,) [rad].
        rates: (3,) their time derivatives [rad/s].
        sequence: one of `SEQUENCES`; static.

    Returns:
        (3,) angular velocity of the body with respect to the world, body axes.
    """
    return _rate_axes(angles, sequence) @ rates


def euler_derivative(angles: Vector3, omega_body: Vector3, sequence: str) -> Vector3:
    """Time derivative [rad/s] of Euler angles for body rates.

    Args:
        angles: (3,) [rad].
        omega_body: (3,) angular velocity of the body with respect to the world, body axes [rad/s].
        sequence: one of `SEQUENCES`; static.

    Validity: grows without bound towards the singularity of the sequence; within rounding of it, the angles are held
    (zero), since no finite rates give the body rate.
    """
    x, y, z = _rate_axes(angles, sequence).T
    cofactors = jnp.stack([cross(y, z), cross(z, x), cross(x, y)])
    volume = x @ cofactors[0]
    safe = jnp.abs(volume) > 8.0 * jnp.finfo(angles.dtype).eps
    return jnp.where(safe, cofactors @ omega_body / jnp.where(safe, volume, 1.0), 0.0)
