"""Frames of reference, and what leads from one to another."""

from astrojax.frames.geodetic import geodetic_height
from astrojax.frames.rtn import rotation_eci_to_rtn, rtn_rate, state_eci_to_rtn, state_rtn_to_eci

__all__ = [
    "geodetic_height",
    "rotation_eci_to_rtn",
    "rtn_rate",
    "state_eci_to_rtn",
    "state_rtn_to_eci",
]
