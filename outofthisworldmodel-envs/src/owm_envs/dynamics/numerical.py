"""`iss-numerical`: chief and chaser propagated separately in the Earth-centred inertial frame; needs float64.

Zonal gravity, Sun, Moon and Harris-Priester drag act on both; the chaser also turns under its torque and the gravity
gradient. The positions of Sun and Moon are held over a step.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax.attitude import (
    accel_euler,
    quat_conjugate,
    quat_derivative,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    rotation_to_quat,
    torque_gravity_gradient,
)
from astrojax.constants import GM_EARTH
from astrojax.dynamics import ForceModel, accel_gravity_and_perturbations, celestial_bodies
from astrojax.elements import keplerian_to_cartesian, propagate_keplerian
from astrojax.gravity import accel_two_body, accel_zonal
from astrojax.integrators import rk4_step
from astrojax.relative import rotation_eci_to_rtn, rtn_rate
from astrojax.time import normalize_epoch
from owm_envs.dynamics.state import PhysicalState, VehicleState

RTN_TO_STATION = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Station axes x = N, y = -T, z = R."""


class _Frame(NamedTuple):
    """The station frame against the inertial one: rotation eci to station, rate in station axes."""

    rotation: Float[Array, "3 3"]
    rate: Float[Array, "3"]


@dataclass(frozen=True)
class NumericalOrbits:
    """Two perturbed orbits and a rigid body; orbits, attitude and rate are inertial."""

    has_epoch: ClassVar[bool] = True
    zonal_degree: int = 4
    sun: bool = True
    moon: bool = True
    drag: bool = True

    def _frame(self, chief):
        # Sun, Moon and drag change the out-of-plane rate by less than 1e-9 rad/s (2e-7 m/s at 225 m).
        accel = accel_two_body(chief[:3], GM_EARTH) + accel_zonal(chief[:3], self.zonal_degree)
        relabel = jnp.asarray(RTN_TO_STATION, chief.dtype)
        return _Frame(relabel @ rotation_eci_to_rtn(chief), relabel @ rtn_rate(chief, accel))

    def init(self, params, epoch, view):
        """State with the relative view `view` (13,) at `epoch` (2,); the chief has come there on its Kepler orbit."""
        since = (epoch[0] - params.chief.epoch[0]) * 86_400.0 + (epoch[1] - params.chief.epoch[1])
        elements = propagate_keplerian(params.chief.elements, since, GM_EARTH)
        chief = keplerian_to_cartesian(elements, GM_EARTH)
        frame = self._frame(chief)
        to_eci = frame.rotation.T
        position = chief[:3] + to_eci @ view[:3]
        velocity = chief[3:] + to_eci @ (view[3:6] + jnp.cross(frame.rate, view[:3]))
        attitude = quat_multiply(rotation_to_quat(to_eci), view[6:10])
        rate = view[10:13] + quat_rotate(quat_conjugate(view[6:10]), frame.rate)
        chaser = VehicleState(jnp.concatenate([position, velocity]), attitude, rate)
        return PhysicalState(epoch, jnp.zeros((), view.dtype), chief, chaser)

    def step(self, params, state, wrench, dt):
        """Advance by `dt` seconds under a body wrench (6,) [N, N m]."""
        forces = ForceModel(zonal_degree=self.zonal_degree, sun=self.sun, moon=self.moon, drag=self.drag)
        bodies = celestial_bodies(*normalize_epoch(state.epoch[0], state.epoch[1] + state.elapsed))
        station, vehicle = params.chief, params.chaser

        def orbit_derivative(orbit, body, thrust_accel):
            accel = accel_gravity_and_perturbations(
                bodies, orbit, body.mass, body.drag_area, body.drag_coefficient, forces
            )
            return jnp.concatenate([orbit[3:], accel + thrust_accel])

        def derivative(_, vehicles):
            chief, chaser = vehicles
            thrust = quat_rotate(chaser.attitude, wrench[:3]) / vehicle.mass
            from_earth = quat_rotate(quat_conjugate(chaser.attitude), chaser.orbit[:3])
            torque = wrench[3:] + torque_gravity_gradient(from_earth, vehicle.inertia, GM_EARTH)
            return orbit_derivative(chief, station, jnp.zeros_like(thrust)), VehicleState(
                orbit_derivative(chaser.orbit, vehicle, thrust),
                quat_derivative(chaser.attitude, chaser.rate),
                accel_euler(chaser.rate, vehicle.inertia, torque),
            )

        chief, chaser = rk4_step(derivative, state.elapsed, (state.chief, state.chaser), dt)
        chaser = chaser._replace(attitude=quat_normalize(chaser.attitude))
        return state._replace(elapsed=state.elapsed + dt, chief=chief, chaser=chaser)

    def relative_state(self, params, state):
        """The 13-number relative view of a state."""
        chief, chaser = state.chief, state.chaser
        frame = self._frame(chief)
        position = frame.rotation @ (chaser.orbit[:3] - chief[:3])
        velocity = frame.rotation @ (chaser.orbit[3:] - chief[3:]) - jnp.cross(frame.rate, position)
        attitude = quat_multiply(rotation_to_quat(frame.rotation), chaser.attitude)
        rate = chaser.rate - quat_rotate(quat_conjugate(attitude), frame.rate)
        return jnp.concatenate([position, velocity, attitude, rate])
