"""Atmospheric density models."""

from astrojax.atmosphere.harris_priester import density_harris_priester

__all__ = ["density_harris_priester"]
