"""Where the Sun, the Moon and the planets are, and what the Earth hides of the Sun."""

from astrojax.ephemeris.eclipse import eclipse_angles, illumination_conical, illumination_cylindrical
from astrojax.ephemeris.planets import (
    PLANETS,
    TABLES,
    planet_position,
    planet_position_geocentric,
    planet_state,
    planet_status,
)
from astrojax.ephemeris.spk import Kernel, Segment, read_spk
from astrojax.ephemeris.sun_moon import moon_position, sun_position

__all__ = [
    "PLANETS",
    "TABLES",
    "Kernel",
    "Segment",
    "eclipse_angles",
    "illumination_conical",
    "illumination_cylindrical",
    "moon_position",
    "planet_position",
    "planet_position_geocentric",
    "planet_state",
    "planet_status",
    "read_spk",
    "sun_position",
]
