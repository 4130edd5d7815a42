"""What lights the scene, and where Sun, Moon, Earth and stars stand, as seen from the station."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.constants import ARCSECOND, R_SUN
from astrojax.ephemeris import illumination_conical, moon_position, sun_position
from astrojax.frames import rotation_eci_to_rtn
from astrojax.time import gmst, julian_centuries_tt
from owm_envs.dynamics import RTN_TO_STATION

R_MOON = 1_737_400.0
"""m; IAU Working Group on Cartographic Coordinates, 2015 report."""
PRECESSION = (2306.083227 * ARCSECOND, 2004.191903 * ARCSECOND, 2306.077181 * ARCSECOND)
"""zeta, theta and z, rad a century: the linear terms of Capitaine et al. (2003), A&A 412, eq. 40."""


class Heavens(NamedTuple):
    """Sun, Moon, Earth and the frame of the stars at one instant; float32, station frame."""

    sun: Float[Array, "3"]
    """Unit vector to the Sun."""
    sun_radius: Float[Array, ""]
    """Angular radius, rad."""
    sunlight: Float[Array, ""]
    """Fraction of the Sun's disc that the Earth leaves visible: 0 in the umbra, 1 in light."""
    moon: Float[Array, "3"]
    """Unit vector to the Moon."""
    moon_radius: Float[Array, ""]
    """Angular radius, rad."""
    earth: Float[Array, "3"]
    """From the station to the Earth's centre, m."""
    earth_from_station: Float[Array, "3 3"]
    """Rotation to Earth-fixed axes: x through Greenwich on the equator, z north."""
    icrf_from_station: Float[Array, "3 3"]
    """Rotation to the inertial axes of the stars."""


def heavens(epoch: Float[Array, "2"], r_eci: Float[Array, "3"], v_eci: Float[Array, "3"]) -> Heavens:
    """Where everything stands.

    Args:
        epoch: [MJD day, s of day] UTC.
        r_eci: the station's position from the Earth's centre, inertial axes (EME2000), m.
        v_eci: its velocity, m/s.

    Validity: 1950 to 2050. The Sun to 0.012 deg and the Moon to 0.1 deg (`astrojax.ephemeris`); the Earth
    turns by mean sidereal time about the mean pole of date, to 0.01 deg (no nutation, and UT1 is taken as UTC).
    """
    day, seconds = epoch[0], epoch[1]
    dtype = r_eci.dtype
    relabel = jnp.asarray(RTN_TO_STATION, dtype)
    to_station = _product(relabel, rotation_eci_to_rtn(jnp.concatenate([r_eci, v_eci])))

    sun, moon = sun_position(day, seconds), moon_position(day, seconds)
    to_sun, sun_distance = _unit(sun - r_eci)
    to_moon, moon_distance = _unit(moon - r_eci)
    zeta, theta, z = (rate * julian_centuries_tt(day, seconds) for rate in PRECESSION)
    fixed = _product(_about_z(gmst(day, seconds) - z), _product(_about_y(theta), _about_z(-zeta)))
    exact = Heavens(
        sun=_product(to_station, to_sun),
        sun_radius=R_SUN / sun_distance,
        sunlight=illumination_conical(r_eci, sun),
        moon=_product(to_station, to_moon),
        moon_radius=R_MOON / moon_distance,
        earth=_product(to_station, -r_eci),
        earth_from_station=_product(fixed, to_station.T),
        icrf_from_station=to_station.T,
    )
    return jax.tree.map(lambda x: x.astype(jnp.float32), exact)


def _about_z(angle):
    """Rotation to axes turned by an angle about z."""
    cos, sin, zero, one = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.stack([jnp.stack([cos, sin, zero]), jnp.stack([-sin, cos, zero]), jnp.stack([zero, zero, one])])


def _about_y(angle):
    """Rotation to axes turned by an angle about y."""
    cos, sin, zero, one = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.stack([jnp.stack([cos, zero, -sin]), jnp.stack([zero, one, zero]), jnp.stack([sin, zero, cos])])


def _product(a, b):
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


def _unit(vector):
    distance = jnp.linalg.norm(vector)
    return vector / distance, distance
