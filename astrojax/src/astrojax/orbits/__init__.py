"""Orbits that have a formula: Keplerian elements, relative motion, and `sgp4`, a package of its own."""

from astrojax.orbits import sgp4
from astrojax.orbits.hcw import accel_hcw, stm_hcw
from astrojax.orbits.keplerian import (
    cartesian_to_keplerian,
    keplerian_to_cartesian,
    mean_motion,
    propagate_keplerian,
    secular_rates_j2,
    solve_kepler,
)

__all__ = [
    "accel_hcw",
    "cartesian_to_keplerian",
    "keplerian_to_cartesian",
    "mean_motion",
    "propagate_keplerian",
    "secular_rates_j2",
    "sgp4",
    "solve_kepler",
    "stm_hcw",
]
