"""Aerodynamic drag, and the atmosphere it asks for the density of the air."""

from typing import Protocol

import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar, Vector3, dot, safe_sqrt
from astrojax.constants import OMEGA_EARTH
from astrojax.forces.base import Traced, force, static, turned, turned_back
from astrojax.forces.environment import Environment
from astrojax.forces.harris_priester import density_harris_priester
from astrojax.forces.spacecraft import Spacecraft


def accel_drag(r: Vector3, v: Vector3, density: Scalar, mass: Scalar, area: Scalar, cd: Scalar) -> Vector3:
    """Drag acceleration [m/s^2] in an atmosphere that turns with the Earth.

    Args:
        r: (3,) inertial position [m], z along Earth's rotation axis.
        v: (3,) inertial velocity [m/s].
        density: of the air [kg/m^3].
        mass: of the vehicle [kg].
        area: cross-section across the flow [m^2].
        cd: drag coefficient.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.5.
    """
    wind = jnp.stack([v[0] + OMEGA_EARTH * r[1], v[1] - OMEGA_EARTH * r[0], v[2]])
    return (-0.5 * cd * area / mass * density * safe_sqrt(dot(wind, wind))) * wind


class Atmosphere(Protocol):
    """What `Drag` asks for the density of the air."""

    needs: frozenset[str]
    """As of a force."""

    def density(self, r: Vector3, environment: Environment) -> FloatScalar:
        """Density [kg/m^3] at r (3,) [m], in the axes of `environment`, whose z is Earth's axis."""


@force
class HarrisPriester:
    """Density of mean solar activity, by `density_harris_priester`.

    Args:
        exponent: of the diurnal bulge, 2 to 6; an even Python integer costs least, but is traced where the object
            enters a compiled program as an argument.
    """

    exponent: Traced = 6

    needs = frozenset({"sun"})

    def density(self, r: Vector3, environment: Environment) -> FloatScalar:
        """Density [kg/m^3] at r (3,) [m]."""
        return density_harris_priester(r, environment.required("sun", "HarrisPriester"), self.exponent)


@force
class Drag:
    """Drag in an atmosphere that turns with the Earth; acts on mass, drag_area and drag_coefficient.

    Args:
        atmosphere: an `Atmosphere`.
        of_date: static; True turns air and atmosphere about the pole of date, by the environment's rotation. False
            takes the inertial z axis for it (the pole of J2000, 0.15 deg off in 2026).
    """

    atmosphere: Traced = HarrisPriester()
    of_date: bool = static(default=False)

    @property
    def needs(self) -> frozenset[str]:
        return self.atmosphere.needs | ({"rotation"} if self.of_date else set())

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        body = [spacecraft.required(name, "Drag") for name in ("mass", "drag_area", "drag_coefficient")]
        if not self.of_date:
            return accel_drag(r, v, self.atmosphere.density(r, environment), *body)
        rotation = environment.required("rotation", "Drag")
        r, v = turned(rotation, r), turned(rotation, v)
        return turned_back(rotation, accel_drag(r, v, self.atmosphere.density(r, environment.in_body_axes()), *body))
