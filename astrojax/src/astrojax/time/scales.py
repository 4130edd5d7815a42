"""Epochs and time scales.

An epoch is two numbers, the whole Modified Julian Day and the seconds of that day, in UTC. A fractional day
in float32 would resolve six minutes only; the pair resolves 8 ms in float32 and 15 ps in float64.
Leap seconds: in this file TAI - UTC is the constant 37 s in force since 2017, for speed; earlier epochs are off by the
difference. `leap_seconds` has the table, and `epoch` all scales. UT1 is taken as UTC here, within 0.9 s (7e-5 rad of
Earth rotation); `frames.EOP` knows it, and `sidereal` takes it.
"""

import datetime as _datetime
import math

import jax
import jax.numpy as jnp

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype

_TURN = 2.0 * math.pi
_J2000_DAY = 51544  # J2000.0 is noon of this day


def mjd_from_calendar(when: str | _datetime.datetime) -> tuple[int, float]:
    """Modified Julian Day and seconds of day of a calendar instant (host side, not traceable).

    Args:
        when: ISO 8601 string such as "2026-08-01T00:00:00Z", or a datetime. Without an offset it is UTC.

    Returns:
        (day, seconds): whole MJD and seconds of day in [0, 86400), UTC.

    Raises:
        ValueError: `when` is a string that is not ISO 8601.
        TypeError: `when` is neither a string nor a datetime.
    """
    if isinstance(when, str):
        try:
            when = _datetime.datetime.fromisoformat(when)
        except ValueError as error:
            raise ValueError(f"when: expected an ISO 8601 date and time, got {when!r}") from error
    if not isinstance(when, _datetime.datetime):
        raise TypeError(f"when: expected an ISO 8601 string or datetime.datetime, got {type(when).__name__}")
    if when.tzinfo is not None:
        when = when.astimezone(_datetime.UTC).replace(tzinfo=None)
    elapsed = when - _datetime.datetime(1858, 11, 17)
    return elapsed.days, elapsed.seconds + elapsed.microseconds * 1e-6


def normalize_epoch(day: Scalar, seconds: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """Carry whole days out of `seconds`, so that it lies in [0, 86400).

    Args:
        day: whole MJD.
        seconds: seconds since the start of that day, of any sign and size.
    """
    dtype = float_dtype(day, seconds)
    day, seconds = jnp.asarray(day, dtype), jnp.asarray(seconds, dtype)
    carry = jnp.floor(seconds / c.SECONDS_PER_DAY)
    seconds = seconds - carry * c.SECONDS_PER_DAY
    # A tiny negative input rounds up to a full day: that is the next day's start.
    full = seconds >= c.SECONDS_PER_DAY
    # One so tiny that its share of a day underflows stays negative: that is this day's start.
    return day + carry + jnp.where(full, 1.0, 0.0), jnp.where(full | (seconds < 0), 0.0, seconds)


def utc_to_tai(day: Scalar, seconds: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """UTC epoch to International Atomic Time: MJD and seconds of day (37 s ahead, valid from 2017)."""
    return normalize_epoch(day, seconds + c.TAI_MINUS_UTC)


def utc_to_tt(day: Scalar, seconds: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """UTC epoch to Terrestrial Time: MJD and seconds of day (69.184 s ahead, valid from 2017)."""
    return normalize_epoch(day, seconds + c.TT_MINUS_UTC)


def julian_centuries_tt(day: Scalar, seconds: Scalar) -> FloatScalar:
    """Julian centuries of Terrestrial Time since J2000.0.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
    """
    days, seconds_tt = _since_j2000_tt(day, seconds)
    return (days + seconds_tt / c.SECONDS_PER_DAY) / c.DAYS_PER_CENTURY


def gmst(day: Scalar, seconds: Scalar) -> FloatScalar:
    """Greenwich mean sidereal time [rad, in [0, 2 pi)], with UT1 taken as UTC.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.

    Validity: the IAU 2006 expression to 1e-12 rad in float64 (2e-6 rad in float32) at UT1 = UTC.

    Source: IERS Conventions (2010), TN 36, sec. 5.5: the Earth rotation angle (eq. 5.15) and GMST (eq. 5.32).
    """
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype)
    # A whole turn a day drops out of the whole days before anything is rounded.
    angle = 0.7790572732640 - 0.5 + _cycles(day, 0.00273781191135448, dtype)
    angle = angle + seconds * (1.00273781191135448 / c.SECONDS_PER_DAY) - 0.5 * 0.00273781191135448
    t = julian_centuries_tt(day, seconds)
    arcseconds = 0.014506 + t * (4612.156534 + t * (1.3915817 + t * (-4.4e-7 - t * 2.9956e-5)))
    angle = angle + arcseconds / 1296000.0
    return _TURN * (angle - jnp.floor(angle))


def _since_j2000_tt(day: Scalar, seconds: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """Whole days and seconds of TT since J2000.0 (the seconds within a day and a half of zero)."""
    dtype = float_dtype(day, seconds)
    days = jnp.asarray(day - _J2000_DAY, dtype)
    return days, jnp.asarray(seconds, dtype) + (c.TT_MINUS_UTC - 0.5 * c.SECONDS_PER_DAY)


def _cycles(day: Scalar, turns_per_day: float, dtype: jnp.dtype) -> FloatScalar:
    """Fraction of a turn made in the whole days since J2000's, keeping the precision that days * rate loses.

    The rate's leading bits (to 2^-12) times whole days of up to 2^14 are exact in float32, so their whole
    turns are removed without rounding; only the small rest is rounded. Rates below 1/2 turn a day.
    """
    days = day - _J2000_DAY
    if not isinstance(days, jax.Array):  # the compiler would fold, and reassociate, the lines below
        return jnp.asarray(float(days) * turns_per_day % 1.0, dtype)
    coarse = round(turns_per_day * 4096.0) / 4096.0
    exact = days.astype(dtype) * coarse
    return (exact - jnp.floor(exact)) + days.astype(dtype) * (turns_per_day - coarse)


def phase(day: Scalar, seconds: Scalar, degrees: float, degrees_per_century: float) -> FloatScalar:
    """Angle [rad] of a linear mean element at a UTC epoch, precise in float32 too.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        degrees: value at J2000.0 [deg].
        degrees_per_century: rate [deg per Julian century of TT], below half a turn a day.
    """
    turns_per_day = degrees_per_century / 360.0 / c.DAYS_PER_CENTURY
    dtype = float_dtype(day, seconds)
    _, seconds_tt = _since_j2000_tt(day, seconds)
    turns = degrees / 360.0 + _cycles(day, turns_per_day, dtype)
    turns = turns + seconds_tt * (turns_per_day / c.SECONDS_PER_DAY)
    return _TURN * (turns - jnp.floor(turns))
