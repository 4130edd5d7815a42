"""Orbit determination: Kalman filters over any propagation and measurement, and measurements of an orbit."""

from astrojax.estimate.gaussian import Gaussian, Innovation, innovation, joseph_update, normalized_square, symmetric
from astrojax.estimate.kalman import difference, ekf_predict, ekf_update
from astrojax.estimate.measurements import (
    measure_azimuth_elevation,
    measure_position,
    measure_range,
    measure_range_and_rate,
    station_state,
    wrapped,
)
from astrojax.estimate.unscented import Spread, sigma_points, ukf_predict, ukf_update

__all__ = [
    "Gaussian",
    "Innovation",
    "Spread",
    "difference",
    "ekf_predict",
    "ekf_update",
    "innovation",
    "joseph_update",
    "measure_azimuth_elevation",
    "measure_position",
    "measure_range",
    "measure_range_and_rate",
    "normalized_square",
    "sigma_points",
    "station_state",
    "symmetric",
    "ukf_predict",
    "ukf_update",
    "wrapped",
]
