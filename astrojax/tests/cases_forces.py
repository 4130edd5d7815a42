"""The forces' example calls for the conformance tests, and their rows of its table."""

import jax.numpy as jnp
import numpy as np

from astrojax import forces

A = np.array
STATE = A([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])
SUN = A([-9.4e10, 1.09e11, 4.7e10])
MOON = A([3.58e8, -1.49e8, -6.0e7])
DIRECTION = A([0.5, -0.7, 0.4, 1e-3, -2e-3, 5e-4])
MODEL = forces.ForceModel(
    (forces.PointMass(), forces.Zonal(4), forces.ThirdBody("sun"), forces.ThirdBody("moon"), forces.Drag())
)
NO_DRAG = forces.ForceModel(MODEL.forces[:-1])

HOST = {"force", "static", "environment_at"}  # decorators, and what takes names


def _world(dtype):
    return forces.Environment(jnp.asarray(SUN, dtype), jnp.asarray(MOON, dtype))


def _accel(state, mass):
    spacecraft = forces.Spacecraft(mass, 50.0, 2.2)
    return MODEL.accel(0.0, state[:3], state[3:], spacecraft, _world(state.dtype))


def _derivative(state, gm):
    model = forces.ForceModel((forces.PointMass(gm), *NO_DRAG.forces[1:]))
    return model.derivative(0.0, state, forces.Spacecraft(), _world(state.dtype))


def _relative(chief, separation, mass):
    station, own = forces.Spacecraft(4.2e5, 1500.0, 2.2), forces.Spacecraft(mass, 50.0, 2.2)
    chief, separation = (chief[:3], chief[3:]), (separation[:3], separation[3:])
    return MODEL.relative(0.0, *chief, *separation, station, own, _world(mass.dtype))


def _plain_difference(chief, separation, mass):
    station, own = forces.Spacecraft(4.2e5, 1500.0, 2.2), forces.Spacecraft(mass, 50.0, 2.2)
    orbits = chief[:3], chief[3:], separation[:3], separation[3:]
    return forces.relative_acceleration(forces.Drag(), 0.0, *orbits, station, own, _world(mass.dtype))


def _field_difference(r, rho):
    return forces.field_difference(lambda x: forces.accel_zonal(x, 3), r, rho)


def _weighted(state, mass, weights):
    model = forces.ForceModel(MODEL.forces, weights)
    return model.accel(0.0, state[:3], state[3:], forces.Spacecraft(mass, 50.0, 2.2), _world(state.dtype))


def _rotation(seconds):
    return forces.earth_rotation(61253, seconds)


def cases(case):
    return [
        case("ForceModel.accel", _accel, (STATE, A(1.2e4))),
        case("ForceModel.accel/weights", _weighted, (STATE, A(1.2e4), A([1.0, 1.0, 0.5, 0.0, 1.0]))),
        case("ForceModel.derivative", _derivative, (STATE, A(3.986e14))),
        case(
            "ForceModel.relative",
            _relative,
            *((STATE, s * DIRECTION, A(1.2e4)) for s in (200.0, 1e3, 5e3)),  # nearer, 1e-17 m/s2 of rounding shows
            rtol32=1e-5,
        ),
        case("relative_acceleration", _plain_difference, (STATE, 1e3 * DIRECTION, A(1.2e4)), rtol32=1e-3),
        case("field_difference", _field_difference, (STATE[:3], A([300.0, -500.0, 800.0])), rtol32=1e-4),
        case("earth_rotation", _rotation, (A(43210.0),)),
    ]


MODELS = []
