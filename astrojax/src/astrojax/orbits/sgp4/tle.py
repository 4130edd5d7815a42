"""Two-line element sets, with or without a line for the name (host side).

Source: the format's columns as CelesTrak documents them ("NORAD Two-Line Element Set Format"); alpha-5 numbers as
Space-Track does.
"""

import datetime
from typing import NoReturn

from astrojax.orbits.sgp4.element_set import ElementSet, alpha5_to_number, elements_in_degrees

_MJD_ZERO = datetime.date(1858, 11, 17)


def parse_tle(line1: str, line2: str, name: str = "", check: bool = True) -> ElementSet:
    """Elements of one satellite from its two lines.

    Args:
        line1: first line, 69 columns; more are ignored.
        line2: second line.
        name: of the satellite, as a third line before them would give it.
        check: whether the checksums in column 69 must be right; without it that column may be missing.

    Raises:
        ValueError: a malformed line; names line, columns, field and what stands there.
    """
    return _parse(line1, line2, name, check, (1, 2))


def read_tle(text: str, check: bool = True) -> list[ElementSet]:
    """Elements of all satellites in a text of two-line or three-line sets.

    Args:
        text: the contents of a file. Empty lines and lines that begin with "#" are passed over. A line before a
            pair is its name, with or without the "0 " of three-line sets.
        check: as for `parse_tle`.

    Raises:
        ValueError: a malformed line, by its number in the text, or a line 1 without line 2.
    """
    lines = [(i, line.rstrip()) for i, line in enumerate(text.splitlines(), 1)]
    lines = [(i, line) for i, line in lines if line and not line.startswith("#")]
    found, name, at = [], "", 0
    while at < len(lines):
        number, line = lines[at]
        if line.startswith("1 ") and (at + 1 == len(lines) or lines[at + 1][1].startswith("2 ") or len(line) >= 68):
            if at + 1 == len(lines) or not lines[at + 1][1].startswith("2 "):
                raise ValueError(f"line {number}: a line 1 without a line 2 after it")
            after, second = lines[at + 1]
            found.append(_parse(line, second, name, check, (number, after)))
            name, at = "", at + 2
        elif line.startswith("2 ") and len(line) >= 68:
            raise ValueError(f"line {number}: a line 2 without a line 1 before it")
        else:
            name, at = line.removeprefix("0 ").strip(), at + 1
    return found


def _checksum(line: str) -> int:
    """Digits summed modulo ten, a minus sign counting one, over the first 68 columns."""
    return sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10


class _Line:
    """One line, whose fields are read by column and complained about by line and column."""

    def __init__(self, text: str, number: int, first: str, check: bool):
        self.text, self.number = text.rstrip(), number
        if not self.text.isascii():
            at = next(i for i, c in enumerate(self.text) if not c.isascii())
            raise ValueError(f"line {number}, column {at + 1}: expected ASCII, got {self.text[at]!r}")
        if self.text[:2] != first + " ":
            raise ValueError(f"line {number}, columns 1-2: expected {first + ' '!r}, got {self.text[:2]!r}")
        least = 69 if check else 63
        if len(self.text) < least:
            raise ValueError(f"line {number}: expected at least {least} columns, got {len(self.text)}")
        if check and str(_checksum(self.text)) != self.text[68]:
            raise ValueError(
                f"line {number}, column 69 (checksum): expected {_checksum(self.text)}, got {self.text[68]!r}"
            )

    def fail(self, first: int, last: int, field: str, expected: str) -> NoReturn:
        got = self.text[first - 1 : last]
        raise ValueError(f"line {self.number}, columns {first}-{last} ({field}): expected {expected}, got {got!r}")

    def get(self, first: int, last: int) -> str:
        return self.text[first - 1 : last]

    def digits(self, first: int, last: int, field: str) -> str:
        word = self.get(first, last).replace(" ", "0")  # some writers pad with blanks
        if not word.isdigit():
            self.fail(first, last, field, "digits")
        return word

    def decimal(self, first: int, last: int, field: str) -> float:
        word = self.get(first, last).strip()
        if not word or set(word) - set("+-.0123456789"):
            self.fail(first, last, field, "a decimal number")
        try:
            return float(word)
        except ValueError:
            self.fail(first, last, field, "a decimal number")

    def exponential(self, first: int, last: int, field: str) -> float:
        """A number such as " 12345-3", for 0.12345e-3."""
        word = self.get(first, last)
        sign, mantissa, exponent = word[0], word[1:-2].replace(" ", "0"), word[-2:].replace(" ", "+")
        if sign not in " +-0" or not mantissa.isdigit() or exponent[0] not in "+-0" or not exponent[1].isdigit():
            self.fail(first, last, field, "a sign, five digits and a signed exponent")
        size = float(f"0.{mantissa}e{exponent}")
        return -size if sign == "-" else size


def _within(
    line: _Line, value: int | float, low: int | float, high: int | float, columns: tuple, field: str
) -> int | float:
    if not low <= value <= high:
        line.fail(*columns, field, f"{low:g} to {high:g}")
    return value


def _parse(line1: str, line2: str, name: str, check: bool, numbers: tuple[int, int]) -> ElementSet:
    one, two = _Line(line1, numbers[0], "1", check), _Line(line2, numbers[1], "2", check)
    ids = []
    for line in (one, two):
        try:
            ids.append(alpha5_to_number(line.get(3, 7)))
        except ValueError as error:
            raise ValueError(f"line {line.number}, columns 3-7 (satellite number): {error}") from error
    if ids[0] != ids[1]:
        two.fail(3, 7, "satellite number", f"that of line {one.number}, {one.get(3, 7)!r}")

    year = int(one.digits(19, 20, "epoch year"))
    year += 1900 if year >= 57 else 2000
    whole = int(one.digits(21, 23, "epoch day"))
    leap = year % 4 == 0  # 1957 to 2056
    _within(one, whole, 1, 366 if leap else 365, (21, 23), "epoch day")
    if one.get(24, 24) != ".":
        one.fail(24, 24, "epoch day", "a decimal point")
    fraction = float("0." + one.digits(25, 32, "epoch day"))
    day = (datetime.date(year, 1, 1) - _MJD_ZERO).days + whole - 1

    bstar = one.exponential(54, 61, "B*")
    e = float("0." + two.digits(27, 33, "eccentricity"))
    inc = _within(two, two.decimal(9, 16, "inclination"), 0.0, 180.0, (9, 16), "inclination")
    raan = _within(two, two.decimal(18, 25, "node"), -360.0, 360.0, (18, 25), "node")
    argp = _within(two, two.decimal(35, 42, "argument of perigee"), -360.0, 360.0, (35, 42), "argument of perigee")
    m = _within(two, two.decimal(44, 51, "mean anomaly"), -360.0, 360.0, (44, 51), "mean anomaly")
    motion = two.decimal(53, 63, "mean motion")
    if not 0.0 < motion < 20.0:
        two.fail(53, 63, "mean motion", "more than 0 and less than 20")
    elements = elements_in_degrees(day, 86400.0 * fraction, motion, e, (inc, raan, argp, m), bstar)
    return ElementSet(name, ids[0], one.get(10, 17).strip(), elements)
