"""`iss-numerical`: the station's orbit and the chaser's motion about it, in inertial axes, perturbed.

Zonal gravity, Sun, Moon and Harris-Priester drag act on both; the chaser also turns under its torque and the gravity
gradient. Motion about the station is integrated as such, its acceleration formed without subtracting two orbits, so
that float32 will do: it keeps running sums of what rounding takes. The positions of Sun and Moon are held over a step
and, like the density of the air, evaluated in float32: to seven digits, far within what they are models of.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import (
    accel_euler,
    quat_conjugate,
    quat_derivative,
    quat_multiply,
    quat_rotate,
    rotation_to_quat,
    torque_gravity_gradient,
)
from astrojax.compilation import stored, summed
from astrojax.constants import GM_EARTH
from astrojax.forces import Drag, ForceModel, HarrisPriester, PointMass, Spacecraft, ThirdBody, Zonal, accel_zonal
from astrojax.frames import rotation_eci_to_rtn, rtn_rate
from astrojax.orbits import keplerian_to_cartesian
from astrojax.propagate import compensated_add, rk4_increment_looped
from astrojax.time import normalize_epoch
from owm_envs.config.params import Params
from owm_envs.dynamics.chief import RTN_TO_STATION, elements_at
from owm_envs.dynamics.state import PhysicalState, VehicleState
from owm_envs.view import View


class _Frame(NamedTuple):
    """The station frame against the inertial one: rotation eci to station, rate in station axes."""

    rotation: Float[Array, "3 3"]
    rate: Float[Array, "3"]


def _unit_attitude(motion, increment):
    """The increment that leaves the quaternion at length one."""
    dt, orbit, turn = increment
    ahead = motion[2].attitude + turn.attitude
    stretch = jax.lax.rsqrt(summed(ahead * ahead)) - 1
    return dt, orbit, turn._replace(attitude=turn.attitude + stretch * ahead)


def _in_the_air(vehicle):
    """What drag acts on, of the station's or the chaser's parameters; no light presses on either."""
    return Spacecraft(vehicle.mass, vehicle.drag_area, vehicle.drag_coefficient, reflectivity=None)


@dataclass(frozen=True)
class NumericalOrbits:
    """A perturbed orbit, perturbed motion about it and a rigid body, in inertial axes."""

    has_epoch: ClassVar[bool] = True
    zonal_degree: int = 4
    sun: bool = True
    moon: bool = True
    drag: bool = True

    @property
    def _forces(self):
        """Made where it is used, inside a program: its numbers are constants there. The pole is that of J2000."""
        optional = (
            (Zonal(self.zonal_degree), self.zonal_degree > 0),
            (ThirdBody("sun"), self.sun),
            (ThirdBody("moon"), self.moon),
            (Drag(HarrisPriester()), self.drag),
        )
        return ForceModel((PointMass(), *(force for force, acts in optional if acts)))

    def _frame(self, chief):
        # Sun, Moon and drag change the out-of-plane rate by less than 1e-9 rad/s (2e-7 m/s at 225 m); the central
        # attraction has no part in it.
        accel = accel_zonal(chief[:3], self.zonal_degree)
        relabel = jnp.asarray(RTN_TO_STATION, chief.dtype)
        return stored(_Frame(relabel @ rotation_eci_to_rtn(chief), relabel @ rtn_rate(chief, accel)))

    def init(self, params: Params, epoch: Float[Array, "2"], view: Float[Array, "13"]) -> PhysicalState:
        """State with the relative view `view` (13,) at `epoch` (2,); the chief has come there on its Kepler orbit."""
        chief = keplerian_to_cartesian(elements_at(params.chief, epoch), GM_EARTH)
        frame = self._frame(chief)
        to_eci = frame.rotation.T
        seen = View.of(view)
        position = to_eci @ seen.position
        velocity = to_eci @ (seen.velocity + jnp.cross(frame.rate, seen.position))
        attitude = quat_multiply(rotation_to_quat(to_eci), seen.attitude)
        rate = seen.rate + quat_rotate(quat_conjugate(seen.attitude), frame.rate)
        chaser = VehicleState(jnp.concatenate([position, velocity]), attitude, rate)
        elapsed = jnp.zeros((), view.dtype)
        lost = None
        if view.dtype == jnp.float32:
            lost = jax.tree.map(jnp.zeros_like, (elapsed, chief, chaser))
        return PhysicalState(epoch, elapsed, chief, chaser, lost)

    def step(
        self, params: Params, state: PhysicalState, wrench: Float[Array, "6"], dt: Float[Array, ""]
    ) -> PhysicalState:
        """Advance by `dt` seconds under a body wrench (6,) [N, N m]."""
        day, seconds = normalize_epoch(state.epoch[0], state.epoch[1] + state.elapsed)
        world = self._forces.environment(day.astype(jnp.float32), seconds.astype(jnp.float32))
        world = stored(jax.tree.map(lambda position: position.astype(dt.dtype), world))
        station, own = (_in_the_air(vehicle) for vehicle in (params.chief, params.chaser))
        given = (world, station, own, params.chaser.inertia, wrench)
        motion = (state.elapsed, state.chief, state.chaser)
        increment = rk4_increment_looped(self._derivative, state.elapsed, motion, dt, given)
        increment = _unit_attitude(motion, increment)
        if state.lost is None:
            motion, lost = jax.tree.map(lambda a, b: a + b, motion, increment), None
        else:
            motion, lost = compensated_add(motion, state.lost, increment)
        elapsed, chief, chaser = motion
        return stored(PhysicalState(state.epoch, elapsed, chief, chaser, lost))

    def _derivative(self, t, motion, world, station, own, inertia, wrench):
        forces = self._forces
        elapsed, chief, chaser = motion
        thrust = quat_rotate(chaser.attitude, wrench[:3]) / own.mass
        from_earth = quat_rotate(quat_conjugate(chaser.attitude), chief[:3] + chaser.orbit[:3])
        torque = wrench[3:] + torque_gravity_gradient(from_earth, inertia, GM_EARTH)
        orbit, between = (chief[:3], chief[3:]), (chaser.orbit[:3], chaser.orbit[3:])
        apart = forces.relative(t, *orbit, *between, station, own, world)
        return (
            jnp.ones_like(elapsed),
            forces.derivative(t, chief, station, world),
            VehicleState(
                jnp.concatenate([chaser.orbit[3:], apart + thrust]),
                quat_derivative(chaser.attitude, chaser.rate),
                accel_euler(chaser.rate, inertia, torque),
            ),
        )

    def chief_orbit(self, params: Params, state: PhysicalState) -> Float[Array, "6"]:
        """The station's position and velocity [m, m/s] in inertial axes."""
        return state.chief

    def relative_state(self, params: Params, state: PhysicalState) -> Float[Array, "13"]:
        """The 13-number relative view of a state."""
        chaser = state.chaser
        frame = self._frame(state.chief)
        position = frame.rotation @ chaser.orbit[:3]
        velocity = frame.rotation @ chaser.orbit[3:] - jnp.cross(frame.rate, position)
        attitude = quat_multiply(rotation_to_quat(frame.rotation), chaser.attitude)
        rate = chaser.rate - quat_rotate(quat_conjugate(attitude), frame.rate)
        return View(position, velocity, attitude, rate).numbers()
