"""What scripted policies are, and what they share: the measured view in parts, PD control, limits."""

from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, ArrayLike, Float, Int, Key

from astrojax.attitude import quat_conjugate, quat_multiply, quat_rotate, quat_to_rotation_vector
from owm_envs.config import DockingConfig
from owm_envs.config.params import goals_of
from owm_envs.task.events import safe_norm
from owm_envs.task.observation import Observation, ObservationLayout
from owm_envs.view import View

POSITION_GAIN = 16.0
"""N/m. Source: behaviour policies of the paper's data generation, as the next three."""
VELOCITY_GAIN = 880.0
"""N s/m; with 12 t and `POSITION_GAIN` critically damped."""
ATTITUDE_GAIN = 800.0
"""N m/rad about the axis of the largest inertia, in proportion less about the others."""
RATE_GAIN = 16_000.0
"""N m s, scaled like `ATTITUDE_GAIN`."""


class ScriptedPolicy(Protocol):
    """A policy for one episode: pure, and a pytree of numbers; the caller vmaps."""

    name: str
    """A static field: JAX (0.10.2) takes dataclasses of different classes with equal fields for the same structure, and
    now and then runs the program that it compiled for one with the other."""

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Any:
        """The state in which an episode to dock at `port` begins."""

    def act(self, state: Any, observation: Observation) -> tuple[Float[Array, "6"], Any]:
        """The action for an observation, both in the environment's own layout, and the next state."""


class Vehicle(NamedTuple):
    """What a policy knows of its chaser and clock: kg, kg m2 (principal), N, N m, s between decisions."""

    mass: float
    inertia: tuple[float, float, float]
    force_limit: float
    torque_limit: float
    decision_dt: float


def read_view(layout: ObservationLayout, observation: Observation) -> View:
    """The measured relative view in an observation."""
    return View.of(layout.measured_view(observation))


def limit_norm(vector: Float[Array, "3"], limit: Float[Array, ""] | float) -> Float[Array, "3"]:
    """Shorten a vector to a length, keeping its direction."""
    return vector * jnp.minimum(1, limit / jnp.maximum(safe_norm(vector), 1e-9))


def pd_force(
    view: View,
    position: Float[Array, "3"],
    velocity: Float[Array, "3"] | float,
    accel: Float[Array, "3"] | float = 0.0,
    *,
    mass: Float[Array, ""] | float,
) -> Float[Array, "3"]:
    """Body force [N] towards a moving reference in the station frame, with feed-forward acceleration."""
    force = POSITION_GAIN * (position - view.position) + VELOCITY_GAIN * (velocity - view.velocity) + mass * accel
    return quat_rotate(quat_conjugate(view.attitude), force)


def pd_torque(
    view: View, error: Float[Array, "3"], rate: Float[Array, "3"] | float, *, inertia: Float[ArrayLike, "3"]
) -> Float[Array, "3"]:
    """Body torque [N m] for an attitude error (rotation vector to the reference) and a reference rate, body axes."""
    inertia = jnp.asarray(inertia, error.dtype)
    scale = inertia / jnp.max(inertia)
    return scale * (ATTITUDE_GAIN * error + RATE_GAIN * (rate - view.rate))


Goals = tuple[tuple[float, ...], ...]
"""Hold pose of each port: m, quaternion body to station; a static field of policies, which are compared."""


def known_goals(config: DockingConfig) -> Goals:
    """The hold poses of a configuration's ports."""
    return tuple(map(tuple, goals_of(config).tolist()))


def goal_of(goals: Goals, port: Int[Array, ""], dtype: DTypeLike) -> tuple[Float[Array, "3"], Float[Array, "4"]]:
    """Hold position m and attitude of a port, station frame, of those of all ports."""
    goal = jnp.asarray(goals, dtype)[port]
    return goal[:3], goal[3:]


def attitude_error(view: View, attitude: Float[Array, "4"]) -> Float[Array, "3"]:
    """Rotation vector rad, body axes, of the shortest turn to an attitude."""
    return quat_to_rotation_vector(quat_multiply(quat_conjugate(view.attitude), attitude))


def pointing_error(view: View, direction: Float[Array, "3"]) -> Float[Array, "3"]:
    """Rotation vector rad, body axes, of the shortest turn of the nose (+z) to a unit direction (station frame)."""
    x, y, z = quat_rotate(quat_conjugate(view.attitude), direction)
    across = jnp.stack([-y, x, jnp.zeros_like(x)])
    sine = safe_norm(across)
    safe = jnp.where(sine > 1e-9, sine, 1)
    return jnp.where(sine > 1e-9, jnp.arctan2(safe, z) / safe, 0) * across


def wrench_limits(vehicle: Vehicle, dtype: DTypeLike) -> Float[Array, "6"]:
    return jnp.stack([jnp.asarray(vehicle.force_limit, dtype)] * 3 + [jnp.asarray(vehicle.torque_limit, dtype)] * 3)
