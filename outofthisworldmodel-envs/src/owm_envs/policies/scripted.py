"""Scripted policies: pure functions of what a chaser measures.

A policy sees the observation, its own state and the port it was assigned; never the truth.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_conjugate, quat_rotate
from owm_envs.policies.base import (
    Goals,
    Vehicle,
    attitude_error,
    goal_of,
    pd_force,
    pd_torque,
    pointing_error,
    read_view,
    wrench_limits,
)
from owm_envs.task.events import safe_norm
from owm_envs.task.observation import Observation, ObservationLayout, part
from owm_envs.task.reset import named_key
from owm_envs.task.sensors import STATE

_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RandomPolicy:
    """Uniform force and torque, drawn anew at every decision."""

    vehicle: Vehicle
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="random", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Key[Array, ""]:
        """State: the key of the next draw."""
        return key

    def act(self, state: Key[Array, ""], observation: Observation) -> tuple[Float[Array, "6"], Key[Array, ""]]:
        """Draw an action."""
        next_key, key = jax.random.split(state)
        dtype = part(observation, STATE).dtype
        wrench = jax.random.uniform(key, (6,), dtype, -1, 1) * wrench_limits(self.vehicle, dtype)
        return self.layout.action(wrench), next_key


class HoldState(NamedTuple):
    """A wrench being held, and what its successors are drawn from."""

    key: Key[Array, ""]
    count: Int[Array, ""]
    wrench: Float[Array, "6"]
    scale: Float[Array, "6"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ExcitePolicy:
    """Wrenches held for 2 s, as a sampling planner's candidates are, plus damping that keeps rates in its range.

    Each episode draws its own amplitude: 0.2 to 1 of the force limit and 0.05 to 0.5 of the torque limit; damping has
    time constants of 60 s (velocity) and 5 s (rate), evaluated when a wrench is drawn, so that what is commanded is
    constant between draws.
    """

    vehicle: Vehicle
    layout: ObservationLayout = field(metadata=_STATIC)
    hold: int = field(metadata=_STATIC)
    """Decisions between draws."""
    name: str = field(default="excite", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> HoldState:
        """State: no wrench yet, this episode's amplitudes."""
        dtype = jnp.float32
        force = jax.random.uniform(named_key(key, "force"), (), dtype, 0.2, 1.0)
        torque = jax.random.uniform(named_key(key, "torque"), (), dtype, 0.05, 0.5)
        amplitude = jnp.stack([force] * 3 + [torque] * 3)
        return HoldState(named_key(key, "draws"), jnp.zeros((), jnp.int32), jnp.zeros(6, dtype), amplitude)

    def act(self, state: HoldState, observation: Observation) -> tuple[Float[Array, "6"], HoldState]:
        """Hold, or draw anew."""
        view = read_view(self.layout, observation)
        dtype = view.position.dtype
        next_key, key = jax.random.split(state.key)
        drawn = jax.random.uniform(key, (6,), dtype, -1, 1) * state.scale * wrench_limits(self.vehicle, dtype)
        inertia = jnp.asarray(self.vehicle.inertia, dtype)
        drag = -self.vehicle.mass / 60.0 * quat_rotate(quat_conjugate(view.attitude), view.velocity)
        drawn = drawn + jnp.concatenate([drag, -inertia / 5.0 * view.rate])
        due = state.count % self.hold == 0
        wrench = jnp.where(due, drawn, state.wrench)
        kept_key = jnp.where(due, next_key, state.key)
        return self.layout.action(wrench), HoldState(kept_key, state.count + 1, wrench, state.scale)


class OrbitState(NamedTuple):
    """A commanded circle about the station origin: unit axis, m, rad/s, and where on it the episode began."""

    axis: Float[Array, "3"]
    radius: Float[Array, ""]
    rate: Float[Array, ""]
    first: Float[Array, "3"]
    """Unit vector from the centre to the reference when the episode began."""
    count: Int[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OrbitPolicy:
    """PD on a circle about the station with the nose at its centre.

    Random axis, radius 80-130 m, rate 0.75-1.0 of the fastest at which the centripetal force takes 60 % of the force
    limit; the reference is one decision ahead and starts at the point of the circle next to the chaser.
    """

    vehicle: Vehicle
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="orbit", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> OrbitState:
        """Draw the circle."""
        dtype = jnp.float32
        axis = jax.random.normal(named_key(key, "axis"), (3,), dtype)
        radius = jax.random.uniform(named_key(key, "radius"), (), dtype, 80.0, 130.0)
        fastest = jnp.sqrt(0.6 * self.vehicle.force_limit / (self.vehicle.mass * radius))
        rate = jax.random.uniform(named_key(key, "rate"), (), dtype, 0.75, 1.0) * fastest
        unit = axis / jnp.maximum(safe_norm(axis), 1e-9)
        return OrbitState(unit, radius, rate, jnp.zeros(3, dtype), jnp.zeros((), jnp.int32))

    def act(self, state: OrbitState, observation: Observation) -> tuple[Float[Array, "6"], OrbitState]:
        """Follow the circle."""
        view = read_view(self.layout, observation)
        axis = state.axis
        in_plane = view.position - jnp.dot(view.position, axis) * axis
        distance = safe_norm(in_plane)
        # On the axis every point of the circle is equally near: any direction across it will do.
        across = jnp.cross(axis, jnp.eye(3, dtype=axis.dtype)[jnp.argmin(jnp.abs(axis))])
        across = across / safe_norm(across)
        nearest = jnp.where(distance > 1e-3, in_plane / jnp.where(distance > 1e-3, distance, 1), across)
        first = jnp.where(state.count == 0, nearest, state.first)
        phase = state.rate * (state.count + 1).astype(axis.dtype) * self.vehicle.decision_dt
        along = jnp.cross(axis, first)
        outward = jnp.cos(phase) * first + jnp.sin(phase) * along
        forward = jnp.cross(axis, outward)
        force = pd_force(
            view,
            state.radius * outward,
            state.radius * state.rate * forward,
            -(state.rate**2) * state.radius * outward,
            mass=self.vehicle.mass,
        )
        to_centre = -view.position / jnp.maximum(safe_norm(view.position), 1e-3)
        turning = quat_rotate(quat_conjugate(view.attitude), state.rate * axis)
        torque = pd_torque(view, pointing_error(view, to_centre), turning, inertia=self.vehicle.inertia)
        wrench = jnp.concatenate([force, torque])
        return self.layout.action(wrench), state._replace(first=first, count=state.count + 1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DockPolicy:
    """Critically damped PD straight to the port's hold pose, whatever stands in between."""

    vehicle: Vehicle
    goals: Goals = field(metadata=_STATIC)
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="dock", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Int[Array, ""]:
        """State: the port."""
        return jnp.asarray(port, jnp.int32)

    def act(self, state: Int[Array, ""], observation: Observation) -> tuple[Float[Array, "6"], Int[Array, ""]]:
        """Pull towards the hold pose."""
        view = read_view(self.layout, observation)
        position, attitude = goal_of(self.goals, state, view.position.dtype)
        force = pd_force(view, position, 0.0, mass=self.vehicle.mass)
        torque = pd_torque(view, attitude_error(view, attitude), 0.0, inertia=self.vehicle.inertia)
        return self.layout.action(jnp.concatenate([force, torque])), state
