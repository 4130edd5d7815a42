"""Space weather tables: the bundled one, and CelesTrak's published files as text or CSV."""

import csv
import datetime
from importlib.resources import files
from pathlib import Path

import numpy as np

from astrojax.forces.atmosphere.space_weather import MONTHLY, OBSERVED, PREDICTED, QUIET, SpaceWeatherTable

_SECTIONS = {"OBSERVED": OBSERVED, "DAILY_PREDICTED": PREDICTED, "MONTHLY_PREDICTED": MONTHLY}
_TYPES = {"OBS": OBSERVED, "INT": OBSERVED, "PRD": PREDICTED, "PRM": MONTHLY}
_AP = [(46 + 4 * i, 50 + 4 * i) for i in range(8)]
_FIELDS = {
    "ap": [(46 + 4 * i, 50 + 4 * i) for i in range(8)],
    "ap_daily": (78, 82),
    "f107": (112, 118),
    "f107a": (118, 124),
}
_MJD_ZERO = datetime.date(1858, 11, 17)


def load_space_weather(path: str | Path | None = None) -> SpaceWeatherTable:
    """A table of space weather (host side).

    Args:
        path: a file as CelesTrak publishes it, `SW-All.txt` or `SW-All.csv`; None for the bundled table, which begins
            on 1957-10-01 and is measured to 2026-10-15, predicted by day to 2026-11-29 and by month to 2041-10-01.

    Returns:
        The table, of NumPy integers.

    Raises:
        ValueError: the file is of neither format, or a row of it cannot be read.
    """
    if path is None:
        with (files(__package__) / "data/space_weather.npz").open("rb") as file, np.load(file) as stored:
            return SpaceWeatherTable(**stored)
    return parse_space_weather(Path(path).read_text(encoding="utf-8"))


def parse_space_weather(text: str) -> SpaceWeatherTable:
    """A table of space weather from the text of a file (host side).

    Args:
        text: of CelesTrak's `SW-All.txt` or `SW-All.csv`, or of part of it.

    Returns:
        The table. A prediction for a month stands for each of its days, with an `ap` of 10 where it has none.

    Raises:
        ValueError: as for `load_space_weather`.
    """
    rows = list(_csv_rows(text) if text.lstrip().startswith("DATE,") else _text_rows(text))
    if not rows:
        raise ValueError("text: expected space weather as CelesTrak publishes it, got no row of data")
    days = np.array([row["day"] for row in rows])
    if np.any(np.diff(days) <= 0):
        raise ValueError(
            f"text: expected rows in order of their days, got {_date(days[np.argmin(np.diff(days))])} twice"
        )
    gaps = [i for i in range(len(rows) - 1) if days[i + 1] - days[i] > 1 and rows[i + 1]["kind"] != MONTHLY]
    if gaps:
        raise ValueError(f"text: expected a row for every day, got none after {_date(days[gaps[0]])}")
    repeat = np.append(np.diff(days), 1)
    columns = {
        name: np.repeat(np.array([row[name] for row in rows], np.int16), repeat, axis=0)
        for name in ("f107", "f107a", "ap_daily", "ap", "kind")
    }
    # What is held over days without a row of their own is known by the month at best.
    columns["kind"][np.setdiff1d(np.arange(len(columns["kind"])), days - days[0])] = MONTHLY
    return SpaceWeatherTable(first_day=np.int32(days[0]), **columns)


def _date(day):
    return (_MJD_ZERO + datetime.timedelta(int(day))).isoformat()


def _row(date, kind, number):
    """A row of integers; `number` gives a field's text."""
    ap = [number("ap", i) for i in range(8)]
    daily = number("ap_daily")
    return {
        "day": (date - _MJD_ZERO).days,
        "kind": kind,
        "f107": round(10 * float(number("f107"))),
        "f107a": round(10 * float(number("f107a"))),
        "ap_daily": int(daily) if daily else QUIET,
        "ap": [int(value) if value else QUIET for value in ap],
    }


def _text_rows(text):
    kind = None
    for n, line in enumerate(text.splitlines(), 1):
        if line.startswith("BEGIN "):
            kind = _SECTIONS.get(line.split()[1])
        elif line.startswith("END "):
            kind = None
        elif kind is not None and line.strip() and not line.startswith("#"):

            def number(name, i=None, line=line):
                start, stop = _FIELDS[name] if i is None else _FIELDS[name][i]
                return line[start:stop].strip()

            try:
                yield _row(datetime.date(*(int(line[a:b]) for a, b in ((0, 4), (4, 7), (7, 10)))), kind, number)
            except ValueError as error:
                raise ValueError(f"text: line {n}: expected a row of space weather, got {line!r}") from error


def _csv_rows(text):
    names = {"ap_daily": "AP_AVG", "f107": "F10.7_OBS", "f107a": "F10.7_OBS_CENTER81"}
    for n, line in enumerate(csv.DictReader(text.lstrip().splitlines()), 2):

        def number(name, i=None, line=line):
            return line[names[name] if i is None else f"AP{i + 1}"].strip()

        try:
            yield _row(datetime.date.fromisoformat(line["DATE"]), _TYPES[line["F10.7_DATA_TYPE"]], number)
        except (ValueError, KeyError, AttributeError) as error:
            raise ValueError(f"text: line {n}: expected a row of space weather, got {list(line.values())}") from error
