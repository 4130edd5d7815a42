"""What sensors say of an orbit: functions of one state, for the filters' `measure`.

States are inertial, position and velocity. A station is given by its inertial state too, and by its local axes: whoever
knows the Earth's rotation makes them.
"""

import math
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax._types import FloatScalar, Matrix3, Scalar, Vector3, Vector6, dot, inverse_norm
from astrojax.constants import OMEGA_EARTH


def measure_range(state: Vector6, station: Vector6) -> Float[Array, "1"]:
    """Distance from a station [m].

    Args:
        state, station: (6,) inertial [m, m/s], apart.
    """
    return 1.0 / inverse_norm(state[:3] - station[:3])[None]


def measure_range_and_rate(state: Vector6, station: Vector6) -> Float[Array, "2"]:
    """Distance from a station [m] and its rate [m/s].

    Args:
        state, station: (6,) inertial [m, m/s], apart.
    """
    away, speed = state[:3] - station[:3], state[3:] - station[3:]
    inverse = inverse_norm(away)
    return jnp.stack([1.0 / inverse, dot(away, speed) * inverse])


def measure_azimuth_elevation(state: Vector6, station: Vector6, rotation_eci_to_enu: Matrix3) -> Float[Array, "2"]:
    """Azimuth from north over east, -pi to pi, and elevation [rad].

    Args:
        state, station: (6,) inertial [m, m/s].
        rotation_eci_to_enu: (3, 3) rows: the station's east, north and up in inertial axes.

    Validity: not straight overhead, where azimuth has no derivative. Its residual needs `wrapped`.
    """
    east, north, up = rotation_eci_to_enu @ (state[:3] - station[:3])
    return jnp.stack([jnp.arctan2(east, north), jnp.arctan2(up, jnp.sqrt(east * east + north * north))])


def measure_position(state: Vector6) -> Vector3:
    """Position [m], as a satellite navigation receiver gives it."""
    return state[:3]


def wrapped(angles: tuple[bool, ...]) -> Callable[[Float[Array, "m"], Float[Array, "m"]], Float[Array, "m"]]:
    """A residual for measurements of which some are angles: taken between -pi and pi.

    Args:
        angles: for each component whether it is one; static.
    """

    def residual(measured: Float[Array, "m"], expected: Float[Array, "m"]) -> Float[Array, "m"]:
        away = measured - expected
        turned = away - 2.0 * math.pi * jnp.round(away / (2.0 * math.pi))
        return jnp.where(np.asarray(angles), turned, away)

    return residual


def station_state(
    latitude: FloatScalar, longitude: FloatScalar, radius: Scalar, sidereal_angle: Scalar
) -> tuple[Vector6, Matrix3]:
    """Inertial state of a place on a spherical, steadily turning Earth, and the rotation to its east, north and up.

    Args:
        latitude, longitude: geocentric [rad].
        radius: from Earth's centre [m].
        sidereal_angle: of Greenwich [rad].

    Validity: for studies and tests; `frames` has the ellipsoid and the true rotation.
    """
    angle = longitude + sidereal_angle
    sin_a, cos_a, sin_l, cos_l = jnp.sin(angle), jnp.cos(angle), jnp.sin(latitude), jnp.cos(latitude)
    zero = jnp.zeros_like(sin_a * sin_l)
    east = jnp.stack([-sin_a, cos_a, zero])
    north = jnp.stack([-sin_l * cos_a, -sin_l * sin_a, cos_l])
    up = jnp.stack([cos_l * cos_a, cos_l * sin_a, sin_l])
    return jnp.concatenate([radius * up, (OMEGA_EARTH * radius * cos_l) * east]), jnp.stack([east, north, up])
