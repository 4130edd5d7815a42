"""Epochs and time scales."""

from astrojax.time.scales import (
    gmst,
    julian_centuries_tt,
    mjd_from_calendar,
    normalize_epoch,
    phase,
    utc_to_tai,
    utc_to_tt,
)

__all__ = [
    "gmst",
    "julian_centuries_tt",
    "mjd_from_calendar",
    "normalize_epoch",
    "phase",
    "utc_to_tai",
    "utc_to_tt",
]
