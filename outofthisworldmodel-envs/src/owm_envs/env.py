"""The docking task as a pure environment: `reset` and `step` over one fidelity's equations of motion."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from astrojax.attitude import quat_from_rotation_vector, quat_rotate
from astrojax.time import mjd_from_calendar, normalize_epoch
from owm_envs.config import DockingConfig, load_config
from owm_envs.dynamics import DYNAMICS, Dynamics, PhysicalState, require_dynamics
from owm_envs.params import Params, params_from_config
from owm_envs.task.collision import swept_clearance
from owm_envs.task.events import Closest, Outcome, error_norms, is_docked
from owm_envs.task.observation import ObservationLayout
from owm_envs.task.reset import named_key, sample_start
from owm_envs.task.reward import reward
from owm_envs.task.sensors import goal_error, measure

_BEYOND_REASON = 1e9
"""No number of a relative view comes near it (SI units), and float32 still squares it."""


class EnvState(NamedTuple):
    """Everything an episode carries from one action to the next; `info` reads it out."""

    physics: PhysicalState
    view: Float[Array, "13"]
    """True relative view, its quaternion continuous along the episode."""
    measured: Float[Array, "13"]
    port: Int[Array, ""]
    count: Int[Array, ""]
    """Actions taken."""
    outcome: Int[Array, ""]
    """An `Outcome`."""
    collided: Bool[Array, ""]
    """Whether the hull was ever touched."""
    clearance: Float[Array, ""]
    """Least `swept_clearance` of the bounding sphere to any keep-out box so far, m."""
    closest: Closest
    episode_key: Key[Array, ""]
    next_key: Key[Array, ""]
    """From which the following episode in this slot starts."""


class StepResult(NamedTuple):
    """What a step returns beside the state."""

    observation: Float[Array, "O"]
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]


class DockingEnv:
    """Rendezvous and docking at the International Space Station.

    `reset` and `step` are pure and written for one episode: `vmap` them over states and keys. Actions are held for
    `config.steps_per_action` simulation steps. Slots chain their keys: after an episode, `reset(params,
    state.next_key)` starts the next one reproducibly.

    Args:
        config: as `load_config` takes it.
        dynamics: equations of motion of your own in place of the fidelity's, a hashable `Dynamics` (a frozen
            dataclass is); check them with `owm_envs.testing.check_env`.
        overrides: fields of `DockingConfig`.

    Raises:
        ValueError: an unknown or out-of-bounds field, naming it.
        TypeError: `dynamics` is not a hashable `Dynamics`, naming what it lacks.
    """

    def __init__(
        self,
        config: DockingConfig | Mapping[str, Any] | str | None = None,
        *,
        dynamics: Dynamics | None = None,
        **overrides: Any,
    ):
        self.config = load_config(config, **overrides)
        if dynamics is not None:
            require_dynamics(dynamics)
        self.dynamics = DYNAMICS[self.config.fidelity](self.config) if dynamics is None else dynamics
        chaser = self.config.chaser
        self.layout = ObservationLayout(
            has_epoch=self.dynamics.has_epoch,
            has_goal_error=self.config.goal_error,
            normalize=self.config.normalize,
            reference_day=float(mjd_from_calendar(self.config.chief.reference_epoch)[0]),
            wrench_limit=(chaser.force_limit,) * 3 + (chaser.torque_limit,) * 3,
        )

    def default_params(self) -> Params:
        """The configuration's numbers as arrays. Raises RuntimeError at float64 outside JAX's 64-bit mode."""
        return params_from_config(self.config)

    def reset(
        self, params: Params, *, key: Key[Array, ""], port: int | Int[Array, ""] = -1
    ) -> tuple[EnvState, Float[Array, "O"]]:
        """Start an episode.

        Args:
            key: decides the whole episode, noise included, and the key of the next one.
            port: index of the port to dock at; negative draws one of the configured ports.
        """
        next_key, episode_key = jax.random.split(key)
        start = sample_start(params, key=named_key(episode_key, "start"), port=jnp.asarray(port, jnp.int32))
        physics = self.dynamics.init(params, start.epoch, start.view)
        delay = self.config.chaser.actuation_delay
        physics = physics._replace(actuator=jnp.zeros((delay, 6), start.view.dtype))
        clearance = self._clearance(params, start.view[:3], start.view[:3])
        closest = self._approach(params, start.port, start.view, physics.elapsed)
        state = EnvState(
            physics=physics,
            view=start.view,
            measured=start.view,
            port=start.port,
            count=jnp.zeros((), jnp.int32),
            outcome=jnp.asarray(Outcome.RUNNING, jnp.int32),
            collided=clearance <= 0,
            clearance=clearance,
            closest=closest,
            episode_key=episode_key,
            next_key=next_key,
        )
        return self._observe(params, state)

    def step(self, params: Params, state: EnvState, action: Float[Array, "6"]) -> tuple[EnvState, StepResult]:
        """Hold an action for one decision; an episode that has ended stays as it is, with reward zero.

        An action that is not finite moves nothing and ends the episode as `Outcome.INVALID_ACTION`; dynamics that
        come to no usable number end it as `Outcome.DIVERGED`, in the last state that was one.
        """
        dtype = state.view.dtype
        was_running = state.outcome == Outcome.RUNNING
        valid = jnp.all(jnp.isfinite(action))
        wrench = self.layout.wrench(jnp.where(valid, action, 0).astype(dtype), params.chaser.wrench_limit)
        invalid = was_running & ~valid
        started = state._replace(outcome=jnp.where(invalid, Outcome.INVALID_ACTION, state.outcome).astype(jnp.int32))

        def substep(carry, _):
            now, touched = carry
            after, touches = self._advance(params, now, wrench)
            running = now.outcome == Outcome.RUNNING
            sound = jnp.all(jnp.abs(after.view) < _BEYOND_REASON)  # false of NaN
            moves = running & sound
            kept = jax.tree.map(lambda new, old: jnp.where(moves, new, old), after, now)
            outcome = jnp.where(running & ~sound, Outcome.DIVERGED, kept.outcome).astype(jnp.int32)
            return (kept._replace(outcome=outcome), touched | (touches & moves)), None

        carry = (started, jnp.zeros((), bool))
        if self.config.steps_per_action == 1:
            carry, _ = substep(carry, None)
        else:
            carry, _ = jax.lax.scan(substep, carry, length=self.config.steps_per_action)
        ended, touched = carry

        count = state.count + was_running
        late = (ended.outcome == Outcome.RUNNING) & (count >= params.horizon_steps)
        ended = ended._replace(count=count, outcome=jnp.where(late, Outcome.TIMEOUT, ended.outcome).astype(jnp.int32))
        goal = params.goals[ended.port]
        earned = reward(
            params,
            error_norms(goal_error(ended.view, goal)),
            error_norms(goal_error(state.view, goal))[0],
            wrench,
            touched,
            ended.outcome == Outcome.DOCKED,
            ended.outcome == Outcome.ESCAPED,
        )
        observed, observation = self._observe(params, ended)
        outcome = ended.outcome
        terminated = (outcome == Outcome.DOCKED) | (outcome == Outcome.COLLIDED) | (outcome == Outcome.ESCAPED)
        truncated = (outcome == Outcome.TIMEOUT) | (outcome == Outcome.INVALID_ACTION) | (outcome == Outcome.DIVERGED)
        return observed, StepResult(observation, jnp.where(was_running, earned, 0).astype(dtype), terminated, truncated)

    def info(self, params: Params, state: EnvState) -> dict[str, Array]:
        """The truth behind a state: for recording and scoring, never for a policy.

        Returns:
            true_state and measured_state (13,), goal_pose (7,), true_goal_error (12,), epoch [MJD day, s of day],
            port, outcome, collided, clearance, and the errors at closest approach, SI units.
        """
        goal = params.goals[state.port]
        return {
            "true_state": state.view,
            "measured_state": state.measured,
            "goal_pose": goal,
            "true_goal_error": goal_error(state.view, goal),
            "epoch": self._epoch(state),
            "port": state.port,
            "outcome": state.outcome,
            "collided": state.collided,
            "clearance": state.clearance,
            **{f"closest_{name}": value for name, value in state.closest._asdict().items()},
        }

    def _advance(self, params, state, wrench):
        """One simulation step and its events, whatever the outcome so far; also whether the hull was touched."""
        queue = jnp.concatenate([state.physics.actuator, wrench[None]])
        delivered = self._deliver(params, queue[0])
        physics = self.dynamics.step(params, state.physics._replace(actuator=queue[1:]), delivered, params.dt)
        view = self.dynamics.relative_state(params, physics)
        # Attitude and its negative are the same; keep the one next to the last.
        sign = jnp.where(jnp.sum(view[6:10] * state.view[6:10]) < 0, -1, 1).astype(view.dtype)
        view = view.at[6:10].multiply(sign)

        clearance = self._clearance(params, state.view[:3], view[:3])
        touches = clearance <= 0
        approach = self._approach(params, state.port, view, physics.elapsed)
        nearer = approach.distance < state.closest.distance
        closest = jax.tree.map(lambda new, old: jnp.where(nearer, new, old), approach, state.closest)

        docked = is_docked(jnp.stack(approach[:4]), params.docking)
        escaped = jnp.sum(view[:3] ** 2) > params.escape_radius**2
        crashed = touches & self.config.collision_terminates
        outcome = jnp.select(
            [crashed, docked, escaped], [Outcome.COLLIDED, Outcome.DOCKED, Outcome.ESCAPED], Outcome.RUNNING
        ).astype(jnp.int32)
        state = state._replace(
            physics=physics,
            view=view,
            outcome=outcome,
            collided=state.collided | touches,
            clearance=jnp.minimum(state.clearance, clearance),
            closest=closest,
        )
        return state, touches

    def _deliver(self, params, wrench):
        """What the thrusters make of a command."""
        turn = quat_from_rotation_vector(params.chaser.misalignment)
        scaled = wrench * params.chaser.thrust_scale
        return jnp.concatenate([quat_rotate(turn, scaled[:3]), quat_rotate(turn, scaled[3:])])

    def _clearance(self, params, start, end):
        boxes = jnp.concatenate([params.hull, params.obstacles])
        return swept_clearance(start, end, params.chaser.radius, boxes)

    def _approach(self, params, port, view, elapsed):
        return Closest(*error_norms(goal_error(view, params.goals[port])), elapsed)

    def _epoch(self, state):
        epoch = state.physics.epoch
        return jnp.stack(normalize_epoch(epoch[0], epoch[1] + state.physics.elapsed))

    def _observe(self, params, state):
        key = jax.random.fold_in(named_key(state.episode_key, "noise"), state.count)
        measured = measure(params.noise, state.view, key=key)
        error = goal_error(measured, params.goals[state.port])
        return state._replace(measured=measured), self.layout.observe(self._epoch(state), measured, error)
