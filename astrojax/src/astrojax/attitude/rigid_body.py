"""How a rigid body turns: Euler's equations and the gravity gradient."""

import jax.numpy as jnp

from astrojax._types import Matrix3, Scalar, Vector3, cross, dot, inverse_norm
from astrojax.constants import GM_EARTH


def accel_euler(omega: Vector3, inertia: Matrix3, torque: Vector3) -> Vector3:
    """Angular acceleration [rad/s^2] of a rigid body, I^-1 (torque - omega x I omega), body axes.

    Args:
        omega: (3,) inertial angular velocity [rad/s].
        inertia: (3, 3) symmetric positive definite inertia about the centre of mass [kg m^2].
        torque: (3,) [N m].

    Source: Euler's equations; Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and
    Control, sec. 3.3.
    """
    # Scaled by the trace: products of three inertias leave the range of float32 when differentiated.
    inv_scale = 1.0 / (inertia[0, 0] + inertia[1, 1] + inertia[2, 2])
    x, y, z = inertia[0] * inv_scale, inertia[1] * inv_scale, inertia[2] * inv_scale
    b = torque * inv_scale - cross(omega, jnp.stack([dot(x, omega), dot(y, omega), dot(z, omega)]))
    yz, zx, xy = cross(y, z), cross(z, x), cross(x, y)
    return (b[0] * yz + b[1] * zx + b[2] * xy) / dot(x, yz)


def torque_gravity_gradient(r_body: Vector3, inertia: Matrix3, gm: Scalar = GM_EARTH) -> Vector3:
    """Gravity-gradient torque [N m] on a rigid body, body axes.

    Args:
        r_body: (3,) position of the vehicle from Earth's centre, in body axes [m].
        inertia: (3, 3) inertia about the centre of mass [kg m^2].
        gm: gravitational parameter [m^3/s^2].

    Source: Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, sec. 3.3.
    """
    inv_r = inverse_norm(r_body)
    u = r_body * inv_r
    pull = jnp.stack([dot(inertia[0], u), dot(inertia[1], u), dot(inertia[2], u)])
    return (3.0 * gm * inv_r * inv_r * inv_r) * cross(u, pull)
