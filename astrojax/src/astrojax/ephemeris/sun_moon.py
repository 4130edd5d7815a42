"""Low-precision analytic positions of the Sun and the Moon.

Frame: Earth's mean equator and equinox of J2000 (EME2000, within 0.02 arcsec of GCRF), geocentric, geometric
(no aberration or light time). Trigonometric functions are the cost here, so the Moon's 29 harmonics are built
from the sines and cosines of four angles by the addition theorem.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array

from astrojax._types import Scalar, Vector3
from astrojax.constants import ARCSECOND, OBLIQUITY_J2000
from astrojax.time import julian_centuries_tt, phase

# Harmonics of the Moon: amplitude and multiples of (l, l', F, D).
_MOON_LONGITUDE = (  # sines, arcsec
    (22640, (1, 0, 0, 0)),
    (769, (2, 0, 0, 0)),
    (-4586, (1, 0, 0, -2)),
    (2370, (0, 0, 0, 2)),
    (-668, (0, 1, 0, 0)),
    (-412, (0, 0, 2, 0)),
    (-212, (2, 0, 0, -2)),
    (-206, (1, 1, 0, -2)),
    (192, (1, 0, 0, 2)),
    (-165, (0, 1, 0, -2)),
    (148, (1, -1, 0, 0)),
    (-125, (0, 0, 0, 1)),
    (-110, (1, 1, 0, 0)),
    (-55, (0, 0, 2, -2)),
)
_MOON_LATITUDE_AMPLITUDE = 18520.0  # arcsec, its argument below
_MOON_LATITUDE_ARGUMENT = ((412, (0, 0, 2, 0)), (541, (0, 1, 0, 0)))  # sines, arcsec
_MOON_LATITUDE = (  # sines, arcsec
    (-526, (0, 0, 1, -2)),
    (44, (1, 0, 1, -2)),
    (-31, (-1, 0, 1, -2)),
    (-25, (-2, 0, 1, 0)),
    (-23, (0, 1, 1, -2)),
    (21, (-1, 0, 1, 0)),
    (11, (0, -1, 1, -2)),
)
_MOON_DISTANCE = (  # cosines, km
    (-20905, (1, 0, 0, 0)),
    (-3699, (-1, 0, 0, 2)),
    (-2956, (0, 0, 0, 2)),
    (-570, (2, 0, 0, 0)),
    (246, (2, 0, 0, -2)),
    (-205, (0, 1, 0, -2)),
    (-171, (1, 0, 0, 2)),
    (-152, (1, 1, 0, -2)),
)


def sun_position(day: Scalar, seconds: Scalar) -> Vector3:
    """Geocentric position of the Sun [m], mean equator and equinox of J2000.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.

    Validity: 1950 to 2050, to 0.012 deg in direction and 0.01 % in distance (an unperturbed ellipse).

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.3.2. Added: the motion of the
    perihelion in the fixed frame, 0.3226 deg a century (Simon et al. 1994, A&A 282, 663), without
    which the direction is off by 0.09 deg in 2026.
    """
    m = phase(day, seconds, 357.5256, 35999.049)
    sin_m, cos_m = jnp.sin(m), jnp.cos(m)
    perihelion = math.radians(282.9400) + math.radians(0.3226) * julian_centuries_tt(day, seconds)
    longitude = perihelion + m + sin_m * (6892.0 * ARCSECOND + 2 * 72.0 * ARCSECOND * cos_m)
    distance = 149.619e9 - 2.499e9 * cos_m - 0.021e9 * (2 * cos_m * cos_m - 1)
    return _equatorial(distance * jnp.cos(longitude), distance * jnp.sin(longitude), jnp.zeros_like(distance))


def moon_position(day: Scalar, seconds: Scalar) -> Vector3:
    """Geocentric position of the Moon [m], mean equator and equinox of J2000.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.

    Validity: 1950 to 2050, to 0.1 deg in direction and 600 km in distance (the series is truncated).

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.3.2.
    """
    # The general precession, 1.3972 deg a century, comes off the longitude to refer it to the fixed equinox.
    mean_longitude = phase(day, seconds, 218.31617, 481267.88088 - 1.3972)
    arguments = (
        phase(day, seconds, 134.96292, 477198.86753),
        phase(day, seconds, 357.52543, 35999.04944),
        phase(day, seconds, 93.27283, 483202.01873),
        phase(day, seconds, 297.85027, 445267.11135),
    )
    harmonic = _harmonics(arguments)

    def sines(table):
        return sum(amplitude * harmonic(multiples)[1] for amplitude, multiples in table) * ARCSECOND

    inequality = sines(_MOON_LONGITUDE)
    longitude = mean_longitude + inequality
    argument = arguments[2] + inequality + sines(_MOON_LATITUDE_ARGUMENT)
    latitude = _MOON_LATITUDE_AMPLITUDE * ARCSECOND * jnp.sin(argument) + sines(_MOON_LATITUDE)
    kilometres = 385000.0 + sum(amplitude * harmonic(m)[0] for amplitude, m in _MOON_DISTANCE)

    distance, flat = 1e3 * kilometres, 1e3 * kilometres * jnp.cos(latitude)
    return _equatorial(flat * jnp.cos(longitude), flat * jnp.sin(longitude), distance * jnp.sin(latitude))


def _equatorial(x: Array, y: Array, z: Array) -> Vector3:
    """Ecliptic components turned to the mean equator of J2000.

    Selected and rotated by a matrix product, though a stack would do: XLA evaluates a product once, but would
    sum the whole series again for each component of a stack and for each force that reads it.
    """
    axis = jnp.arange(3)
    ecliptic = jnp.where(axis == 0, x, jnp.where(axis == 1, y, z))
    cos, sin = math.cos(OBLIQUITY_J2000), math.sin(OBLIQUITY_J2000)
    rotation = jnp.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]], dtype=ecliptic.dtype)
    return jnp.matmul(rotation, ecliptic, precision=jax.lax.Precision.HIGHEST)


def _harmonics(arguments):
    """Map integer multiples of the arguments to (cos, sin) of their sum, sharing partial results."""
    base = tuple((jnp.cos(a), jnp.sin(a)) for a in arguments)

    def add(a, b):
        return a[0] * b[0] - a[1] * b[1], a[1] * b[0] + a[0] * b[1]

    @functools.cache
    def multiple(index, k):
        if k < 0:
            cos, sin = multiple(index, -k)
            return cos, -sin
        return base[index] if k == 1 else add(multiple(index, k - 1), base[index])

    @functools.cache
    def harmonic(multiples):
        parts = [multiple(index, k) for index, k in enumerate(multiples) if k]
        return functools.reduce(add, parts)

    return harmonic
