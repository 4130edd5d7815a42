"""What a station sees: east-north-up, south-east-zenith, azimuth, elevation and range, both ways.

A station is given by its geodetic position (latitude, longitude [rad], height [m]); targets are Earth-fixed.
"""

import math

import jax.numpy as jnp

from astrojax._types import FloatScalar, Matrix3, Vector3, Vector6, dot, safe_sqrt
from astrojax.frames.geodetic import position_geodetic_to_ecef

_TURN = 2.0 * math.pi


def rotation_ecef_to_enu(latitude: FloatScalar, longitude: FloatScalar) -> Matrix3:
    """Rotation matrix from Earth-fixed to east, north, up axes.

    Args:
        latitude, longitude: of the station [rad]; geodetic for the axes of the ellipsoid.

    Source: Montenbruck and Gill, Satellite Orbits, eq. 2.93.
    """
    sin_lat, cos_lat, sin_lon, cos_lon = jnp.sin(latitude), jnp.cos(latitude), jnp.sin(longitude), jnp.cos(longitude)
    return jnp.stack([
        jnp.stack([-sin_lon, cos_lon, jnp.zeros_like(sin_lon)]),
        jnp.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]),
        jnp.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]),
    ])  # fmt: skip


def rotation_ecef_to_sez(latitude: FloatScalar, longitude: FloatScalar) -> Matrix3:
    """Rotation matrix from Earth-fixed to south, east, zenith axes.

    Args:
        latitude, longitude: of the station [rad].

    Source: Vallado, Fundamentals of Astrodynamics and Applications, sec. 3.3.
    """
    east, north, up = rotation_ecef_to_enu(latitude, longitude)
    return jnp.stack([-north, east, up])


def position_ecef_to_enu(station: Vector3, r: Vector3) -> Vector3:
    """Position of a target as a station sees it, east, north, up [m].

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        r: (3,) position of the target [m], Earth-fixed.
    """
    return rotation_ecef_to_enu(station[0], station[1]) @ (r - position_geodetic_to_ecef(station))


def position_enu_to_ecef(station: Vector3, enu: Vector3) -> Vector3:
    """Earth-fixed position [m] of a target a station sees: the inverse of `position_ecef_to_enu`.

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        enu: (3,) east, north, up [m].
    """
    return rotation_ecef_to_enu(station[0], station[1]).T @ enu + position_geodetic_to_ecef(station)


def position_ecef_to_sez(station: Vector3, r: Vector3) -> Vector3:
    """Position of a target as a station sees it, south, east, zenith [m].

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        r: (3,) position of the target [m], Earth-fixed.
    """
    east, north, up = position_ecef_to_enu(station, r)
    return jnp.stack([-north, east, up])


def position_sez_to_ecef(station: Vector3, sez: Vector3) -> Vector3:
    """Earth-fixed position [m] of a target a station sees: the inverse of `position_ecef_to_sez`.

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        sez: (3,) south, east, zenith [m].
    """
    south, east, zenith = sez
    return position_enu_to_ecef(station, jnp.stack([east, -south, zenith]))


def state_ecef_to_enu(station: Vector3, state: Vector6) -> Vector6:
    """Position and velocity of a target as a station on the Earth sees it, east, north, up [m, m/s].

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        state: (6,) position and velocity in the turning Earth-fixed frame [m, m/s].
    """
    velocity = rotation_ecef_to_enu(station[0], station[1]) @ state[3:]
    return jnp.concatenate([position_ecef_to_enu(station, state[:3]), velocity])


def state_enu_to_ecef(station: Vector3, enu: Vector6) -> Vector6:
    """Earth-fixed position and velocity [m, m/s] of a target: the inverse of `state_ecef_to_enu`.

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        enu: (6,) position and velocity, east, north, up [m, m/s].
    """
    velocity = rotation_ecef_to_enu(station[0], station[1]).T @ enu[3:]
    return jnp.concatenate([position_enu_to_ecef(station, enu[:3]), velocity])


def enu_to_azimuth_elevation_range(enu: Vector3) -> Vector3:
    """Azimuth, elevation [rad] and range [m] of a target in east, north, up.

    Args:
        enu: (3,) east, north, up [m].

    Returns:
        (3,) azimuth from north over east in [0, 2 pi) (0 in the zenith), elevation in [-pi/2, pi/2], range.

    Validity: everywhere; derivatives are finite everywhere, and zero for the azimuth in the zenith, where it has none.
    """
    east, north, up = enu
    level = safe_sqrt(east * east + north * north)
    distance = safe_sqrt(dot(enu, enu))
    zenith = level <= jnp.finfo(enu.dtype).eps * distance
    azimuth = jnp.arctan2(jnp.where(zenith, 0.0, east), jnp.where(zenith, 1.0, north))
    here = distance <= 0.0
    elevation = jnp.arctan2(jnp.where(here, 0.0, up), jnp.where(here, 1.0, level))
    return jnp.stack([jnp.where(azimuth < 0.0, azimuth + _TURN, azimuth), elevation, distance])


def azimuth_elevation_range_to_enu(seen: Vector3) -> Vector3:
    """East, north, up [m] of a target seen at an azimuth, an elevation [rad] and a range [m].

    Args:
        seen: (3,) azimuth from north over east, elevation [rad], range [m].
    """
    azimuth, elevation, distance = seen
    level = distance * jnp.cos(elevation)
    return jnp.stack([level * jnp.sin(azimuth), level * jnp.cos(azimuth), distance * jnp.sin(elevation)])


def azimuth_elevation_range(station: Vector3, r: Vector3) -> Vector3:
    """Azimuth, elevation [rad] and range [m] at which a station sees a target; no light time, no refraction.

    Args:
        station: (3,) geodetic latitude, longitude [rad] and height [m].
        r: (3,) position of the target [m], Earth-fixed.
    """
    return enu_to_azimuth_elevation_range(position_ecef_to_enu(station, r))
