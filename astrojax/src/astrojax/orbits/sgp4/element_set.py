"""One published set of elements, whatever it was written as, and the numbers of satellites."""

import math
from typing import NamedTuple

import numpy as np

from astrojax.orbits.sgp4.elements import Sgp4Elements

_LETTERS = "ABCDEFGHJKLMNPQRSTUVWXYZ"  # I and O are left out: they look like digits


class ElementSet(NamedTuple):
    """What a two-line element set or an orbit mean-elements message says."""

    name: str
    number: int  # of the catalogue
    designator: str  # international designator as written, such as "98067A" or "1998-067A"
    elements: Sgp4Elements


def alpha5_to_number(text: str) -> int:
    """Catalogue number of its five columns; a letter first stands for 10 to 33 ("A0000" is 100000).

    Raises:
        ValueError: not one to five digits, nor a letter but I and O before four digits.
    """
    word = text.strip()
    if word.isascii() and word.isdigit() and len(word) <= 5:
        return int(word)
    if len(word) == 5 and word[0] in _LETTERS and word[1:].isascii() and word[1:].isdigit():
        return 10000 * (10 + _LETTERS.index(word[0])) + int(word[1:])
    raise ValueError(f"expected digits, or a capital but I and O before four digits, got {text!r}")


def number_to_alpha5(number: int) -> str:
    """The five columns of a catalogue number from 0 to 339999.

    Raises:
        ValueError: a number outside.
    """
    if not 0 <= number <= 339999:
        raise ValueError(f"number: expected 0 to 339999, got {number}")
    return f"{number:05d}" if number < 100000 else f"{_LETTERS[number // 10000 - 10]}{number % 10000:04d}"


def elements_in_degrees(
    day: int, seconds: float, rev_per_day: float, e: float, angles_deg: tuple, bstar: float
) -> Sgp4Elements:
    """Elements from the units they are published in; `angles_deg`: inclination, node, perigee, mean anomaly."""
    angles = (math.radians(angle) for angle in angles_deg)
    values = (day, seconds, rev_per_day * (2.0 * math.pi / 86400.0), e, *angles, bstar)
    return Sgp4Elements(*(np.float64(value) for value in values))
