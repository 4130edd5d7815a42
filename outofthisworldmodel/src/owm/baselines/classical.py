"""The classical stack: an extended Kalman filter, a route without a map of the hull, and model-predictive control."""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from astrojax.attitude import quat_conjugate, quat_rotate
from astrojax.constants import GM_EARTH
from owm.baselines.ekf import Belief, ErrorStateEKF
from owm.planning.mpc import Corridor, Tracking, solve, tracking
from owm_envs.env import DockingEnv
from owm_envs.policies.base import Goals, Vehicle, attitude_error, goal_of, known_goals
from owm_envs.task.events import safe_norm
from owm_envs.task.observation import Observation, ObservationLayout, seen_now
from owm_envs.view import VIEW_SIZE, View

GATE = 32.9
"""The square of an innovation of 12 numbers, in units of its covariance, exceeds it once in a thousand (chi-square)."""
CRUISE_RADIUS = 85.0
"""m from the station origin: a sphere about the whole hull with room for a chaser and its turns."""
PROCESS_NOISE = (1e-3, 2e-3, 1e-4, 2e-4)
"""A filter step's errors per axis: position m, velocity m/s, attitude rad, rate rad/s. Some 6 % of what the thrusters
do in a step, so that the filter bears thrusters that are not what it is told."""


def corridor_of(goal: Float[Array, "3"], attitude: Float[Array, "4"]) -> Corridor:
    """The approach corridor of a hold pose: 3 m about it, opening by 15 degrees, along the docked chaser's nose."""
    axes = jnp.stack([quat_rotate(attitude, axis) for axis in jnp.eye(3, dtype=goal.dtype)])
    return Corridor(3.0, np.tan(np.radians(15.0)), goal, jnp.stack([-axes[2], axes[0], axes[1]]))


def inside(corridor: Corridor, position: Float[Array, "3"]) -> Bool[Array, ""]:
    """Whether a position is within the corridor, however far out."""
    along, *across = corridor.axes @ (position - corridor.goal)
    lateral = safe_norm(jnp.stack(across))
    return (along > -1.0) & (lateral < corridor.radius + corridor.slope * jnp.maximum(along, 0))


def wanted_velocity(corridor: Corridor, position: Float[Array, "3"]) -> Float[Array, "3"]:
    """The route: around the station at `CRUISE_RADIUS` to the corridor, then down the corridor.

    Around: at most 4 m/s and what a centripetal 0.07 m/s2 allows, slowing towards the place where the corridor's axis
    leaves the sphere. Down: sqrt(0.06 d) and d / 6, d to the hold position, 2 m/s at most and less off the axis.
    """
    along, *across = corridor.axes @ (position - corridor.goal)
    offset = jnp.stack(across) @ corridor.axes[1:]
    lateral = safe_norm(offset)
    ahead = jnp.maximum(jnp.abs(along), 1e-9)
    speed = jnp.minimum(2.0, jnp.minimum(jnp.sqrt(0.06 * ahead), ahead / 6.0))
    width = corridor.radius + corridor.slope * ahead
    speed = speed * jnp.clip(1.2 - lateral / width, 0.2, 1.0)
    aside = jnp.minimum(1.5, jnp.minimum(lateral / 8.0, jnp.sqrt(0.06 * jnp.maximum(lateral, 1e-9))))
    down = -jnp.sign(along) * speed * corridor.axes[0] - aside * offset / jnp.maximum(lateral, 1e-6)

    reach = jnp.dot(corridor.goal, corridor.axes[0])
    height = -reach + jnp.sqrt(reach**2 - jnp.dot(corridor.goal, corridor.goal) + CRUISE_RADIUS**2)
    entry = corridor.goal + height * corridor.axes[0]
    radius = jnp.maximum(safe_norm(position), 1.0)
    out = position / radius
    tangent = entry - jnp.dot(entry, out) * out
    # Opposite the entry every way around is as short.
    spare = jnp.cross(out, corridor.axes[1])
    tangent = jnp.where(safe_norm(tangent) > 1.0, tangent, spare)
    tangent = tangent / jnp.maximum(safe_norm(tangent), 1e-3)
    fastest = jnp.minimum(4.0, jnp.sqrt(0.07 * radius))
    fastest = jnp.minimum(fastest, 1.0 + jnp.sqrt(0.06 * safe_norm(entry - position)))
    rise = jnp.clip((CRUISE_RADIUS - radius) / 10.0, -0.7 * fastest, fastest)
    around = rise * out + jnp.sqrt(jnp.maximum(fastest**2 - rise**2, 0)) * tangent
    return jnp.where(inside(corridor, position), down, around)


class ClassicalState(NamedTuple):
    """What an episode carries: the port, the filter, the last command (N, N m) and the last solution (m/s2)."""

    port: Int[Array, ""]
    started: Bool[Array, ""]
    belief: Belief
    wrench: Float[Array, "6"]
    accelerations: Float[Array, "N 3"]


_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ClassicalPolicy:
    """`ekf-mpc`: filter, predict the route, follow it by model-predictive control; attitude by a rate-limited PD.

    It is given the equations of motion (Clohessy and Wiltshire, rigid body), mass, inertia, the sensors' noise, the
    station's orbital rate and a sphere about the hull, but no map of the hull. A pure policy for one episode, flown by
    `owm_envs.policies.VectorPolicy`.
    """

    vehicle: Vehicle
    goals: Goals = field(metadata=_STATIC)
    problem: Tracking
    params: Any
    """Of the filter."""
    ekf: ErrorStateEKF = field(metadata=_STATIC)
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="ekf-mpc", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> ClassicalState:
        """State: nothing measured."""
        steps = self.problem.free_position.shape[0]
        return ClassicalState(
            port=jnp.asarray(port, jnp.int32),
            started=jnp.zeros((), bool),
            belief=Belief(jnp.zeros(VIEW_SIZE, jnp.float32), jnp.eye(12, dtype=jnp.float32)),
            wrench=jnp.zeros(6, jnp.float32),
            accelerations=jnp.zeros((steps, 3), jnp.float32),
        )

    def act(self, state: ClassicalState, observation: Observation) -> tuple[Float[Array, "6"], ClassicalState]:
        """Filter the measurement and take the first step of a new solution."""
        measured = self.layout.measured_view(observation)
        first = self.ekf.init(self.params, measured)
        # Before the first measurement there is no belief to go on from, but a rotation must be one to be finite.
        known = jax.tree.map(lambda a, b: jnp.where(state.started, a, b), state.belief, first)
        predicted = self.ekf.predict(self.params, known, state.wrench)
        followed = self.ekf.update(self.params, predicted, measured)
        if (seen := seen_now(observation)) is not None:
            followed = jax.tree.map(lambda a, b: jnp.where(seen, a, b), followed, predicted)
        belief = jax.tree.map(lambda a, b: jnp.where(state.started, a, b), followed, first)
        view = View.of(belief.view)

        goal, attitude = goal_of(self.goals, state.port, view.position.dtype)
        accelerations = self.translate(view, corridor_of(goal, attitude), state.accelerations)
        force = quat_rotate(quat_conjugate(view.attitude), self.vehicle.mass * accelerations[0])
        wrench = jnp.concatenate([force, self.turn(view, attitude)]).astype(jnp.float32)
        return self.layout.action(wrench), ClassicalState(
            state.port, jnp.ones((), bool), belief, wrench, accelerations.astype(jnp.float32)
        )

    def translate(self, view: View, corridor: Corridor, last: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        """Accelerations m/s2 of the horizon's steps, station frame."""

        def advance(position, _):
            position = position + wanted_velocity(corridor, position)  # steps of 1 s
            return position, (position, wanted_velocity(corridor, position))

        _, (positions, velocities) = jax.lax.scan(advance, view.position, length=last.shape[0])
        return solve(
            self.problem,
            jnp.concatenate([view.position, view.velocity]),
            positions,
            velocities,
            corridor,
            inside(corridor, view.position).astype(positions.dtype),
            0.98 * self.vehicle.force_limit / self.vehicle.mass,
            last,
        )

    def turn(self, view: View, attitude: Float[Array, "4"]) -> Float[Array, "3"]:
        """Torque N m: rate 0.05 rad/s, sqrt(0.02 theta) or theta / 5, whichever is least, closed in 2 s."""
        error = attitude_error(view, attitude)
        angle = safe_norm(error)
        speed = jnp.minimum(0.05, jnp.minimum(jnp.sqrt(0.02 * jnp.maximum(angle, 1e-9)), angle / 5.0))
        inertia = jnp.asarray(self.vehicle.inertia, error.dtype)
        angular = (speed * error / jnp.maximum(angle, 1e-9) - view.rate) / 2.0
        torque = inertia * angular + jnp.cross(view.rate, inertia * view.rate)
        return jnp.clip(torque, -self.vehicle.torque_limit, self.vehicle.torque_limit)


def classical_policy(env: DockingEnv, *, gate: float = math.inf) -> ClassicalPolicy:
    """Build the stack for an environment's nominal chaser, orbit, sensors and decision rate; `gate` as the filter's."""
    config = env.config
    chaser = config.chaser
    vehicle = Vehicle(chaser.mass, chaser.inertia, chaser.force_limit, chaser.torque_limit, config.decision_dt)
    ekf = ErrorStateEKF(config, process_noise=PROCESS_NOISE, dt=config.decision_dt, gate=gate)
    name = "ekf-mpc" if math.isinf(gate) else "ekf-mpc-gated"
    rate = (GM_EARTH / config.chief.semi_major_axis**3) ** 0.5
    return ClassicalPolicy(
        vehicle, known_goals(config), tracking(rate), ekf.params, ekf=ekf, layout=env.layout, name=name
    )
