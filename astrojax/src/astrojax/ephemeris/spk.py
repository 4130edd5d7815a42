"""Kernels of NAIF's SPICE: positions of bodies as Chebyshev series, read with NumPy and evaluated under `jit`.

`read_spk` takes a `.bsp` file, such as JPL's DE440, into a `Kernel`: a pytree whose segments of types 2 (position) and
3 (position and velocity) are arrays. It brings no kernel along: https://ssd.jpl.nasa.gov/ftp/eph/planets/bsp has them.
Times are TDB; positions are in the kernel's axes, which are those of ICRF for JPL's planets.
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real, Shaped

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, Vector3, Vector6, float_dtype

SPK_INSIDE, SPK_BEFORE, SPK_AFTER = 0, 1, 2

_RECORD = 1024  # bytes
_KM = 1e3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Segment:
    """One body about another over a span, as Chebyshev series of equal length: a pytree.

    Attributes:
        coefficients: (N, components, terms) [m], for type 3 also [m/s]; of record 0 first.
        first_day: of the first record's start, MJD (TDB).
        first_seconds: of that day [s].
        record: length of a record [s].
        target: NAIF's number of the body; static.
        center: NAIF's number of the body it is seen from; static.
        frame: NAIF's number of the axes, 1 for ICRF; static.
        start: of the span that the file declares [s since J2000.0, TDB]; the records may reach farther; static.
        end: of that span; static.
    """

    coefficients: Float[Array | np.ndarray, "*B N components terms"]
    first_day: Real[ArrayLike, "..."]
    first_seconds: Real[ArrayLike, "..."]
    record: Real[ArrayLike, "..."]
    target: int = dataclasses.field(metadata={"static": True})
    center: int = dataclasses.field(metadata={"static": True})
    frame: int = dataclasses.field(metadata={"static": True})
    start: float = dataclasses.field(metadata={"static": True})
    end: float = dataclasses.field(metadata={"static": True})

    def state(self, day: Scalar, seconds: Scalar) -> Vector6:
        """Position and velocity of the target about the centre [m, m/s].

        Args:
            day: whole MJD, TDB.
            seconds: seconds of day [s], TDB.

        Validity: inside the records, which `status` tells; outside, the value is that of their nearest end. The
        velocity is the series' derivative, of type 3 too.
        """
        record, x = self._place(day, seconds)
        series = jnp.asarray(self.coefficients)[record, :3].astype(x.dtype)
        value, slope = _chebyshev(series, x)
        return jnp.concatenate([value, slope * (2.0 / jnp.asarray(self.record, x.dtype))])

    def position(self, day: Scalar, seconds: Scalar) -> Vector3:
        """Position of the target about the centre [m]; arguments as in `state`."""
        record, x = self._place(day, seconds)
        return _chebyshev(jnp.asarray(self.coefficients)[record, :3].astype(x.dtype), x)[0]

    def status(self, day: Scalar, seconds: Scalar) -> Int[Array, ""]:
        """Whether an epoch (MJD, seconds of day, TDB) is inside the records: 0 it is, 1 before it, 2 after it."""
        position = self._elapsed(day, seconds) / jnp.asarray(self.record, float_dtype(day, seconds))
        count = self.coefficients.shape[0]
        late = jnp.where(position > count, SPK_AFTER, SPK_INSIDE)
        return jnp.where(position < 0.0, SPK_BEFORE, late).astype(jnp.int32)

    def _elapsed(self, day: Scalar, seconds: Scalar) -> FloatScalar:
        dtype = float_dtype(day, seconds)
        days = (jnp.asarray(day) - jnp.asarray(self.first_day, jnp.asarray(day).dtype)).astype(dtype)
        return days * c.SECONDS_PER_DAY + (jnp.asarray(seconds, dtype) - jnp.asarray(self.first_seconds, dtype))

    def _place(self, day: Scalar, seconds: Scalar) -> tuple[Int[Array, ""], FloatScalar]:
        """Record of an epoch, and where in it: -1 at its start, 1 at its end."""
        dtype = float_dtype(day, seconds)
        length = jnp.asarray(self.record, dtype)
        # Days and seconds apart, so that float32 keeps the place within the record.
        days = (jnp.asarray(day) - jnp.asarray(self.first_day, jnp.asarray(day).dtype)).astype(dtype)
        per_day = c.SECONDS_PER_DAY / length
        whole = jnp.clip(jnp.floor(self._elapsed(day, seconds) / length), 0, self.coefficients.shape[0] - 1)
        part = (days - whole / per_day) * per_day
        part = part + (jnp.asarray(seconds, dtype) - jnp.asarray(self.first_seconds, dtype)) / length
        return whole.astype(jnp.int32), jnp.clip(2.0 * part - 1.0, -1.0, 1.0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Kernel:
    """The segments of a kernel: a pytree.

    Attributes:
        segments: in the order of the file.
    """

    segments: tuple[Segment, ...]

    def state(self, target: int, center: int, day: Scalar, seconds: Scalar) -> Vector6:
        """Position and velocity of one body about another [m, m/s], over as many segments as it takes.

        Args:
            target, center: NAIF's numbers, such as 399 for the Earth, 301 for the Moon, 10 for the Sun; static.
            day: whole MJD, TDB.
            seconds: seconds of day [s], TDB.

        Validity: as `Segment.state`, of each segment on the way. Of several segments of a pair the first is taken.

        Raises:
            ValueError: no segments lead from one body to the other.
        """
        dtype = float_dtype(day, seconds)
        total = jnp.zeros(6, dtype)
        for sign, segment in self._way(target, center):
            total = total + sign * segment.state(day, seconds)
        return total

    def position(self, target: int, center: int, day: Scalar, seconds: Scalar) -> Vector3:
        """Position of one body about another [m]; arguments as in `state`."""
        return self.state(target, center, day, seconds)[:3]

    def status(self, target: int, center: int, day: Scalar, seconds: Scalar) -> Int[Array, ""]:
        """Largest `Segment.status` of the segments that lead from one body to the other: 0 inside all of them."""
        return jnp.max(jnp.stack([segment.status(day, seconds) for _, segment in self._way(target, center)]))

    def _way(self, target: int, center: int) -> list[tuple[float, Segment]]:
        ways = {center: []}
        found = [center]
        while found and target not in ways:
            body = found.pop(0)
            for segment in self.segments:
                for sign, a, b in ((1.0, segment.center, segment.target), (-1.0, segment.target, segment.center)):
                    if a == body and b not in ways:
                        ways[b] = [*ways[body], (sign, segment)]
                        found.append(b)
        if not ways.get(target):
            bodies = sorted({s.target for s in self.segments} | {s.center for s in self.segments})
            raise ValueError(f"target, center: expected two of the kernel's bodies {bodies}, got {target}, {center}")
        return ways[target]


def _chebyshev(series: Float[Array, "3 terms"], x: FloatScalar) -> tuple[Vector3, Vector3]:
    """Value and derivative by x of three Chebyshev series, by Clenshaw's recurrence and its derivative."""
    b1 = b2 = d1 = d2 = jnp.zeros(3, x.dtype)
    for k in range(series.shape[1] - 1, 0, -1):
        b1, b2, d1, d2 = series[:, k] + 2.0 * x * b1 - b2, b1, 2.0 * (b1 + x * d1) - d2, d1
    return series[:, 0] + x * b1 - b2, b1 + x * d1 - d2


def read_spk(path: str | Path) -> Kernel:
    """Read a binary SPK kernel's segments of types 2 and 3: on the host.

    Args:
        path: a `.bsp` file, of either byte order.

    Raises:
        ValueError: the file is no SPK kernel, is cut short, or holds a segment of another type.

    Source: NAIF, DAF Required Reading and SPK Required Reading (types 2 and 3).
    """
    data = Path(path).read_bytes()
    if data[:7] != b"DAF/SPK":
        raise ValueError(f"path: expected a binary SPK kernel (DAF/SPK), got {data[:8]!r} at the start of {path}")
    order = _byte_order(data, path)
    integers, floats = np.dtype(np.int32).newbyteorder(order), np.dtype(np.float64).newbyteorder(order)
    doubles, whole, forward = (
        int(np.frombuffer(data, integers, 1, offset)[0]) for offset in (8, 12, 76)
    )  # ND, NI, first summary record
    if (doubles, whole) != (2, 6):
        raise ValueError(f"path: expected summaries of 2 doubles and 6 integers, got {doubles} and {whole} in {path}")
    words = np.frombuffer(data[: len(data) // 8 * 8], floats)
    segments, record = [], forward
    while record:
        start = (record - 1) * _RECORD
        if record < 0 or start + _RECORD > len(data):
            raise ValueError(f"path: summary record {record} is beyond the end of {path}")
        following, _, count = np.frombuffer(data, floats, 3, start)
        for k in range(int(count)):
            at = start + 24 + k * 8 * (doubles + (whole + 1) // 2)
            span = np.frombuffer(data, floats, 2, at)
            segments.append(_segment(words, span, np.frombuffer(data, integers, 6, at + 16), path))
        record = int(following)
    return Kernel(tuple(segments))


def _byte_order(data: bytes, path) -> str:
    name = data[88:96]
    if name in (b"LTL-IEEE", b"BIG-IEEE"):
        return "<" if name == b"LTL-IEEE" else ">"
    raise ValueError(f"path: expected the format LTL-IEEE or BIG-IEEE, got {name!r} in {path}")


def _segment(words: Shaped[np.ndarray, "W"], span, numbers, path) -> Segment:
    target, center, frame, kind, first, last = (int(n) for n in numbers)
    if kind not in (2, 3):
        raise ValueError(f"path: segments of types 2 and 3 can be read, got type {kind} for body {target} in {path}")
    if not 1 <= first <= last - 4 or last > len(words):
        raise ValueError(f"path: the segment of body {target} is beyond the end of {path}")
    begin, length, size, count = (float(x) for x in words[last - 4 : last])
    size, count, components = int(size), int(count), 3 if kind == 2 else 6
    if size < 2 + components or (size - 2) % components or count * size != last - first + 1 - 4:
        raise ValueError(f"path: the segment of body {target} has {count} records of {size} words, which do not fit it")
    records = words[first - 1 : last - 4].reshape(count, size).astype(float)
    coefficients = records[:, 2:].reshape(count, components, (size - 2) // components) * _KM
    # Seconds since J2000.0 (noon of MJD 51544) to days and seconds of day, once and for all in double precision.
    day, seconds = divmod(begin + 0.5 * c.SECONDS_PER_DAY, c.SECONDS_PER_DAY)
    return Segment(
        coefficients,
        np.int32(51544 + day),
        np.float64(seconds),
        np.float64(length),
        target,
        center,
        frame,
        *map(float, span),
    )
