"""Epochs from and to calendar text and datetime: on the host, nothing here is traceable."""

import datetime as _datetime
import re
from fractions import Fraction

import jax
import numpy as np

from astrojax.time.epoch import SCALES, Epoch
from astrojax.time.leap_seconds import utc_day_length

_MJD_OF_ORDINAL_ZERO = -678576
_ISO = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?)?\s*(Z|[+-]\d\d:?\d\d)?", re.IGNORECASE
)


def epoch_from_iso(text: str, scale: str = "utc", dtype: np.typing.DTypeLike | None = None) -> Epoch:
    """Epoch of ISO 8601 text such as "2016-12-31T23:59:60.123456789Z".

    Args:
        text: date, or date and time to any number of digits; a leap second is second 60. An offset from UTC ("Z",
            "+02:00") is for UTC only.
        scale: scale the text is in.
        dtype: floating-point type of the epoch; JAX's default without it.

    Raises:
        ValueError: the text is not ISO 8601, names no day or time that exists, or the scale is unknown.
    """
    if scale not in SCALES:
        raise ValueError(f"scale: expected one of {', '.join(SCALES)}, got {scale!r}")
    match = _ISO.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"text: expected an ISO 8601 date and time, got {text!r}")
    year, month, date, hour, minute, second, digits, offset = match.groups()
    if offset is not None and scale != "utc":
        raise ValueError(f"text: an offset is for UTC only, got {text!r} in {scale!r}")
    try:
        day = _datetime.date(int(year), int(month), int(date)).toordinal() + _MJD_OF_ORDINAL_ZERO
    except ValueError as error:
        raise ValueError(f"text: {error}, got {text!r}") from error
    hour, minute, second = int(hour or 0), int(minute or 0), int(second or 0)
    part = Fraction(int(digits), 10 ** len(digits)) if digits else Fraction(0)
    if offset and offset.upper() != "Z":
        sign = -1 if offset[0] == "-" else 1
        ahead = sign * (60 * int(offset[1:3]) + int(offset[-2:]))
    else:
        ahead = 0
    minutes = 60 * hour + minute - ahead
    day, minutes = day + minutes // 1440, minutes % 1440
    length = _day_length(day) if scale == "utc" else Fraction(86400)
    beyond = 60 * minutes + second + part >= length
    if hour > 23 or minute > 59 or beyond or (second > 59 and minutes != 1439):
        raise ValueError(f"text: no such time of that day in {scale}, got {text!r}")
    return _epoch(day, 60 * minutes + second + part, scale, dtype)


def epoch_to_iso(epoch: Epoch, digits: int = 9) -> str:
    """ISO 8601 text of an epoch in its own scale, with "Z" if that is UTC.

    Args:
        epoch: one epoch, not a batch.
        digits: decimals of the seconds, rounded down.

    Raises:
        ValueError: `digits` is not from 0 to 15.
    """
    if not 0 <= digits <= 15:
        raise ValueError(f"digits: expected 0 to 15, got {digits}")
    day, seconds = _exact(epoch)
    # Half a digit of a double-precision second of day: text that was read comes out as it went in.
    seconds = min(seconds + Fraction(1, 10**11), _limit(epoch.scale, day) - Fraction(1, 10**16))
    minute = min(int(seconds // 60), 1439)
    ticks = int((seconds - 60 * minute) * 10**digits)
    date = _datetime.date.fromordinal(day - _MJD_OF_ORDINAL_ZERO)
    part = f".{ticks % 10**digits:0{digits}d}" if digits else ""
    text = f"{date.isoformat()}T{minute // 60:02d}:{minute % 60:02d}:{ticks // 10**digits:02d}{part}"
    return text + ("Z" if epoch.scale == "utc" else "")


def epoch_from_datetime(
    when: _datetime.datetime, scale: str = "utc", dtype: np.typing.DTypeLike | None = None
) -> Epoch:
    """Epoch of a datetime; without a time zone it is read in `scale`.

    Args:
        when: the instant, to a microsecond.
        scale: scale it is in; a time zone is for UTC only.
        dtype: floating-point type of the epoch; JAX's default without it.

    Raises:
        ValueError: a time zone is given in another scale than UTC.
    """
    return epoch_from_iso(when.isoformat(), scale, dtype) if when.tzinfo is None else _zoned(when, scale, dtype)


def _zoned(when, scale, dtype):
    if scale != "utc":
        raise ValueError(f"when: a time zone is for UTC only, got {when!r} in {scale!r}")
    return epoch_from_iso(when.astimezone(_datetime.UTC).replace(tzinfo=None).isoformat(), scale, dtype)


def epoch_to_datetime(epoch: Epoch) -> _datetime.datetime:
    """Datetime of an epoch in UTC, to a microsecond; aware of its zone.

    Args:
        epoch: one epoch of any scale but UT1.

    Raises:
        ValueError: the epoch is inside a leap second, which datetime cannot say.
    """
    text = epoch_to_iso(epoch.to("utc"), 6)
    if text[17:19] == "60":
        raise ValueError(f"epoch: datetime has no leap seconds, got {text}")
    return _datetime.datetime.fromisoformat(text)


def _day_length(day: int) -> Fraction:
    return Fraction(round(float(utc_day_length(np.float64(day))) * 10**6), 10**6)


def _limit(scale: str, day: int) -> Fraction:
    return _day_length(day) if scale == "utc" else Fraction(86400)


def _epoch(day: int, seconds: Fraction, scale: str, dtype) -> Epoch:
    dtype = np.dtype(jax.dtypes.canonicalize_dtype(float) if dtype is None else dtype)
    high = dtype.type(float(seconds))
    return Epoch(dtype.type(day), high, dtype.type(float(seconds - Fraction(float(high)))), scale)


def _exact(epoch: Epoch) -> tuple[int, Fraction]:
    return int(epoch.day), Fraction(float(epoch.seconds)) + Fraction(float(epoch.rest))
