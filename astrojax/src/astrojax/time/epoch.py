"""An instant in one of the time scales, as a pytree.

The seconds of the day are kept in two parts, so that an epoch resolves far below a nanosecond at any date: 0.3 ns in
float32, where one part alone would resolve 8 ms.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.time.leap_seconds import _offset, _utc_from_tai
from astrojax.time.tdb import tdb_minus_tt
from astrojax.time.two_parts import two_part_sum

SCALES = ("utc", "tai", "tt", "ut1", "tdb", "gps")
"""Scales that an epoch may count in."""
_TAI_PLUS = {"tai": 0.0, "tt": c.TT_MINUS_TAI, "gps": -19.0}
"""Scales a constant number of seconds from TAI (GPS time: IS-GPS-200, at its epoch of 1980)."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Epoch:
    """An instant: whole days, seconds of the day in two parts, and the scale they count in.

    Attributes:
        day: whole MJD.
        seconds: seconds of day [s], in [0, 86400); in UTC up to the day's length, 86401 with a leap second.
        rest: what rounding takes from `seconds` [s].
        scale: "utc", "tai", "tt", "ut1", "tdb" or "gps"; static.

    `day` and `seconds` are what the functions of epochs in this library take. Adding seconds and subtracting epochs
    counts leap seconds. Make one with `epoch`, `epoch_from_iso` or `epoch_from_datetime`.
    """

    day: Float[ArrayLike, "..."]
    seconds: Float[ArrayLike, "..."]
    rest: Float[ArrayLike, "..."]
    scale: str = dataclasses.field(default="utc", metadata={"static": True})

    def __add__(self, seconds) -> "Epoch":
        """The epoch `seconds` later, in the same scale: atomic seconds, in UT1 seconds of UT1."""
        if isinstance(seconds, Epoch):
            raise TypeError("two epochs cannot be added; seconds can be added to one")
        if self.scale != "utc":
            day, high, low = _arrays(self)
            return _normalized(day, *two_part_sum(high, low, seconds), self.scale)
        return (_tai(self, None) + seconds).to("utc")

    def __sub__(self, other):
        """Seconds since another epoch (of UT1 if both are in UT1, else not of it), or the epoch so much earlier."""
        if not isinstance(other, Epoch):
            return self + -other
        seconds, rest = self.since(other)
        return seconds + rest

    def since(self, other: "Epoch") -> tuple[FloatScalar, FloatScalar]:
        """Seconds since another epoch in two parts, whose sum has twice the digits of the one number.

        Raises:
            ValueError: one of the two epochs is in UT1 and the other is not.
        """
        a, b = self, other
        if a.scale != b.scale or a.scale == "utc":
            a, b = _tai(a, None), _tai(b, None)
        (day, high, low), (day_b, high_b, low_b) = _arrays(a), _arrays(b)
        days = day - day_b
        # 86400 times up to 2^14 days is exact even in float32; whole multiples of 2^14 are so too.
        many = jnp.round(days / 16384.0) * 16384.0
        total, rest = two_part_sum(*_difference(high, low, high_b, low_b), (days - many) * c.SECONDS_PER_DAY)
        return two_part_sum(total, rest, many * c.SECONDS_PER_DAY)

    def to(self, scale: str, ut1_minus_tai: Scalar | None = None) -> "Epoch":
        """The same instant in another scale.

        Args:
            scale: "utc", "tai", "tt", "ut1", "tdb" or "gps".
            ut1_minus_tai: UT1 - TAI [s] at this instant (`frames.EOP.at` knows it); needed to and from UT1 only.

        Validity: UTC from 1960, `utc_status` says where its table ends; TDB as `tdb_minus_tt`.

        Raises:
            ValueError: the scale is unknown, or UT1 is asked for without `ut1_minus_tai`.
        """
        if scale not in SCALES:
            raise ValueError(f"scale: expected one of {', '.join(SCALES)}, got {scale!r}")
        if scale == self.scale:
            return self
        tai = _tai(self, ut1_minus_tai)
        if scale == "tai":
            return tai
        if scale == "utc":
            return Epoch(*_utc_from_tai(tai.day, tai.seconds, tai.rest), "utc")
        if scale == "ut1":
            return dataclasses.replace(tai + _needed(ut1_minus_tai), scale="ut1")
        if scale == "tdb":
            tt = tai.to("tt")
            return dataclasses.replace(tt + tdb_minus_tt(tt.day, tt.seconds), scale="tdb")
        return _shifted(tai, _TAI_PLUS[scale], scale)


def epoch(day: Scalar, seconds: Scalar, scale: str = "utc") -> Epoch:
    """An epoch from whole days and seconds of the day.

    Args:
        day: whole MJD in `scale`.
        seconds: seconds of that day [s]; in UTC within the day, else of any size and sign.
        scale: "utc", "tai", "tt", "ut1", "tdb" or "gps"; static.

    Raises:
        ValueError: the scale is unknown.
    """
    if scale not in SCALES:
        raise ValueError(f"scale: expected one of {', '.join(SCALES)}, got {scale!r}")
    dtype = float_dtype(day, seconds)
    day, seconds = jnp.asarray(day, dtype), jnp.asarray(seconds, dtype)
    rest = jnp.zeros_like(seconds)
    return Epoch(day, seconds, rest, scale) if scale == "utc" else _normalized(day, seconds, rest, scale)


def _arrays(epoch: Epoch) -> tuple[FloatScalar, FloatScalar, FloatScalar]:
    """Its three numbers as arrays: an epoch made on the host has NumPy's."""
    return jnp.asarray(epoch.day), jnp.asarray(epoch.seconds), jnp.asarray(epoch.rest)


def _difference(a: FloatScalar, a_rest: FloatScalar, b: FloatScalar, b_rest: FloatScalar):
    """Difference of two numbers in two parts."""
    high, low = two_part_sum(a, a_rest, -b)
    return high, low - b_rest


def _needed(ut1_minus_tai: Scalar | None) -> Scalar:
    if ut1_minus_tai is None:
        raise ValueError("ut1_minus_tai: UT1 is no function of the other scales; give UT1 - TAI [s], got None")
    return ut1_minus_tai


def _tai(epoch: Epoch, ut1_minus_tai: Scalar | None) -> Epoch:
    """An epoch of any scale in TAI."""
    if epoch.scale == "utc":
        day, seconds, rest = _arrays(epoch)
        offset, drift = _offset(day, seconds.dtype)
        seconds, rest = two_part_sum(seconds, rest, seconds * (drift / c.SECONDS_PER_DAY))
        return _normalized(day, *two_part_sum(seconds, rest, offset), "tai")
    if epoch.scale == "ut1":
        return dataclasses.replace(epoch + -_needed(ut1_minus_tai), scale="tai")
    if epoch.scale == "tdb":
        tt = epoch + -tdb_minus_tt(epoch.day, epoch.seconds)
        return _shifted(tt, -c.TT_MINUS_TAI, "tai")
    return _shifted(epoch, -_TAI_PLUS[epoch.scale], "tai")


def _shifted(epoch: Epoch, amount: float, scale: str) -> Epoch:
    """An epoch a constant number of seconds later, all of the constant's digits used."""
    day, seconds, rest = _arrays(epoch)
    high = float(seconds.dtype.type(amount))
    seconds, rest = two_part_sum(seconds, rest, high)
    return _normalized(day, *two_part_sum(seconds, rest, amount - high), scale)


def _normalized(day: FloatScalar, seconds: FloatScalar, rest: FloatScalar, scale: str) -> Epoch:
    """Whole days carried out of the seconds, which come to lie in [0, 86400)."""
    carry = jnp.floor(seconds / c.SECONDS_PER_DAY)
    seconds, rest = two_part_sum(seconds, rest, -carry * c.SECONDS_PER_DAY)
    # Rounding may leave the seconds a little outside.
    early = (seconds < 0.0) | ((seconds == 0.0) & (rest < 0.0))
    late = seconds >= c.SECONDS_PER_DAY
    late = late & ~((seconds == c.SECONDS_PER_DAY) & (rest < 0.0))
    step = jnp.where(late, 1.0, jnp.where(early, -1.0, 0.0)).astype(seconds.dtype)
    seconds, rest = two_part_sum(seconds, rest, -step * c.SECONDS_PER_DAY)
    return Epoch(day + (carry + step), seconds, rest, scale)
