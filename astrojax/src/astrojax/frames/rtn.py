"""The radial, transverse, normal frame of a vehicle in orbit.

Axes: R along the position, N along the orbital angular momentum, T = N x R completing the triad.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Matrix3, Vector3, Vector6, cross, dot, inverse_norm
from astrojax.attitude import skew

Matrix6 = Float[Array, "6 6"]


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


def jacobian_eci_to_rtn(state: Vector6, accel: Vector3 | None = None, *, rotating: bool = False) -> Matrix6:
    """Derivative of the RTN components of a small deviation by its inertial ones.

    Args:
        state: (6,) inertial position and velocity of the frame's owner [m, m/s].
        accel: (3,) its inertial acceleration [m/s^2], for the rate of a rotating frame; without it Keplerian.
        rotating: velocities as seen from the rotating frame; else along its axes only, as the conjunction messages of
            CCSDS 508.0 have their covariances. Static.

    Returns:
        (6, 6) matrix J: deviations are J d, covariances J P J^T.

    Source: Alfriend et al., Spacecraft Formation Flying (2010), ch. 2; CCSDS 508.0-B-1, annex E.
    """
    rotation = rotation_eci_to_rtn(state)
    zero = jnp.zeros_like(rotation)
    turning = zero
    if rotating:
        turning = -skew(_rate(state, accel)) @ rotation
    return jnp.block([[rotation, zero], [turning, rotation]])


def covariance_eci_to_rtn(
    state: Vector6, covariance: Matrix6, accel: Vector3 | None = None, *, rotating: bool = False
) -> Matrix6:
    """Covariance of position and velocity in RTN axes of one in inertial axes.

    Args:
        state: (6,) inertial position and velocity of the frame's owner [m, m/s].
        covariance: (6, 6) in inertial axes [m^2, m^2/s, m^2/s^2].
        accel, rotating: as in `jacobian_eci_to_rtn`.
    """
    jacobian = jacobian_eci_to_rtn(state, accel, rotating=rotating)
    return jacobian @ covariance @ jacobian.T


def covariance_rtn_to_eci(
    state: Vector6, covariance: Matrix6, accel: Vector3 | None = None, *, rotating: bool = False
) -> Matrix6:
    """Covariance of position and velocity in inertial axes of one in RTN axes: the inverse of `covariance_eci_to_rtn`.

    Args:
        state: (6,) inertial position and velocity of the frame's owner [m, m/s].
        covariance: (6, 6) in RTN axes [m^2, m^2/s, m^2/s^2].
        accel, rotating: as in `jacobian_eci_to_rtn`.
    """
    forward = jacobian_eci_to_rtn(state, accel, rotating=rotating)
    rotation, turning = forward[:3, :3], forward[3:, :3]
    # The inverse of a block triangle whose diagonal blocks are the same rotation.
    back = jnp.block([[rotation.T, jnp.zeros_like(rotation)], [-rotation.T @ turning @ rotation.T, rotation.T]])
    return back @ covariance @ back.T
