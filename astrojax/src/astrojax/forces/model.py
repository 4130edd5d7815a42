"""Orbital dynamics: the sum of the forces, ready for an integrator."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, Vector6
from astrojax.constants import GM_EARTH, GM_MOON, GM_SUN
from astrojax.ephemeris import moon_position, sun_position
from astrojax.forces.drag import accel_drag
from astrojax.forces.gravity import ZONAL_DEGREES, accel_two_body, accel_zonal
from astrojax.forces.harris_priester import density_harris_priester
from astrojax.forces.third_body import accel_third_body


@dataclasses.dataclass(frozen=True)
class ForceModel:
    """Which perturbations act (static and hashable: part of the compiled program, never traced).

    Args:
        zonal_degree: highest zonal harmonic, 0 (two-body only) or 2 to 6.
        sun, moon: third-body attraction.
        drag: Harris-Priester drag.

    Raises: ValueError, `zonal_degree` is not one of the allowed values.
    """

    zonal_degree: int = 4
    sun: bool = True
    moon: bool = True
    drag: bool = True

    def __post_init__(self) -> None:
        if isinstance(self.zonal_degree, bool) or self.zonal_degree not in ZONAL_DEGREES:
            raise ValueError(f"zonal_degree: expected one of {ZONAL_DEGREES}, got {self.zonal_degree!r}")


class Bodies(NamedTuple):
    """Geocentric positions (3,) [m] of the Sun and the Moon, mean equator and equinox of J2000."""

    sun: Vector3
    moon: Vector3


class Ballistics(NamedTuple):
    """What drag acts on: mass [kg], cross-section [m^2], drag coefficient (all traced)."""

    mass: Scalar
    area: Scalar
    cd: Scalar


class OrbitParams(NamedTuple):
    """What `derivative` needs beside the state: bodies held over a step, and the vehicle (all traced)."""

    bodies: Bodies
    mass: Scalar
    area: Scalar
    cd: Scalar


def celestial_bodies(day: Scalar, seconds: Scalar) -> Bodies:
    """Positions of the Sun and the Moon at a UTC epoch (whole MJD, seconds of day).

    In the 0.05 s of a step the Moon moves 50 m, 1e-7 of its distance: once a step is plenty.
    """
    return Bodies(sun_position(day, seconds), moon_position(day, seconds))


def accel_gravity_and_perturbations(
    bodies: Bodies, state: Vector6, mass: Scalar, area: Scalar, cd: Scalar, model: ForceModel = ForceModel()
) -> Vector3:
    """Inertial acceleration [m/s^2]: two-body, zonal, Sun, Moon and drag, as `model` selects.

    Args:
        bodies: positions of the Sun and the Moon, from `celestial_bodies`.
        state: (6,) inertial position and velocity [m, m/s], z along Earth's axis.
        mass: of the vehicle [kg].
        area: drag cross-section [m^2].
        cd: drag coefficient.
        model: static.

    Validity: the pole of J2000 stands in for the pole of date (0.15 deg apart in 2026), for zonal terms,
    atmosphere and its rotation alike.
    """
    r, v = state[:3], state[3:]
    accel = accel_zonal(r, model.zonal_degree)
    if model.sun:
        accel = accel + accel_third_body(r, bodies.sun, GM_SUN)
    if model.moon:
        accel = accel + accel_third_body(r, bodies.moon, GM_MOON)
    if model.drag:
        accel = accel + accel_drag(r, v, density_harris_priester(r, bodies.sun), mass, area, cd)
    # The large term last: the small ones keep their digits among themselves.
    return accel_two_body(r, GM_EARTH) + accel


def accel_relative(
    bodies: Bodies,
    chief: Vector6,
    relative: Vector6,
    chief_ballistics: Ballistics,
    ballistics: Ballistics,
    model: ForceModel = ForceModel(),
) -> Vector3:
    """Acceleration [m/s^2] of a vehicle less that of a chief nearby, without subtracting two attractions.

    Args:
        bodies: positions of the Sun and the Moon, from `celestial_bodies`.
        chief: (6,) inertial position and velocity of the chief [m, m/s], z along Earth's axis.
        relative: (6,) position and velocity of the vehicle less the chief's [m, m/s], inertial axes.
        chief_ballistics, ballistics: drag of the chief and of the vehicle.
        model: static.

    Validity: any separation. In float32 it keeps the precision of the separation: there the zonal terms, a thousandth
    of the whole, are expanded about the middle of the two, with an error of third order, 2e-13 m/s^2 at 1 km; float64
    can afford to subtract them.

    Source: Battin's f(q), as in `accel_third_body`: the difference of two attractions is that of a body seen from the
    chief.
    """
    r, rho = chief[:3], relative[:3]
    accel = accel_third_body(rho, -r, GM_EARTH)
    if model.zonal_degree and r.dtype == jnp.float64:
        accel = accel + (accel_zonal(r + rho, model.zonal_degree) - accel_zonal(r, model.zonal_degree))
    elif model.zonal_degree:
        _, gradient = jax.jvp(lambda x: accel_zonal(x, model.zonal_degree), (r + 0.5 * rho,), (rho,))
        accel = accel + gradient
    if model.sun:
        accel = accel + accel_third_body(rho, bodies.sun - r, GM_SUN)
    if model.moon:
        accel = accel + accel_third_body(rho, bodies.moon - r, GM_MOON)
    if model.drag:
        own, station = (
            accel_drag(state[:3], state[3:], density_harris_priester(state[:3], bodies.sun), *body)
            for state, body in ((chief + relative, ballistics), (chief, chief_ballistics))
        )
        accel = accel + (own - station)
    return accel


def derivative(t: Scalar, state: Vector6, params: OrbitParams, model: ForceModel = ForceModel()) -> Vector6:
    """Time derivative of an inertial state, in the form `rk4_step(derivative, t, state, dt, params, model)`.

    Args:
        t: not used, the epoch-dependent bodies are held in `params`.
        state: (6,) inertial position and velocity [m, m/s].
        params: bodies and vehicle.
        model: static.
    """
    del t
    accel = accel_gravity_and_perturbations(params.bodies, state, params.mass, params.area, params.cd, model)
    return jnp.concatenate([state[3:], accel])
