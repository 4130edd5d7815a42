"""Solar flux and magnetic activity at an epoch, from a table of days.

Source: the format and its meaning are CelesTrak's Space Weather Data; which values of the table a density model takes,
Picone et al. (2002).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int, Real, Shaped

from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.time import normalize_epoch

OBSERVED = 0
"""Status of a value: measured."""
PREDICTED = 1
"""Status: predicted for its day."""
MONTHLY = 2
"""Status: predicted for its month, then without magnetic activity, which is taken as quiet."""
OUTSIDE = 3
"""Status: outside the table, where the nearest day's is held."""
QUIET = 10
_SLOTS = 8  # three-hourly values of a day


class SpaceWeather(NamedTuple):
    """What a density model asks for.

    Attributes:
        f107: solar flux at 10.7 cm of the day before [1e-22 W/m^2/Hz], as observed (not at 1 au).
        f107a: its mean of 81 days, centred on this day.
        ap: (7,) magnetic activity: mean of this day; of these three hours, and 3, 6, 9 hours before; mean of 12 to 33
            hours before; of 36 to 57.
        status: `OBSERVED`, `PREDICTED`, `MONTHLY` or `OUTSIDE`.
    """

    f107: Scalar
    f107a: Scalar
    ap: Real[ArrayLike, "7"]
    status: Shaped[ArrayLike, ""] = OBSERVED


class SpaceWeatherTable(NamedTuple):
    """A row a day, without gaps; a pytree, so it may be an argument of a compiled function.

    Attributes:
        first_day: whole MJD of the first row.
        f107: flux of the day, in tenths of 1e-22 W/m^2/Hz.
        f107a: its centred mean of 81 days, likewise.
        ap_daily: mean magnetic activity of the day.
        ap: magnetic activity of each three hours.
        kind: `OBSERVED`, `PREDICTED` or `MONTHLY`.
    """

    first_day: Int[ArrayLike, ""]
    f107: Int[ArrayLike, "N"]
    f107a: Int[ArrayLike, "N"]
    ap_daily: Int[ArrayLike, "N"]
    ap: Int[ArrayLike, "N 8"]
    kind: Int[ArrayLike, "N"]


def constant_space_weather(f107: FloatScalar, f107a: FloatScalar, ap: FloatScalar) -> SpaceWeather:
    """Space weather that has been the same for days.

    Args:
        f107, f107a, ap: as in `SpaceWeather`, `ap` a single value.
    """
    return SpaceWeather(f107, f107a, jnp.broadcast_to(ap, (7,)))


def space_weather(table: SpaceWeatherTable, day: Scalar, seconds: Scalar) -> SpaceWeather:
    """Solar flux and magnetic activity at an epoch.

    Args:
        table: from `load_space_weather`.
        day: whole MJD, UTC.
        seconds: of the day [s], UTC, of any size.

    Validity: the days of the table from its fourth on; `status` tells measured from predicted. Outside, the first or
        last row is held and `status` is `OUTSIDE`. Values are steps: of a day, of three hours.
    """
    dtype = float_dtype(seconds)
    day, seconds = normalize_epoch(day, seconds)
    rows = len(table.f107)
    row = day.astype(jnp.int32) - jnp.asarray(table.first_day, jnp.int32)
    slot = row * _SLOTS + jnp.floor(seconds / 10800.0).astype(jnp.int32)

    def taken(column: Int[ArrayLike, "..."], index: Array) -> Array:
        return jnp.asarray(column)[jnp.clip(index, 0, len(column) - 1)].astype(dtype)

    history = taken(jnp.reshape(jnp.asarray(table.ap), -1), slot - jnp.arange(20, dtype=jnp.int32))
    older = jnp.mean(jnp.reshape(history[4:], (2, 8)), axis=1)
    ap = jnp.concatenate([taken(table.ap_daily, row)[None], history[:4], older])
    kind = jnp.asarray(table.kind)[jnp.clip(row, 0, rows - 1)].astype(jnp.int32)
    outside = (row < 3) | (row >= rows)
    return SpaceWeather(
        f107=taken(table.f107, row - 1) / 10.0,
        f107a=taken(table.f107a, row) / 10.0,
        ap=ap,
        status=jnp.where(outside, OUTSIDE, kind),
    )
