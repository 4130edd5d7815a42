"""What accelerates a spacecraft, and the sum of it."""

from astrojax.forces.drag import accel_drag
from astrojax.forces.gravity import ZONAL_DEGREES, accel_two_body, accel_zonal
from astrojax.forces.harris_priester import density_harris_priester
from astrojax.forces.model import (
    Ballistics,
    Bodies,
    ForceModel,
    OrbitParams,
    accel_gravity_and_perturbations,
    accel_relative,
    celestial_bodies,
    derivative,
)
from astrojax.forces.third_body import accel_third_body

__all__ = [
    "ZONAL_DEGREES",
    "Ballistics",
    "Bodies",
    "ForceModel",
    "OrbitParams",
    "accel_drag",
    "accel_gravity_and_perturbations",
    "accel_relative",
    "accel_third_body",
    "accel_two_body",
    "accel_zonal",
    "celestial_bodies",
    "density_harris_priester",
    "derivative",
]
