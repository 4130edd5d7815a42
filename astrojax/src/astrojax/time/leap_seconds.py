"""Leap seconds: how far TAI is ahead of UTC, and how long a UTC day is.

From 1972 UTC ticks atomic seconds and jumps by whole ones. From 1960 to 1971 it ran slower than TAI at a rate that was
announced, and jumped by fractions. Both are in the table, which a day is looked up in: works under `jit`.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.time.scales import normalize_epoch
from astrojax.time.two_parts import two_part_sum

# MJD from which a line holds, TAI - UTC [s] at `reference`, MJD of reference, drift [s a day].
# Source: IERS Bulletin C 1 to 72 (UTC-TAI.history); before 1972: Explanatory Supplement (1992), table 2.58.1.
_TABLE = np.array([
    [36934, 1.4178180, 37300, 0.001296],
    [37300, 1.4228180, 37300, 0.001296],
    [37512, 1.3728180, 37300, 0.001296],
    [37665, 1.8458580, 37665, 0.0011232],
    [38334, 1.9458580, 37665, 0.0011232],
    [38395, 3.2401300, 38761, 0.001296],
    [38486, 3.3401300, 38761, 0.001296],
    [38639, 3.4401300, 38761, 0.001296],
    [38761, 3.5401300, 38761, 0.001296],
    [38820, 3.6401300, 38761, 0.001296],
    [38942, 3.7401300, 38761, 0.001296],
    [39004, 3.8401300, 38761, 0.001296],
    [39126, 4.3131700, 39126, 0.002592],
    [39887, 4.2131700, 39126, 0.002592],
])  # fmt: skip
_LEAPS = np.array([
    41317, 41499, 41683, 42048, 42413, 42778, 43144, 43509, 43874, 44239, 44786, 45151, 45516, 46247,
    47161, 47892, 48257, 48804, 49169, 49534, 50083, 50630, 51179, 53736, 54832, 56109, 57204, 57754,
])  # fmt: skip

LEAP_SECOND_DAYS = np.concatenate([_TABLE[:, 0].astype(int), _LEAPS])
"""MJD (UTC) at whose start each value of TAI - UTC begins to hold."""
TAI_MINUS_UTC_TABLE = np.concatenate([_TABLE[:, 1], np.arange(10.0, 38.0)])
"""TAI - UTC [s] of each; before 1972 that of the reference day, to which the drift is added."""
_REFERENCE = np.concatenate([_TABLE[:, 2].astype(int), _LEAPS])
_DRIFT = np.concatenate([_TABLE[:, 3], np.zeros(len(_LEAPS))])

LEAP_SECONDS_EXPIRE = 61584
"""MJD (2027-06-28) until which no further leap second can come: Bulletin C 72 of July 2026."""

UTC_KNOWN = 0
"""Status of a UTC epoch: its leap seconds are known."""
UTC_BEFORE_TABLE = 1
"""Status: before the table begins."""
UTC_AFTER_TABLE = 2
"""Status: after the table expires: a leap second may have been announced since."""


def _line(day: Scalar) -> Int[Array, ""]:
    """Index of the line of the table that holds on a day (the first also holds before it)."""
    day = jnp.asarray(day)
    first = jnp.asarray(LEAP_SECOND_DAYS[1:], day.dtype if jnp.issubdtype(day.dtype, jnp.floating) else jnp.int32)
    return jnp.sum(first <= day, dtype=jnp.int32)  # counting vectorises, a search does not


def _offset(day: Scalar, dtype: jnp.dtype) -> tuple[FloatScalar, FloatScalar]:
    """TAI - UTC [s] at the start of a UTC day, and what it grows by in a day."""
    line = _line(day)
    drift = jnp.asarray(_DRIFT, dtype)[line]
    days = (jnp.asarray(day) - jnp.asarray(_REFERENCE, jnp.asarray(day).dtype)[line]).astype(dtype)
    # Before the table UTC had no such definition: the first value stays, without drift.
    days = jnp.maximum(days, float(_TABLE[0, 0] - _TABLE[0, 2]))
    drift = jnp.where(jnp.asarray(day) < int(_TABLE[0, 0]), 0.0, drift).astype(dtype)
    return jnp.asarray(TAI_MINUS_UTC_TABLE, dtype)[line] + days * jnp.asarray(_DRIFT, dtype)[line], drift


def tai_minus_utc(day: Scalar, seconds: Scalar) -> FloatScalar:
    """TAI - UTC [s] at a UTC epoch, from the table of leap seconds.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC, within that day: from 86400 on it is inside a leap second.

    Validity: exact from 1972 until the table's end, and from 1960 with the drift of that time. `utc_status` says
    whether an epoch is inside: before 1960 the first value is held, after the last leap second the last.

    Source: IERS Bulletin C; Explanatory Supplement to the Astronomical Almanac (1992), sec. 2.58.
    """
    dtype = float_dtype(day, seconds)
    offset, drift = _offset(day, dtype)
    return offset + jnp.asarray(seconds, dtype) * (drift / c.SECONDS_PER_DAY)


def tai_minus_utc_of_days(days: np.ndarray) -> np.ndarray:
    """TAI - UTC [s] at the start of UTC days, on the host and in double precision whatever JAX's setting.

    Args:
        days: whole MJD, from 1960 on.

    Raises:
        ValueError: a day is before the table.
    """
    line = np.searchsorted(LEAP_SECOND_DAYS, days, side="right") - 1
    if np.any(line < 0):
        raise ValueError(f"days: expected MJD {LEAP_SECOND_DAYS[0]} (1960) or later, got {np.min(days)}")
    return TAI_MINUS_UTC_TABLE[line] + (days - _REFERENCE[line]) * _DRIFT[line]


def utc_status(day: Scalar) -> Int[Array, ""]:
    """Whether TAI - UTC is known on a day: 0 it is, 1 before 1960, 2 after the table's end (a leap second may come).

    Args:
        day: whole MJD, UTC.
    """
    day = jnp.asarray(day)
    late = jnp.where(day >= LEAP_SECONDS_EXPIRE, UTC_AFTER_TABLE, UTC_KNOWN)
    return jnp.where(day < int(LEAP_SECOND_DAYS[0]), UTC_BEFORE_TABLE, late).astype(jnp.int32)


def utc_day_length(day: Scalar) -> FloatScalar:
    """Length [s, of UTC] of a UTC day: 86401 with a leap second, else 86400 (in 1961 to 1968 with fractions).

    Args:
        day: whole MJD, UTC.
    """
    dtype = float_dtype(day)
    step = jnp.asarray(_steps(), dtype)
    ends = jnp.asarray(day) + 1 == jnp.asarray(LEAP_SECOND_DAYS, jnp.asarray(day).dtype)
    return c.SECONDS_PER_DAY + jnp.sum(jnp.where(ends, step, 0.0))


@functools.cache
def _steps() -> np.ndarray:
    """UTC seconds by which the day before each line is longer than 86400."""
    days = LEAP_SECOND_DAYS
    before = np.concatenate([[0], np.arange(len(days) - 1)])
    old = TAI_MINUS_UTC_TABLE[before] + (days - _REFERENCE[before]) * _DRIFT[before]
    new = TAI_MINUS_UTC_TABLE + (days - _REFERENCE) * _DRIFT
    steps = np.round((new - old) / (1.0 + _DRIFT[before] / c.SECONDS_PER_DAY), 9)
    steps[0] = 0.0
    return steps


def utc_from_tai(day: Scalar, seconds: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """TAI epoch to UTC by the table of leap seconds: whole MJD and seconds of that UTC day.

    Args:
        day: whole MJD, TAI.
        seconds: seconds of day [s], TAI, in [0, 86400).

    Returns:
        (day, seconds): inside a leap second the seconds are in [86400, 86401).

    Validity: as `tai_minus_utc`, of which this is the inverse.
    """
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype)
    day, seconds, _ = _utc_from_tai(jnp.asarray(day, dtype), seconds, jnp.zeros_like(seconds))
    return day, seconds


def _utc_from_tai(day: FloatScalar, seconds: FloatScalar, rest: FloatScalar) -> tuple[FloatScalar, ...]:
    """The same of seconds in two parts, `rest` what rounding would take from `seconds`."""
    today = _unstretched(*_offset(day, seconds.dtype), seconds, rest)
    yesterday = _unstretched(*_offset(day - 1.0, seconds.dtype), *two_part_sum(seconds, rest, c.SECONDS_PER_DAY))
    early = (today[0] < 0.0) | ((today[0] == 0.0) & (today[1] < 0.0))
    seconds, rest = (jnp.where(early, old, new) for old, new in zip(yesterday, today))
    return jnp.where(early, day - 1.0, day), seconds, rest


def _unstretched(offset: FloatScalar, drift: FloatScalar, seconds: FloatScalar, rest: FloatScalar):
    """UTC seconds, in two parts, of TAI seconds of the same day number."""
    elapsed, rest = two_part_sum(seconds, rest, -offset)
    share = drift / c.SECONDS_PER_DAY
    return two_part_sum(elapsed, rest, -elapsed * (share / (1.0 + share)))


def tai_from_utc(day: Scalar, seconds: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """UTC epoch to TAI by the table of leap seconds: whole MJD and seconds of day in [0, 86400).

    Args:
        day: whole MJD, UTC.
        seconds: seconds of that day [s], UTC.

    Validity: as `tai_minus_utc`. `utc_to_tai` is the same from 2017 on, with the offset a constant.
    """
    dtype = float_dtype(day, seconds)
    return normalize_epoch(day, jnp.asarray(seconds, dtype) + tai_minus_utc(day, seconds))


def centuries_tt(day: Scalar, seconds: Scalar) -> FloatScalar:
    """Julian centuries of TT since J2000.0 of a UTC epoch, by the table of leap seconds.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
    """
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype) + (tai_minus_utc(day, seconds).astype(dtype) + c.TT_MINUS_TAI)
    days = (jnp.asarray(day) - 51544).astype(dtype)
    return (days + (seconds / c.SECONDS_PER_DAY - 0.5)) / c.DAYS_PER_CENTURY
