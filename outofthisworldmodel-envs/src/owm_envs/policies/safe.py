"""A policy that flies as visiting vehicles must: wherever its thrusters stop, it drifts clear of the station."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from owm_envs.policies.base import Goals, Vehicle, read_view
from owm_envs.policies.geodesic import body_wrench, turn_towards
from owm_envs.policies.guidance import Goal, goal_of_turning, safe_velocity
from owm_envs.policies.turning import push, twist
from owm_envs.task.observation import Observation, ObservationLayout, part
from owm_envs.task.sensors import TARGET_RATE

_TIME_CONSTANT = 2.0
"""s, of the velocity loop."""
_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DockSafePolicy:
    """Dock with a way out at every moment: track `safe_velocity`, with the attitude of the port.

    It is given the station's hull by way of `field`, and the orbit's rate. The rate of a target that turns it reads off
    the observation.
    """

    vehicle: Vehicle
    field: Any
    """A `GeodesicField`."""
    rows: Int[Array, "8"]
    """Its row of each port, -1 where it has none: there the action is not finite, which ends the episode."""
    goals: Goals = field(metadata=_STATIC)
    drift: Float[Array, "T 3 6"]
    """From `drift_beside`."""
    layout: ObservationLayout = field(metadata=_STATIC)
    turning: bool = field(default=False, metadata=_STATIC)
    """Whether the target turns."""
    name: str = field(default="dock-safe", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Int[Array, ""]:
        """State: the port."""
        return jnp.asarray(port, jnp.int32)

    def act(self, state: Int[Array, ""], observation: Observation) -> tuple[Float[Array, "6"], Int[Array, ""]]:
        """Track the velocity that is safe here."""
        view = read_view(self.layout, observation)
        pose = jnp.asarray(self.goals, view.position.dtype)[state]
        goal = Goal(self.field, jnp.asarray(self.rows)[state], pose, self.drift)
        if self.turning:
            goal = goal_of_turning(goal, part(observation, TARGET_RATE).astype(view.position.dtype))
        accel = (safe_velocity(goal, view.position, view.velocity) - view.velocity) / _TIME_CONSTANT
        angular = turn_towards(pose[3:], view)
        if self.turning:
            accel = accel + push(goal.turning, view.position, view.velocity)
            angular = angular + twist(goal.turning, view, jnp.asarray(self.vehicle.inertia, angular.dtype))
        return self.layout.action(body_wrench(self.vehicle, view, accel, angular)), state
