"""Policies that follow the geodesic cost-to-go around the hull: they are given the station's map."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_conjugate, quat_rotate
from owm_envs.config import DockingConfig
from owm_envs.config.params import goals_of, hull_of
from owm_envs.field import GeodesicField, field_rows, load_field
from owm_envs.policies.base import Goals, Vehicle, attitude_error, goal_of, known_goals, limit_norm, read_view
from owm_envs.policies.guidance import field_speed
from owm_envs.task.events import safe_norm
from owm_envs.task.observation import Observation, ObservationLayout
from owm_envs.view import View

_STATIC = {"static": True}


def field_of(config: DockingConfig) -> GeodesicField:
    """The station's own field, or that about the hull of a target which has a hold pose of its own."""
    if config.target.hold is None:
        return load_field()
    return load_field(config.ports[:1], hull_of(config), poses=goals_of(config))


def prepared(
    config: DockingConfig, geodesic_field: GeodesicField | None = None
) -> tuple[GeodesicField, Int[Array, "8"], Goals]:
    """What a policy flies by: a field, `field_of` the configuration when None, its row of each port, and the goals."""
    geodesic_field = field_of(config) if geodesic_field is None else geodesic_field
    # On the device once, not with every call: the field takes 150 MB.
    on_device = jax.tree.map(jnp.asarray, geodesic_field)
    return on_device, field_rows(geodesic_field, goals_of(config)), known_goals(config)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DockGeodesicPolicy:
    """Follow the shortest collision-free way to the port: velocity down the geodesic cost-to-go, attitude of the port.

    It is given the station's hull by way of `field`. Speed profile 4 m/s, sqrt(0.08 phi), phi / 4, and
    0.4 m/s + sqrt(0.08 clearance), whichever is least: what braking at 0.04 m/s2 can undo before the goal or the hull.
    Turning rate 0.05 rad/s, sqrt(0.02 theta), theta / 5. The velocity and rate loops have time constants of 2 s. The
    limit by clearance was chosen on train ports, where a linear one (0.18 / s) clips an array in 3 of 200 flights.
    """

    vehicle: Vehicle
    field: Any
    """A `GeodesicField`."""
    rows: Int[Array, "8"]
    """Its row of each port, -1 where it has none: there the action is not finite, which ends the episode."""
    goals: Goals = field(metadata=_STATIC)
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="dock-geodesic", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Int[Array, ""]:
        """State: the port."""
        return jnp.asarray(port, jnp.int32)

    def act(self, state: Int[Array, ""], observation: Observation) -> tuple[Float[Array, "6"], Int[Array, ""]]:
        """Track the field's velocity."""
        view = read_view(self.layout, observation)
        accel, angular = _track(self.field, self.rows, self.goals, state, view)
        return self.layout.action(body_wrench(self.vehicle, view, accel, angular)), state


class Integral(NamedTuple):
    """What errors near the goal have added up to: m/s2 in station axes, rad/s2 in body axes."""

    port: Int[Array, ""]
    accel: Float[Array, "3"]
    angular: Float[Array, "3"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DockGeodesicIntegralPolicy:
    """`dock-geodesic` with integral action, which holds a steady disturbance off the hold pose.

    Within 3 m and 0.2 rad of the goal the errors are integrated, 0.008 / s3 of position and 0.006 / s3 of attitude: a
    sixth of what the loops' damping could bear. Against windup nothing is added along an axis at its limit, the sum
    leaks with a time constant of 60 s wherever the chaser is, and it is held to 0.3 of what the thrusters can do.
    """

    vehicle: Vehicle
    field: Any
    rows: Int[Array, "8"]
    goals: Goals = field(metadata=_STATIC)
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="dock-geodesic-integral", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Integral:
        """State: nothing added up."""
        return Integral(jnp.asarray(port, jnp.int32), jnp.zeros(3, jnp.float32), jnp.zeros(3, jnp.float32))

    def act(self, state: Integral, observation: Observation) -> tuple[Float[Array, "6"], Integral]:
        """Track the field's velocity with what has been added up."""
        view = read_view(self.layout, observation)
        dtype, vehicle = view.position.dtype, self.vehicle
        accel, angular = _track(self.field, self.rows, self.goals, state.port, view)
        command = body_wrench(vehicle, view, accel + state.accel, angular + state.angular)

        position, attitude = goal_of(self.goals, state.port, dtype)
        offset, turn = position - view.position, attitude_error(view, attitude)
        near = (safe_norm(offset) < 3.0) & (safe_norm(turn) < 0.2)
        free = safe_norm(command[:3]) < 0.999 * vehicle.force_limit
        turning = jnp.abs(command[3:]) < vehicle.torque_limit
        leak = 1.0 - vehicle.decision_dt / 60.0
        added = leak * state.accel + jnp.where(near & free, 0.008 * vehicle.decision_dt * offset, 0)
        turned = leak * state.angular + jnp.where(near & turning, 0.006 * vehicle.decision_dt * turn, 0)
        most = 0.3 * vehicle.torque_limit / jnp.asarray(vehicle.inertia, dtype)
        following = Integral(
            state.port,
            limit_norm(added, 0.3 * vehicle.force_limit / vehicle.mass).astype(state.accel.dtype),
            jnp.clip(turned, -most, most).astype(state.angular.dtype),
        )
        return self.layout.action(command), following


def _track(
    geodesic_field: GeodesicField, rows: Int[Array, "8"], goals: Goals, port: Int[Array, ""], view: View
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """The accelerations that lead to the field's velocity and towards the port's attitude: station, body axes."""
    speed, gradient, _ = field_speed(geodesic_field, jnp.asarray(rows)[port], view.position)
    wanted = -speed * gradient / jnp.maximum(safe_norm(gradient), 1e-6)
    return (wanted - view.velocity) / 2.0, turn_towards(goal_of(goals, port, view.position.dtype)[1], view)


def turn_towards(attitude: Float[Array, "4"], view: View) -> Float[Array, "3"]:
    """The angular acceleration, rad/s2 in body axes, that leads to an attitude."""
    error = attitude_error(view, attitude)
    angle = safe_norm(error)
    turn = jnp.minimum(0.05, jnp.minimum(jnp.sqrt(0.02 * jnp.maximum(angle, 1e-9)), angle / 5.0))
    return (turn * error / jnp.maximum(angle, 1e-9) - view.rate) / 2.0


def body_wrench(
    vehicle: Vehicle, view: View, accel: Float[Array, "3"], angular: Float[Array, "3"]
) -> Float[Array, "6"]:
    """The body wrench [N, N m] of accelerations in station and body axes, the force within its limit."""
    force = quat_rotate(quat_conjugate(view.attitude), vehicle.mass * accel)
    torque = jnp.asarray(vehicle.inertia, angular.dtype) * angular
    return jnp.concatenate([limit_norm(force, vehicle.force_limit), torque])
