"""Earth orientation parameters: where the pole is and how far the Earth has turned, day by day as measured."""

import dataclasses
import functools
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.frames.eop_files import Rows, join, load_compact, parse_c04, parse_finals
from astrojax.time import tai_minus_utc, utc_day_length

EOP_MEASURED = 0
"""Status of an Earth orientation: measured."""
EOP_PREDICTED = 1
"""Status: predicted."""
EOP_BEFORE_TABLE = 2
"""Status: before the table, whose first row is held."""
EOP_AFTER_TABLE = 3
"""Status: after the table, whose last row is held."""

_SI = np.array([c.ARCSECOND, c.ARCSECOND, 1.0, c.ARCSECOND, c.ARCSECOND, 1.0])


class EarthOrientation(NamedTuple):
    """Earth orientation at one instant.

    Attributes:
        x: of the pole of the ITRS in the TIRS [rad].
        y: likewise.
        ut1_minus_utc: [s].
        dx: correction of X of the celestial pole of IAU 2006/2000A [rad].
        dy: that of Y.
        lod: length of day beyond 86400 s [s].
        status: 0 measured, 1 predicted, 2 before the table, 3 after it; outside the table the values are those of its
            nearest row.
    """

    x: FloatScalar
    y: FloatScalar
    ut1_minus_utc: FloatScalar
    dx: FloatScalar
    dy: FloatScalar
    lod: FloatScalar
    status: Int[Array, ""]


def no_orientation(dtype: np.typing.DTypeLike = float) -> EarthOrientation:
    """The orientation that leaves everything out: pole of the model, UT1 = UTC, days of 86400 s.

    Args:
        dtype: floating-point type of its numbers.
    """
    zero = jnp.zeros((), jax.dtypes.canonicalize_dtype(dtype))
    return EarthOrientation(zero, zero, zero, zero, zero, zero, jnp.zeros((), jnp.int32))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class EOP:
    """A table of Earth orientation parameters, a row a day at 0h UTC; a pytree.

    Attributes:
        columns: (N, 6) x, y [rad], UT1 - TAI [s], dX, dY [rad], length of day beyond 86400 s [s].
        first_day: MJD of the first row.
        measured: rows that are measured; the rest is predicted.
    """

    columns: Real[Array | np.ndarray, "*B N 6"]
    first_day: Real[ArrayLike, "..."]
    measured: Real[ArrayLike, "..."]

    def at(self, day: Scalar, seconds: Scalar, method: str = "lagrange") -> EarthOrientation:
        """Orientation at a UTC epoch, interpolated.

        Args:
            day: whole MJD, UTC.
            seconds: seconds of day [s], UTC.
            method: "lagrange" through four rows, as the IERS recommends, or "linear"; static.

        Validity: inside the table; `status` says so. UT1 - TAI is interpolated, so leap seconds do no harm. The tides
        of a day and less (up to 0.5 mas of the pole, 50 us of UT1) are in no such table and are left out.

        Raises:
            ValueError: `method` is neither of the two.

        Source: IERS Gazette 13 (1997), "Measurement of polar motion and UT1 at a given time".
        """
        if method not in ("lagrange", "linear"):
            raise ValueError(f"method: expected 'lagrange' or 'linear', got {method!r}")
        dtype = float_dtype(day, seconds)
        rows = jnp.asarray(self.columns)
        count = rows.shape[0]
        whole = jnp.asarray(day) - jnp.asarray(self.first_day, jnp.asarray(day).dtype)
        part = jnp.asarray(seconds, dtype) / utc_day_length(jnp.asarray(day, dtype))
        part = part.astype(dtype)
        position = whole.astype(dtype) + part
        before, after = position < 0.0, position > count - 1
        width = min(4 if method == "lagrange" else 2, count)
        outside = before | after
        start = jnp.clip(whole.astype(jnp.int32) - (width // 2 - 1), 0, count - width)
        # Whole days first: in float32 a position in the table would lose seconds.
        x = (whole.astype(jnp.int32) - start).astype(dtype) + part
        x = jnp.where(before, 0.0, jnp.where(after, float(width - 1), x)).astype(dtype)
        near = jax.lax.dynamic_slice_in_dim(rows, start, width).astype(dtype)
        values = _weights(x, width) @ near if width > 1 else near[0]
        edge = jnp.where(before, near[0], near[-1])
        values = jnp.where(outside, edge, values)
        predicted = jnp.where(position > jnp.asarray(self.measured, dtype) - 1, EOP_PREDICTED, EOP_MEASURED)
        status = jnp.where(before, EOP_BEFORE_TABLE, jnp.where(after, EOP_AFTER_TABLE, predicted)).astype(jnp.int32)
        ut1_utc = values[2] + tai_minus_utc(day, seconds).astype(dtype)
        return EarthOrientation(values[0], values[1], ut1_utc, values[3], values[4], values[5], status)

    def require(self, day: Real[np.ndarray, "..."] | Scalar) -> None:
        """Refuse days outside the table: on the host, for programs that want an error and not a status.

        Args:
            day: MJD, one or many.

        Raises:
            ValueError: a day is outside the table.
        """
        last = int(self.first_day) + len(self.columns) - 1
        day = np.asarray(day, float)
        if day.size and (day.min() < int(self.first_day) or day.max() > last):
            raise ValueError(
                f"day: expected MJD {int(self.first_day)} to {last}, which the table holds, "
                f"got {day.min()} to {day.max()}"
            )


def _weights(x: FloatScalar, width: int) -> Float[Array, "width"]:
    """Lagrange's weights of the values at 0, 1 ... width - 1."""
    nodes = range(width)
    scale = [float(np.prod([j - k for k in nodes if k != j])) for j in nodes]
    return jnp.stack([functools.reduce(lambda a, b: a * b, [x - k for k in nodes if k != j]) / scale[j] for j in nodes])


def load_eop(*paths: str | Path) -> EOP:
    """The table that the package brings along, or one read from files of the IERS.

    Args:
        paths: files in the format of `eopc04.1962-now` or `finals2000A.all`; of two, the second goes on where the first
            ends. None: the bundled table, C04 from 1962, then finals with a year of predictions.

    Raises:
        ValueError: a file is in neither format, or leaves out a day.
    """
    if not paths:
        return _bundled()
    tables = [read_eop(Path(path).read_text(encoding="utf-8")) for path in paths]
    return _table(functools.reduce(join, tables))


def read_eop(text: str) -> Rows:
    """Rows of a published table, in either format.

    Args:
        text: text of `eopc04.1962-now` or `finals2000A.all` (or `.data`, `.daily`).

    Raises:
        ValueError: the text is in neither format, or leaves out a day.
    """
    first = next((line for line in text.splitlines() if line.strip()), "")
    c04 = first.startswith("#") or (len(first.split()[:1]) == 1 and len(first.split()[0]) == 4)
    return parse_c04(text) if c04 else parse_finals(text)


@functools.cache
def _bundled() -> EOP:
    with resources.files("astrojax.frames").joinpath("data/eop.npz").open("rb") as file:
        return _table(load_compact(file))


def _table(rows: Rows) -> EOP:
    return EOP(rows.columns * _SI, np.int32(rows.first_day), np.int32(rows.measured))
