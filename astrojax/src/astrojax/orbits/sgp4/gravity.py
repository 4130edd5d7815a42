"""Gravity constants of SGP4, in its own units: Earth radii and minutes. They belong to the element sets."""

import math
from typing import NamedTuple


class Gravity(NamedTuple):
    """Constants that a set of elements was fitted with, as Python floats."""

    radius: float  # Earth's equatorial radius [m]
    ke: float  # square root of GM [Earth radii^1.5 / minute]
    j2: float
    j3: float
    j4: float


def _gravity(gm_km3: float, radius_km: float, j2: float, j3: float, j4: float) -> Gravity:
    return Gravity(1e3 * radius_km, 60.0 / math.sqrt(radius_km**3 / gm_km3), j2, j3, j4)


GRAVITY = {
    "wgs72": _gravity(398600.8, 6378.135, 0.001082616, -0.00000253881, -0.00000165597),
    "wgs84": _gravity(398600.5, 6378.137, 0.00108262998905, -0.00000253215306, -0.00000161098761),
}
"""By name. Published two-line elements are fitted with WGS 72; other constants make them worse, not better.

Source: Vallado, Crawford, Hujsak, Kelso, Revisiting Spacetrack Report #3, AIAA 2006-6753, table 1.
"""


def gravity_of(name: str) -> Gravity:
    """The constants of a name."""
    if name not in GRAVITY:
        raise ValueError(f"gravity: expected one of {', '.join(GRAVITY)}, got {name!r}")
    return GRAVITY[name]
