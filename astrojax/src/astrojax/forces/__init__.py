"""What accelerates a spacecraft, each force an object, and the sum of them."""

from astrojax.forces.drag import Atmosphere, Drag, HarrisPriester, accel_drag
from astrojax.forces.environment import Environment, earth_rotation, environment_at
from astrojax.forces.force import Force, field_difference, force, relative_acceleration, static
from astrojax.forces.gravity import PointMass, Zonal, accel_two_body, accel_zonal
from astrojax.forces.harris_priester import density_harris_priester
from astrojax.forces.model import ForceModel
from astrojax.forces.spacecraft import Plates, Spacecraft
from astrojax.forces.third_body import GM_BODIES, ThirdBody, accel_third_body

__all__ = [
    "GM_BODIES",
    "Atmosphere",
    "Drag",
    "Environment",
    "Force",
    "ForceModel",
    "HarrisPriester",
    "Plates",
    "PointMass",
    "Spacecraft",
    "ThirdBody",
    "Zonal",
    "accel_drag",
    "accel_third_body",
    "accel_two_body",
    "accel_zonal",
    "density_harris_priester",
    "earth_rotation",
    "environment_at",
    "field_difference",
    "force",
    "relative_acceleration",
    "static",
]
