"""The Earth orientation tables that the IERS publishes, read into arrays: on the host, with NumPy alone.

Columns of a table: x, y of the pole [arcsec], UT1 - TAI [s], dX, dY of the celestial pole [arcsec], length of day
beyond 86400 s [s]; a row a day, at 0h UTC.
"""

from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from astrojax.time.leap_seconds import tai_minus_utc_of_days

_UNITS = np.array([1e-6, 1e-6, 1e-7, 1e-6, 1e-6, 1e-7])
"""What one unit of the compact file is, by column: the last digit that is printed."""


class Rows(NamedTuple):
    """Daily rows of Earth orientation parameters.

    Attributes:
        first_day: MJD of the first row.
        columns: (N, 6), as the module says.
        measured: rows that are measured; the rest is predicted.
    """

    first_day: int
    columns: np.ndarray
    measured: int

    @property
    def last_day(self) -> int:
        return self.first_day + len(self.columns) - 1


def parse_c04(text: str) -> Rows:
    """Rows of a C04 series of the IERS (format of 2020 on: `eopc04.1962-now`).

    Args:
        text: the file's text.

    Raises:
        ValueError: a line is not of that format, or a day is missing.
    """
    days, rows = [], []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        words = line.split()
        try:
            numbers = [float(word) for word in words[4:13]]
            if len(numbers) != 9:
                raise ValueError("13 columns or more expected")
        except ValueError as error:
            raise ValueError(f"line {number}: not a row of a C04 series ({error}): {line!r}") from error
        mjd, x, y, ut1_utc, dx, dy, _, _, lod = numbers
        days.append(mjd)
        rows.append([x, y, ut1_utc, dx, dy, lod])
    return _rows(days, rows, len(rows))


def parse_finals(text: str) -> Rows:
    """Rows of a finals file of the IERS for IAU 2000A (`finals2000A.all`, `.data` or `.daily`).

    Bulletin A is taken. Rows end where UT1 - UTC does; where dX, dY or the length of day are missing, dX and dY stay
    as they were and the length of day follows from UT1.

    Args:
        text: the file's text.

    Raises:
        ValueError: a line is not of that format, or a day is missing.
    """
    days, rows, measured = [], [], 0
    for number, line in enumerate(text.splitlines(), 1):
        if not line[58:68].strip():
            if rows or not line.strip():
                break
            continue
        try:
            mjd, x, y, ut1_utc = (float(line[a:b]) for a, b in ((7, 15), (18, 27), (37, 46), (58, 68)))
            lod, dx, dy = (_or_nan(line[a:b]) * 1e-3 for a, b in ((79, 86), (97, 106), (116, 125)))
        except ValueError as error:
            raise ValueError(f"line {number}: not a row of a finals2000A file ({error}): {line!r}") from error
        days.append(mjd)
        rows.append([x, y, ut1_utc, dx, dy, lod])
        if line[16] == "I" and line[57] == "I":
            measured = len(rows)
    return _rows(days, rows, measured)


def _or_nan(text: str) -> float:
    return float(text) if text.strip() else np.nan


def _rows(days: list[float], rows: list[list[float]], measured: int) -> Rows:
    if not rows:
        raise ValueError("text: no row of Earth orientation parameters in it")
    steps = np.diff(days)
    if np.any(steps != 1.0) or days[0] != round(days[0]):
        where = int(np.argmax(steps != 1.0)) if np.any(steps != 1.0) else 0
        raise ValueError(f"text: expected a row for each day, got MJD {days[where : where + 2]}")
    columns = np.array(rows)
    columns[:, 2] -= tai_minus_utc_of_days(np.array(days))
    for column in (3, 4):
        bad = np.isnan(columns[:, column])
        last = np.maximum.accumulate(np.where(bad, 0, np.arange(len(bad))))
        columns[:, column] = np.nan_to_num(columns[last, column])
    slope = -np.gradient(columns[:, 2]) if len(columns) > 1 else np.zeros(len(columns))
    columns[:, 5] = np.where(np.isnan(columns[:, 5]), slope, columns[:, 5])
    return Rows(int(days[0]), columns, measured)


def join(early: Rows, late: Rows) -> Rows:
    """The first table, and the rows of the second that come after it."""
    start = early.last_day + 1 - late.first_day
    if not 0 <= start <= len(late.columns):
        raise ValueError(f"late: expected to begin by MJD {early.last_day + 1}, got {late.first_day}")
    measured = (
        len(early.columns) + max(0, late.measured - start) if early.measured == len(early.columns) else early.measured
    )
    return Rows(early.first_day, np.concatenate([early.columns, late.columns[start:]]), measured)


def save_compact(path: Path, rows: Rows) -> None:
    """Write rows as whole units and second differences, column by column: a tenth of the text's size."""
    whole = np.round(rows.columns / _UNITS).astype(np.int64)
    twice = np.diff(whole, n=2, axis=0, prepend=np.zeros((2, 6), np.int64))
    np.savez_compressed(path, first_day=rows.first_day, measured=rows.measured, twice=twice.T.astype(np.int32))


def load_compact(file: str | Path | BinaryIO) -> Rows:
    """Read what `save_compact` wrote.

    Args:
        file: path or open binary file.
    """
    with np.load(file) as stored:
        whole = np.cumsum(np.cumsum(stored["twice"].T.astype(np.int64), axis=0), axis=0)
        return Rows(int(stored["first_day"]), whole * _UNITS, int(stored["measured"]))
