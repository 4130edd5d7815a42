"""Orbits chosen for what the Earth does to them: closed forms and short iterations, first order in J2."""

import math

import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.constants import GM_EARTH, J2, J3, OMEGA_EARTH, R_EARTH

CRITICAL_INCLINATION = math.atan(2.0)
"""Where the perigee stands still under J2: 63.43 deg (and pi less it), of Molniya and Tundra orbits."""

_SUN_RATE = 2.0 * math.pi / (365.242190402 * 86400.0)  # mean Sun along the equator, tropical year
_STEPS = 6


def inclination_sun_synchronous(a: Scalar, e: Scalar) -> FloatScalar:
    """Inclination [rad] at which the node keeps step with the mean Sun.

    Args:
        a: mean semi-major axis [m].
        e: mean eccentricity.

    Validity: secular J2. Beyond a = 12 350 km (circular) there is none: pi is given, whose node is too slow.

    Source: Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., sec. 11.4.1.
    """
    dtype = float_dtype(a, e)
    a, e = jnp.asarray(a, dtype), jnp.asarray(e, dtype)
    ratio = R_EARTH / (a * (1.0 - e) * (1.0 + e))
    cosine = -_SUN_RATE / (1.5 * J2 * ratio * ratio * jnp.sqrt(GM_EARTH / a) / a)
    possible = cosine > -1.0
    cosine = jnp.where(possible, cosine, -0.5)
    return jnp.where(possible, jnp.arctan2(jnp.sqrt((1.0 - cosine) * (1.0 + cosine)), cosine), math.pi)


def radius_geostationary(gm: Scalar = GM_EARTH, rate: Scalar = OMEGA_EARTH) -> FloatScalar:
    """Radius [m] of a circular orbit that turns as fast as its planet, two-body.

    Args:
        gm: gravitational parameter [m^3/s^2].
        rate: of rotation [rad/s].
    """
    dtype = float_dtype(gm, rate)
    gm, rate = jnp.asarray(gm, dtype), jnp.asarray(rate, dtype)
    return jnp.cbrt(gm / rate / rate)


def eccentricity_frozen(a: Scalar, inc: Scalar) -> FloatScalar:
    """Eccentricity at which J2 and J3 hold the perigee of a low orbit at 90 deg: its altitude repeats by latitude.

    Args:
        a: mean semi-major axis [m].
        inc: mean inclination [rad].

    Validity: first order, -J3/(2 J2) (R/a) sin i; e below some 0.01, away from the critical inclination.

    Source: Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., sec. 11.4.2; Cook (1966), Planetary and
    Space Science 14, 433.
    """
    dtype = float_dtype(a, inc)
    return -0.5 * J3 / J2 * R_EARTH / jnp.asarray(a, dtype) * jnp.sin(jnp.asarray(inc, dtype))


def semimajor_axis_repeat(revolutions: Scalar, days: Scalar, e: Scalar, inc: Scalar) -> FloatScalar:
    """Mean semi-major axis [m] at which the ground track closes after so many revolutions in so many nodal days.

    Args:
        revolutions: from node to node.
        days: turns of the Earth below the orbit's node.
        e: mean eccentricity.
        inc: mean inclination [rad].

    Validity: secular J2, whose rates are solved for by six fixed steps (converged to rounding in low orbits).

    Source: Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., sec. 11.4.2.
    """
    dtype = float_dtype(revolutions, days, e, inc)
    revolutions, days, e, inc = (jnp.asarray(x, dtype) for x in (revolutions, days, e, inc))
    cosine = jnp.cos(inc)
    c2 = cosine * cosine
    shape = (1.0 - e) * (1.0 + e)
    wanted = revolutions / days
    a = jnp.cbrt(GM_EARTH / OMEGA_EARTH / OMEGA_EARTH / wanted / wanted)
    for _ in range(_STEPS):
        ratio = R_EARTH / (a * shape)
        k = 0.75 * J2 * ratio * ratio  # of the mean motion
        # n (1 + k (anomaly + perigee)) = wanted (omega - node rate), and the node turns by -2 k n cos i.
        parts = jnp.sqrt(shape) * (3.0 * c2 - 1.0) + (5.0 * c2 - 1.0) - 2.0 * wanted * cosine
        n = wanted * OMEGA_EARTH / (1.0 + k * parts)
        a = jnp.cbrt(GM_EARTH / n / n)
    return a
