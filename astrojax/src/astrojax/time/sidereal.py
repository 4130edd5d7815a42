"""The Earth's rotation as an angle: that of IAU 2000, and the sidereal time of 1982 that SGP4 is defined with."""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype

_TURN = 2.0 * math.pi
_EXCESS = Fraction("0.00273781191135448")  # turns a day beyond the one
# Its leading bits times whole days are exact, in float32 too for up to 2^14; a double's own rounding of the rate would
# be 2e-14 rad in 2050.
_COARSE = Fraction(round(_EXCESS * 4096), 4096)
_FINE = float(_EXCESS - _COARSE)
_START = float(Fraction("0.7790572732640") - Fraction(1, 2) - _EXCESS / 2)


def earth_rotation_angle(day: Scalar, seconds: Scalar) -> FloatScalar:
    """Earth rotation angle [rad, in [0, 2 pi)].

    Args:
        day: whole MJD, UT1.
        seconds: seconds of day [s], UT1, of any sign.

    Validity: 4e-15 rad in float64, 2e-6 rad in float32.

    Source: IERS Conventions (2010), TN 36, eq. 5.15.
    """
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype)
    turns = _whole_days(day, dtype) + _START
    turns = turns + seconds * float((1 + _EXCESS) / 86400)
    return _TURN * (turns - jnp.floor(turns))


def _whole_days(day: Scalar, dtype: jnp.dtype) -> FloatScalar:
    """Fraction of a turn that the excess makes in the whole days since J2000's."""
    days = day - 51544
    if not isinstance(days, jax.Array):  # the compiler would fold, and reassociate, the lines below
        return jnp.asarray(float(Fraction(float(days)) * _EXCESS % 1), dtype)
    days = days.astype(dtype)
    exact = days * float(_COARSE)
    return (exact - jnp.floor(exact)) + days * _FINE


# GMST of 1982 in seconds of time: 24110.54841 + 8640184.812866 T + 0.093104 T^2 - 6.2e-6 T^3 beside UT1 of the day, T
# in Julian centuries of UT1. Its linear part less that of the Earth rotation angle, exactly, in turns:
_GMST82 = (
    float(Fraction("67310.54841") / 86400 - Fraction("0.7790572732640")),
    float((Fraction("8640184.812866") / 86400) - _EXCESS * 36525),
    0.093104 / 86400.0,
    -6.2e-6 / 86400.0,
)


def gmst82_minus_era(day: Scalar, seconds: Scalar) -> FloatScalar:
    """Greenwich mean sidereal time of 1982 less the Earth rotation angle [rad]: a small angle, precise in float32 too.

    Args:
        day: whole MJD, UT1.
        seconds: seconds of day [s], UT1.

    Source: Aoki et al. 1982, A&A 105, 359, eq. 13.
    """
    dtype = float_dtype(day, seconds)
    days = jnp.asarray(day, dtype) - 51544.0
    t = (days + (jnp.asarray(seconds, dtype) / c.SECONDS_PER_DAY - 0.5)) / c.DAYS_PER_CENTURY
    c0, c1, c2, c3 = _GMST82
    return _TURN * (c0 + t * (c1 + t * (c2 + t * c3)))


def gmst82(day: Scalar, seconds: Scalar) -> FloatScalar:
    """Greenwich mean sidereal time of 1982 [rad, in [0, 2 pi)], to which TEME refers.

    Args:
        day: whole MJD, UT1.
        seconds: seconds of day [s], UT1.

    Validity: 2e-13 rad of ERFA `gmst82` in float64, 2e-6 rad in float32.

    Source: Aoki et al. 1982, A&A 105, 359, eq. 13.
    """
    turns = (earth_rotation_angle(day, seconds) + gmst82_minus_era(day, seconds)) / _TURN
    return _TURN * (turns - jnp.floor(turns))
