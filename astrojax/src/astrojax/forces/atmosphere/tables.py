"""The published numbers of NRLMSISE-00, laid out so that an expansion is one matrix product.

The 11 expansions of the upper atmosphere have 150 coefficients each and the 14 of the lower one have 100. Each
coefficient multiplies one associated Legendre function and one function of time, place and activity. Here coefficients
of the same function of time are gathered in one term, spread over the Legendre functions they multiply.

Source: Picone, Hedin, Drob and Aikin (2002), J. Geophys. Res. 107(A12), 1468, doi:10.1029/2002JA009430, appendix A;
the numbers are the model's own block data. Columns count from 0.
"""

import functools
from importlib.resources import files
from typing import NamedTuple

import numpy as np

LEGENDRE = tuple((n, m) for m, top in enumerate((6, 6, 7, 6)) for n in range(m, top + 1))
"""Degree and order of the associated Legendre functions the model uses."""

# Each term: (degree, order) of the Legendre function -> column of its coefficient.
UPPER_TERMS: dict[str, dict[tuple[int, int], int]] = {
    "steady": {(2, 0): 1, (4, 0): 2, (6, 0): 22, (1, 0): 26},
    "steady_flux": {(2, 0): 14},
    "annual": {(0, 0): 18},
    "semiannual": {(0, 0): 15, (2, 0): 16},
    "annual_odd": {(1, 0): 9, (3, 0): 10},
    "semiannual_odd": {(1, 0): 37},
    "diurnal_cos": {(1, 1): 3, (3, 1): 4, (5, 1): 27},
    "diurnal_cos_annual": {(2, 1): 11},
    "diurnal_sin": {(1, 1): 6, (3, 1): 7, (5, 1): 28},
    "diurnal_sin_annual": {(2, 1): 12},
    "semidiurnal_cos": {(2, 2): 5, (4, 2): 41},
    "semidiurnal_cos_annual": {(3, 2): 23, (5, 2): 35},
    "semidiurnal_sin": {(2, 2): 8, (4, 2): 42},
    "semidiurnal_sin_annual": {(3, 2): 33, (5, 2): 36},
    "terdiurnal_cos": {(3, 3): 40},
    "terdiurnal_cos_annual": {(4, 3): 94, (6, 3): 48},
    "terdiurnal_sin": {(3, 3): 39},
    "terdiurnal_sin_annual": {(4, 3): 93, (6, 3): 46},
    "daily": {(0, 0): 32, (2, 0): 45, (4, 0): 34},
    "daily_annual": {(1, 0): 100, (3, 0): 101, (5, 0): 102},
    "daily_diurnal": {(1, 1): 121, (3, 1): 122, (5, 1): 123},
    "storm": {(0, 0): 50, (2, 0): 96, (4, 0): 54},
    "storm_annual": {(1, 0): 125, (3, 0): 126, (5, 0): 127},
    "storm_diurnal": {(1, 1): 128, (3, 1): 129, (5, 1): 130},
    "longitude_cos": {(2, 1): 64, (4, 1): 65, (6, 1): 66, (1, 1): 103, (3, 1): 104, (5, 1): 105},
    "longitude_cos_annual": {(1, 1): 109, (3, 1): 110, (5, 1): 111},
    "longitude_sin": {(2, 1): 90, (4, 1): 91, (6, 1): 92, (1, 1): 106, (3, 1): 107, (5, 1): 108},
    "longitude_sin_annual": {(1, 1): 112, (3, 1): 113, (5, 1): 114},
    "universal": {(1, 0): 68, (3, 0): 69, (5, 0): 70},
    "universal_longitude": {(3, 2): 76, (5, 2): 77, (7, 2): 78},
    "daily_longitude": {(2, 1): 60, (4, 1): 61, (6, 1): 62},
    "daily_longitude_annual": {(1, 1): 115, (3, 1): 116, (5, 1): 117},
    "daily_universal": {(1, 0): 83, (3, 0): 84, (5, 0): 85},
    "storm_longitude": {(2, 1): 52, (4, 1): 98, (6, 1): 67},
    "storm_longitude_annual": {(1, 1): 133, (3, 1): 134, (5, 1): 135},
    "storm_universal": {(1, 0): 55, (3, 0): 56, (5, 0): 57},
}
LOWER_TERMS: dict[str, dict[tuple[int, int], int]] = {
    "flux": {(0, 0): 21},
    "steady": {(2, 0): 1, (4, 0): 2, (6, 0): 22, (1, 0): 26, (3, 0): 14, (5, 0): 59},
    "annual": {(0, 0): 18, (2, 0): 47, (4, 0): 29},
    "semiannual": {(0, 0): 15, (2, 0): 16, (4, 0): 30},
    "annual_odd": {(1, 0): 9, (3, 0): 10, (5, 0): 20},
    "semiannual_odd": {(1, 0): 37},
    "diurnal_cos": {(1, 1): 3, (3, 1): 4},
    "diurnal_cos_annual": {(2, 1): 11},
    "diurnal_sin": {(1, 1): 6, (3, 1): 7},
    "diurnal_sin_annual": {(2, 1): 12},
    "semidiurnal_cos": {(2, 2): 5, (4, 2): 41},
    "semidiurnal_cos_annual": {(3, 2): 23, (5, 2): 35},
    "semidiurnal_sin": {(2, 2): 8, (4, 2): 42},
    "semidiurnal_sin_annual": {(3, 2): 33, (5, 2): 36},
    "terdiurnal_cos": {(3, 3): 40},
    "terdiurnal_sin": {(3, 3): 39},
    "daily": {(0, 0): 32},
    "daily_cross": {(2, 0): 45},
    "storm": {(0, 0): 50},
    "storm_cross": {(2, 0): 96},
    "longitude_cos": {(2, 1): 64, (4, 1): 65, (6, 1): 66, (1, 1): 74, (3, 1): 75, (5, 1): 76},
    "longitude_sin": {(2, 1): 90, (4, 1): 91, (6, 1): 92, (1, 1): 77, (3, 1): 78, (5, 1): 79},
}

# Rows of the upper expansions.
EXOSPHERE, GRADIENT, BASE, HOT = 0, 1, 5, 10
SPECIES = (2, 3, 4, 6, 7, 8, 9)  # He, O, N2, O2, Ar, H, N
NITROGEN_ATOM = 9
# Rows of the lower ones: temperatures at the nodes, and their gradients where two splines meet.
THERMOSPHERE, GRADIENT_THERMOSPHERE = slice(0, 4), 12
MESOSPHERE, GRADIENT_MESOSPHERE = slice(4, 7), 13
STRATOSPHERE, GRADIENT_GROUND = slice(7, 11), 11


class Tables(NamedTuple):
    """NumPy arrays, float64.

    Attributes:
        upper: (11, 150) coefficients, as published; lower: (14, 100).
        upper_terms: (terms * 11, functions) the same by term and Legendre function; lower_terms alike.
        turbopause: (2, 25); temperature: (10,); density: (8, 10); mean: (10,): the other tables, as published.
    """

    upper: np.ndarray
    lower: np.ndarray
    upper_terms: np.ndarray
    lower_terms: np.ndarray
    turbopause: np.ndarray
    temperature: np.ndarray
    density: np.ndarray
    mean: np.ndarray


@functools.cache
def tables() -> Tables:
    """The tables, read once."""
    with (files(__package__) / "data/nrlmsise00.npz").open("rb") as file, np.load(file) as stored:
        found = dict(stored)
    return Tables(
        upper_terms=_spread(found["upper"], UPPER_TERMS),
        lower_terms=_spread(found["lower"], LOWER_TERMS),
        **found,
    )


def _spread(coefficients: np.ndarray, terms: dict[str, dict[tuple[int, int], int]]) -> np.ndarray:
    spread = np.zeros((len(terms), len(coefficients), len(LEGENDRE)))
    for i, term in enumerate(terms.values()):
        for function, column in term.items():
            spread[i, :, LEGENDRE.index(function)] = coefficients[:, column]
    return spread.reshape(-1, len(LEGENDRE))
