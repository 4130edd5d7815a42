"""What accelerates a spacecraft, each force an object, and the sum of them."""

from astrojax.forces import atmosphere
from astrojax.forces.base import Force, field_difference, force, relative_acceleration, static
from astrojax.forces.drag import Atmosphere, Drag, HarrisPriester, accel_drag
from astrojax.forces.environment import Environment, earth_rotation, environment_at
from astrojax.forces.fields import BUNDLED, GravityField, gravity_field, load_gfc
from astrojax.forces.gravity import PointMass, Zonal, accel_two_body, accel_zonal
from astrojax.forces.harris_priester import density_harris_priester
from astrojax.forces.model import ForceModel
from astrojax.forces.polyhedral import (
    PolyhedralGravity,
    Polyhedron,
    accel_polyhedron,
    polyhedron,
    potential_polyhedron,
    solid_angle_polyhedron,
)
from astrojax.forces.radiation import (
    SOLAR_PRESSURE,
    SolarRadiation,
    accel_radiation,
    accel_radiation_plates,
)
from astrojax.forces.relativity import Relativity, accel_lense_thirring, accel_schwarzschild
from astrojax.forces.spacecraft import Plates, Spacecraft
from astrojax.forces.spherical_harmonics import (
    SphericalHarmonics,
    accel_spherical_harmonics,
    potential_spherical_harmonics,
)
from astrojax.forces.third_body import GM_BODIES, ThirdBody, accel_third_body
from astrojax.forces.tides import SolidTides, solid_tide_coefficients

__all__ = [
    "BUNDLED",
    "GM_BODIES",
    "SOLAR_PRESSURE",
    "Atmosphere",
    "Drag",
    "Environment",
    "Force",
    "ForceModel",
    "GravityField",
    "HarrisPriester",
    "Plates",
    "PointMass",
    "PolyhedralGravity",
    "Polyhedron",
    "Relativity",
    "SolarRadiation",
    "SolidTides",
    "Spacecraft",
    "SphericalHarmonics",
    "ThirdBody",
    "Zonal",
    "accel_drag",
    "accel_lense_thirring",
    "accel_polyhedron",
    "accel_radiation",
    "accel_radiation_plates",
    "accel_schwarzschild",
    "accel_spherical_harmonics",
    "accel_third_body",
    "accel_two_body",
    "accel_zonal",
    "atmosphere",
    "density_harris_priester",
    "earth_rotation",
    "environment_at",
    "field_difference",
    "force",
    "gravity_field",
    "load_gfc",
    "polyhedron",
    "potential_polyhedron",
    "potential_spherical_harmonics",
    "relative_acceleration",
    "solid_angle_polyhedron",
    "solid_tide_coefficients",
    "static",
]
