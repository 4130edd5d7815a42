"""Dead reckoning: what a scripted policy goes by while relative navigation is quiet."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_rotate
from owm_envs.policies.base import ScriptedPolicy, Vehicle
from owm_envs.task.observation import Observation, ObservationLayout, seen_now
from owm_envs.view import VIEW_SIZE, View

_STATIC = {"static": True}


class Reckoned(NamedTuple):
    """The policy's own state, the view that it went by last, and the wrench [N, N m] that it commanded then."""

    inner: Any
    view: Float[Array, "13"]
    wrench: Float[Array, "6"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ReckoningPolicy:
    """Another policy, shown where its own commands have led since the last measurement.

    It takes the chaser for a rigid body in free space. Where `state_valid` is not observed it changes nothing.
    """

    policy: ScriptedPolicy
    vehicle: Vehicle
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Reckoned:
        """State: nothing seen."""
        zeros = jnp.zeros(VIEW_SIZE, jnp.float32)
        return Reckoned(self.policy.init(key, port), zeros, jnp.zeros(6, jnp.float32))

    def act(self, state: Reckoned, observation: Observation) -> tuple[Float[Array, "6"], Reckoned]:
        """The policy's action for what it sees, or for where it must be."""
        view = self.layout.measured_view(observation)
        if (seen := seen_now(observation)) is not None:
            view = jnp.where(seen, view, coast(self.vehicle, state.view, state.wrench).astype(view.dtype))
            observation = self.layout.with_view(observation, view)
        action, inner = self.policy.act(state.inner, observation)
        wrench = self.layout.wrench(action)
        return action, Reckoned(inner, view.astype(jnp.float32), wrench.astype(jnp.float32))


def coast(vehicle: Vehicle, view: Float[Array, "13"], wrench: Float[Array, "6"]) -> Float[Array, "13"]:
    """Where a rigid body in free space comes in one decision under a held body wrench [N, N m]."""
    dt, (position, velocity, attitude, rate) = vehicle.decision_dt, View.of(view)
    change = dt * quat_rotate(attitude, wrench[:3]) / vehicle.mass
    spin = dt * wrench[3:] / jnp.asarray(vehicle.inertia, view.dtype)
    turned = quat_multiply(attitude, quat_from_rotation_vector(dt * (rate + 0.5 * spin)))
    return View(position + dt * (velocity + 0.5 * change), velocity + change, turned, rate + spin).numbers()


def reckoning(policy: ScriptedPolicy) -> ReckoningPolicy:
    """A scripted policy that bears a navigation that goes quiet."""
    return ReckoningPolicy(policy, policy.vehicle, layout=policy.layout, name=policy.name)
