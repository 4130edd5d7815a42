"""Where the Sun and the Moon are, and what the Earth hides of them."""

from astrojax.ephemeris.eclipse import illumination_conical
from astrojax.ephemeris.sun_moon import moon_position, sun_position

__all__ = [
    "illumination_conical",
    "moon_position",
    "sun_position",
]
