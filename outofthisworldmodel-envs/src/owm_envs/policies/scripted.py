"""Scripted policies: pure functions of what a chaser measures.

A policy sees the observation, its own state and the port it was assigned; never the truth.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_conjugate, quat_multiply, quat_rotate, quat_to_rotation_vector
from owm_envs.config import unknown
from owm_envs.datasets.schema import POLICY_NAMES
from owm_envs.station import goal_poses
from owm_envs.task.events import safe_norm
from owm_envs.task.observation import ObservationLayout
from owm_envs.task.reset import named_key

if TYPE_CHECKING:
    from owm_envs.env import DockingEnv

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

    def act(self, state: Any, observation: Float[Array, "O"]) -> tuple[Float[Array, "6"], Any]:
        """The action for an observation, both in the environment's own layout, and the next state."""


class Vehicle(NamedTuple):
    """What a policy knows of its chaser and clock: kg, kg m2 (principal), N, N m, s between decisions."""

    mass: float
    inertia: tuple[float, float, float]
    force_limit: float
    torque_limit: float
    decision_dt: float


class View(NamedTuple):
    """A measured relative view in parts: m, m/s (station frame), quaternion body to station, rad/s (body)."""

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    attitude: Float[Array, "4"]
    rate: Float[Array, "3"]


def read_view(layout: ObservationLayout, observation: Float[Array, "O"]) -> View:
    """The relative view in an observation."""
    view = layout.measured_view(observation)
    return View(view[:3], view[3:6], view[6:10], view[10:13])


def limit_norm(vector: Float[Array, "3"], limit: Float[Array, ""] | float) -> Float[Array, "3"]:
    """Shorten a vector to a length, keeping its direction."""
    return vector * jnp.minimum(1, limit / jnp.maximum(safe_norm(vector), 1e-9))


def pd_force(view: View, position, velocity, accel=0.0, *, mass) -> Float[Array, "3"]:
    """Body force [N] towards a moving reference in the station frame, with feed-forward acceleration."""
    force = POSITION_GAIN * (position - view.position) + VELOCITY_GAIN * (velocity - view.velocity) + mass * accel
    return quat_rotate(quat_conjugate(view.attitude), force)


def pd_torque(view: View, error: Float[Array, "3"], rate, *, inertia) -> Float[Array, "3"]:
    """Body torque [N m] for an attitude error (rotation vector to the reference) and a reference rate, body axes."""
    inertia = jnp.asarray(inertia, error.dtype)
    scale = inertia / jnp.max(inertia)
    return scale * (ATTITUDE_GAIN * error + RATE_GAIN * (rate - view.rate))


def goal_of(port: Int[Array, ""], dtype) -> tuple[Float[Array, "3"], Float[Array, "4"]]:
    """Hold position m and attitude of a port, station frame."""
    goal = jnp.asarray(goal_poses(), dtype)[port]
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


_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RandomPolicy:
    """Uniform force and torque, drawn anew at every decision."""

    vehicle: Vehicle
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="random", metadata=_STATIC)

    def init(self, key, port):
        """State: the key of the next draw."""
        return key

    def act(self, state, observation):
        """Draw an action."""
        next_key, key = jax.random.split(state)
        wrench = jax.random.uniform(key, (6,), observation.dtype, -1, 1) * _limits(self.vehicle, observation.dtype)
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

    def init(self, key, port):
        """State: no wrench yet, this episode's amplitudes."""
        dtype = jnp.float32
        force = jax.random.uniform(named_key(key, "force"), (), dtype, 0.2, 1.0)
        torque = jax.random.uniform(named_key(key, "torque"), (), dtype, 0.05, 0.5)
        amplitude = jnp.stack([force] * 3 + [torque] * 3)
        return HoldState(named_key(key, "draws"), jnp.zeros((), jnp.int32), jnp.zeros(6, dtype), amplitude)

    def act(self, state, observation):
        """Hold, or draw anew."""
        view = read_view(self.layout, observation)
        dtype = observation.dtype
        next_key, key = jax.random.split(state.key)
        drawn = jax.random.uniform(key, (6,), dtype, -1, 1) * state.scale * _limits(self.vehicle, dtype)
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

    def init(self, key, port):
        """Draw the circle."""
        dtype = jnp.float32
        axis = jax.random.normal(named_key(key, "axis"), (3,), dtype)
        radius = jax.random.uniform(named_key(key, "radius"), (), dtype, 80.0, 130.0)
        fastest = jnp.sqrt(0.6 * self.vehicle.force_limit / (self.vehicle.mass * radius))
        rate = jax.random.uniform(named_key(key, "rate"), (), dtype, 0.75, 1.0) * fastest
        unit = axis / jnp.maximum(safe_norm(axis), 1e-9)
        return OrbitState(unit, radius, rate, jnp.zeros(3, dtype), jnp.zeros((), jnp.int32))

    def act(self, state, observation):
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
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="dock", metadata=_STATIC)

    def init(self, key, port):
        """State: the port."""
        return jnp.asarray(port, jnp.int32)

    def act(self, state, observation):
        """Pull towards the hold pose."""
        view = read_view(self.layout, observation)
        position, attitude = goal_of(state, observation.dtype)
        force = pd_force(view, position, 0.0, mass=self.vehicle.mass)
        torque = pd_torque(view, attitude_error(view, attitude), 0.0, inertia=self.vehicle.inertia)
        return self.layout.action(jnp.concatenate([force, torque])), state


def _limits(vehicle: Vehicle, dtype) -> Float[Array, "6"]:
    return jnp.stack([jnp.asarray(vehicle.force_limit, dtype)] * 3 + [jnp.asarray(vehicle.torque_limit, dtype)] * 3)


def make_policy(name: str, env: "DockingEnv", *, geodesic_field: Any = None) -> ScriptedPolicy:
    """Build a scripted policy for an environment's chaser, layout and decision rate.

    Args:
        name: one of `POLICY_NAMES`.
        geodesic_field: a `GeodesicField` for those that follow one; the station's own when None.

    Raises:
        ValueError: the name is unknown (naming the nearest).
    """
    if name not in POLICY_NAMES:
        raise ValueError(unknown("policy", name, POLICY_NAMES))
    chaser, decision_dt = env.config.chaser, env.config.decision_dt
    vehicle = Vehicle(chaser.mass, chaser.inertia, chaser.force_limit, chaser.torque_limit, decision_dt)
    layout = env.layout
    if name == "random":
        return RandomPolicy(vehicle, layout=layout)
    if name == "orbit":
        return OrbitPolicy(vehicle, layout=layout)
    if name == "dock":
        return DockPolicy(vehicle, layout=layout)
    if name == "excite":
        return ExcitePolicy(vehicle, layout=layout, hold=max(1, round(2.0 / decision_dt)))
    from owm_envs.policies.geodesic import DockGeodesicIntegralPolicy, DockGeodesicPolicy, prepared

    kinds = {kind.name: kind for kind in (DockGeodesicPolicy, DockGeodesicIntegralPolicy)}
    return kinds[name](vehicle, *prepared(geodesic_field), layout=layout)
