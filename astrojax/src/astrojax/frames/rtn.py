"""The radial, transverse, normal frame of a vehicle in orbit.

Axes: R along the position, N along the orbital angular momentum, T = N x R completing the triad.
"""

import jax.numpy as jnp

from astrojax._types import Matrix3, Vector3, Vector6, cross, dot, inverse_norm


def rotation_eci_to_rtn(state: Vector6) -> Matrix3:
    """Rotation matrix from inertial to RTN axes (its rows are R, T, N in inertial axes).

    Args:
        state: (6,) inertial position and velocity [m, m/s], not parallel.

    Source: Alfriend et al., Spacecraft Formation Flying (2010), ch. 2.
    """
    r, v = state[:3], state[3:]
    radial = r * inverse_norm(r)
    h = cross(r, v)
    normal = h * inverse_norm(h)
    return jnp.stack([radial, cross(normal, radial), normal])


def rtn_rate(state: Vector6, accel: Vector3) -> Vector3:
    """Angular velocity [rad/s] of the RTN frame with respect to inertial space, in RTN axes.

    Args:
        state: (6,) inertial position and velocity of the frame's owner [m, m/s].
        accel: (3,) its total inertial acceleration [m/s^2]; only the part along N matters. That part turns
            the orbit plane: (r a_N / h) about R, which brahe and the Keplerian frame leave out.

    Source: Gauss's variational equations for the plane; Alfriend et al., Spacecraft Formation Flying (2010).
    """
    r, v = state[:3], state[3:]
    h = cross(r, v)
    inv_h = inverse_norm(h)
    inv_r = inverse_norm(r)
    out_of_plane = dot(accel, h) * inv_h * inv_h / inv_r
    return jnp.stack([out_of_plane, jnp.zeros_like(out_of_plane), inv_r * inv_r / inv_h])


def _rate(chief: Vector6, accel_chief: Vector3 | None) -> Vector3:
    return rtn_rate(chief, jnp.zeros_like(chief[:3]) if accel_chief is None else accel_chief)


def state_eci_to_rtn(chief: Vector6, deputy: Vector6, accel_chief: Vector3 | None = None) -> Vector6:
    """Position and velocity of the deputy as seen from the chief's rotating RTN frame [m, m/s].

    Args:
        chief: (6,) inertial state of the chief [m, m/s].
        deputy: (6,) inertial state of the deputy [m, m/s].
        accel_chief: (3,) inertial acceleration of the chief [m/s^2]; without it the frame turns about N only,
            exact for Keplerian motion.
    """
    rotation = rotation_eci_to_rtn(chief)
    position = rotation @ (deputy[:3] - chief[:3])
    velocity = rotation @ (deputy[3:] - chief[3:]) - cross(_rate(chief, accel_chief), position)
    return jnp.concatenate([position, velocity])


def state_rtn_to_eci(chief: Vector6, rel: Vector6, accel_chief: Vector3 | None = None) -> Vector6:
    """Inertial state of a deputy given relative to the chief's rotating RTN frame [m, m/s].

    Args:
        chief: (6,) inertial state of the chief [m, m/s].
        rel: (6,) relative position and velocity in RTN axes [m, m/s].
        accel_chief: as in `state_eci_to_rtn`, of which this is the inverse.
    """
    to_eci = rotation_eci_to_rtn(chief).T
    position = to_eci @ rel[:3]
    velocity = to_eci @ (rel[3:] + cross(_rate(chief, accel_chief), rel[:3]))
    return chief + jnp.concatenate([position, velocity])
