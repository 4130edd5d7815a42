"""Epochs and time scales."""

from astrojax.time.calendar import epoch_from_datetime, epoch_from_iso, epoch_to_datetime, epoch_to_iso
from astrojax.time.epoch import SCALES, Epoch, epoch
from astrojax.time.leap_seconds import (
    LEAP_SECOND_DAYS,
    LEAP_SECONDS_EXPIRE,
    TAI_MINUS_UTC_TABLE,
    UTC_AFTER_TABLE,
    UTC_BEFORE_TABLE,
    UTC_KNOWN,
    centuries_tt,
    tai_from_utc,
    tai_minus_utc,
    tai_minus_utc_of_days,
    utc_day_length,
    utc_from_tai,
    utc_status,
)
from astrojax.time.scales import (
    gmst,
    julian_centuries_tt,
    mjd_from_calendar,
    normalize_epoch,
    phase,
    utc_to_tai,
    utc_to_tt,
)
from astrojax.time.sidereal import earth_rotation_angle, gmst82, gmst82_minus_era
from astrojax.time.tdb import tdb_minus_tt

__all__ = [
    "LEAP_SECONDS_EXPIRE",
    "LEAP_SECOND_DAYS",
    "SCALES",
    "TAI_MINUS_UTC_TABLE",
    "UTC_AFTER_TABLE",
    "UTC_BEFORE_TABLE",
    "UTC_KNOWN",
    "Epoch",
    "centuries_tt",
    "earth_rotation_angle",
    "epoch",
    "epoch_from_datetime",
    "epoch_from_iso",
    "epoch_to_datetime",
    "epoch_to_iso",
    "gmst",
    "gmst82",
    "gmst82_minus_era",
    "julian_centuries_tt",
    "mjd_from_calendar",
    "normalize_epoch",
    "phase",
    "tai_from_utc",
    "tai_minus_utc",
    "tai_minus_utc_of_days",
    "tdb_minus_tt",
    "utc_day_length",
    "utc_from_tai",
    "utc_status",
    "utc_to_tai",
    "utc_to_tt",
]
