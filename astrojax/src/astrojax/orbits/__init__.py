"""Orbits that have a formula: Keplerian elements, relative motion, and `sgp4`, a package of its own."""

from astrojax.orbits import sgp4
from astrojax.orbits.anomalies import (
    eccentric_to_mean,
    eccentric_to_true,
    hyperbolic_to_mean,
    hyperbolic_to_true,
    mean_to_eccentric,
    mean_to_hyperbolic,
    mean_to_true,
    parabolic_mean_to_true,
    true_to_eccentric,
    true_to_hyperbolic,
    true_to_mean,
    true_to_parabolic_mean,
)
from astrojax.orbits.equinoctial import (
    cartesian_to_conic,
    cartesian_to_equinoctial,
    conic_to_cartesian,
    equinoctial_to_cartesian,
    equinoctial_to_keplerian,
    keplerian_to_equinoctial,
)
from astrojax.orbits.events import event_altitude, event_apsis, event_eclipse, event_node
from astrojax.orbits.hcw import accel_hcw, stm_hcw
from astrojax.orbits.keplerian import (
    cartesian_to_keplerian,
    keplerian_to_cartesian,
    mean_motion,
    propagate_keplerian,
    secular_rates_j2,
    solve_kepler,
)
from astrojax.orbits.mean_elements import mean_to_osculating, osculating_to_mean
from astrojax.orbits.relative_elements import keplerian_to_roe, roe_to_keplerian, stm_roe_j2
from astrojax.orbits.special import (
    CRITICAL_INCLINATION,
    eccentricity_frozen,
    inclination_sun_synchronous,
    radius_geostationary,
    semimajor_axis_repeat,
)
from astrojax.orbits.universal import propagate_universal
from astrojax.orbits.yamanaka_ankersen import stm_yamanaka_ankersen

__all__ = [
    "CRITICAL_INCLINATION",
    "accel_hcw",
    "cartesian_to_conic",
    "cartesian_to_equinoctial",
    "cartesian_to_keplerian",
    "conic_to_cartesian",
    "eccentric_to_mean",
    "eccentric_to_true",
    "eccentricity_frozen",
    "equinoctial_to_cartesian",
    "equinoctial_to_keplerian",
    "event_altitude",
    "event_apsis",
    "event_eclipse",
    "event_node",
    "hyperbolic_to_mean",
    "hyperbolic_to_true",
    "inclination_sun_synchronous",
    "keplerian_to_cartesian",
    "keplerian_to_equinoctial",
    "keplerian_to_roe",
    "mean_motion",
    "mean_to_eccentric",
    "mean_to_hyperbolic",
    "mean_to_osculating",
    "mean_to_true",
    "osculating_to_mean",
    "parabolic_mean_to_true",
    "propagate_keplerian",
    "propagate_universal",
    "radius_geostationary",
    "roe_to_keplerian",
    "secular_rates_j2",
    "semimajor_axis_repeat",
    "sgp4",
    "solve_kepler",
    "stm_hcw",
    "stm_roe_j2",
    "stm_yamanaka_ankersen",
    "true_to_eccentric",
    "true_to_hyperbolic",
    "true_to_mean",
    "true_to_parabolic_mean",
]
