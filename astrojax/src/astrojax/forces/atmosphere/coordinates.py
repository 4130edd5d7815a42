"""Where and when, as an atmosphere asks for it: geodetic coordinates, and the day of the year."""

import jax.numpy as jnp
from jaxtyping import Array, Int

from astrojax._types import FloatScalar, Scalar, Vector3, safe_sqrt
from astrojax.constants import WGS84_A, WGS84_F


def geodetic(r: Vector3) -> tuple[FloatScalar, FloatScalar, FloatScalar]:
    """Geodetic latitude, east longitude [rad] and height above the WGS84 ellipsoid [m].

    Args:
        r: (3,) position [m], Earth-fixed.

    Validity: latitude to 1e-9 rad and height to 1e-6 m up to 1000 km, at the poles too; longitude is 0 there.

    Source: Bowring (1985), Survey Review 28(218), 202: one step from his improved start.
    """
    e2 = WGS84_F * (2.0 - WGS84_F)
    ratio = 1.0 - WGS84_F
    x, y, z = r[0] / WGS84_A, r[1] / WGS84_A, r[2] / WGS84_A  # squares of metres overflow float32 when differentiated
    flat = safe_sqrt(x * x + y * y)
    distance = jnp.sqrt(x * x + y * y + z * z)
    # By sines and cosines, without a tangent: the poles are like any other place.
    up = z * (ratio + e2 / distance)
    scale = 1.0 / jnp.sqrt(up * up + flat * flat)
    top = z + e2 / ratio * (up * scale) ** 3
    side = flat - e2 * (flat * scale) ** 3
    size = 1.0 / jnp.sqrt(top * top + side * side)
    sin, cos = top * size, side * size
    height = flat * cos + z * sin - jnp.sqrt(1.0 - e2 * sin * sin)
    on_axis = flat == 0
    longitude = jnp.arctan2(jnp.where(on_axis, 0.0, y), jnp.where(on_axis, 1.0, x))
    return jnp.arctan2(top, side), longitude, height * WGS84_A


def year_and_day(day: Scalar) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Calendar year, and day of the year from 1, of a whole Modified Julian Day.

    Validity: the Gregorian calendar, any year.

    Source: Fliegel and Van Flandern (1968), Communications of the ACM 11(10), 657, with years that begin in March.
    """
    days = jnp.floor(jnp.asarray(day)).astype(jnp.int32) + 678881  # since 0000-03-01
    era, of_era = days // 146097, days % 146097
    year_of_era = (of_era - of_era // 1460 + of_era // 36524 - of_era // 146096) // 365
    of_march_year = of_era - (365 * year_of_era + year_of_era // 4 - year_of_era // 100)
    late = of_march_year >= 306  # January and February belong to the next year
    year = era * 400 + year_of_era + jnp.where(late, 1, 0)
    leap = ((year % 4 == 0) & (year % 100 != 0)) | (year % 400 == 0)
    return year, jnp.where(late, of_march_year - 305, of_march_year + 60 + jnp.where(leap, 1, 0))
