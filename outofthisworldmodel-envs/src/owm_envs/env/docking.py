"""The docking task as a pure environment: `reset` and `step` over one fidelity's equations of motion."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PyTree, Shaped

from astrojax.attitude import quat_sign
from astrojax.compilation import all_of, stored, summed
from astrojax.time import mjd_from_calendar, normalize_epoch
from owm_envs.config import DockingConfig, Structure, load_config
from owm_envs.config.params import Params, params_from_config
from owm_envs.dynamics import DYNAMICS, Dynamics, PhysicalState, TurningTarget, require_dynamics, station_orbit
from owm_envs.dynamics.turning import seen_turning
from owm_envs.task.actuators import ActuatorState, actuators_at_rest, deliver
from owm_envs.task.collision import Clearance, advance_clearance, clearance_at
from owm_envs.task.events import Closest, Outcome, error_norms, is_docked, safe_norm
from owm_envs.task.navigation import RelativeNavigation, TargetRate, advance_bias, goal_error, start_bias
from owm_envs.task.observation import ObservationLayout
from owm_envs.task.plume import NearHull, near_hull
from owm_envs.task.randomization import Drawn, draw, drawn_anew, episode_params, named_draws
from owm_envs.task.reset import Start, named_key, sample_start
from owm_envs.task.reward import reward
from owm_envs.task.selected import apply_where
from owm_envs.task.sensors import (
    STATE,
    STATE_VALID,
    Sensor,
    Truth,
    age_name,
    blank,
    chunk_of_costly,
    is_costly,
    own_draws,
    own_params,
    part_shapes,
    require_sensors,
    sense,
)
from owm_envs.view import VIEW_SLICES, View

_BEYOND_REASON = 1e9
"""No number of a relative view comes near it (SI units), and float32 still squares it."""


def is_sound(view: Float[Array, "13"]) -> Bool[Array, ""]:
    """Whether dynamics have come to a usable relative view."""
    return all_of(jnp.abs(view) < _BEYOND_REASON)  # false of NaN


class EnvState(NamedTuple):
    """Everything an episode carries from one action to the next; `info` reads it out."""

    physics: PhysicalState
    view: Float[Array, "13"]
    """True relative view, its quaternion continuous along the episode."""
    error: Float[Array, "12"]
    """Of the true relative view to the goal, as `goal_error` gives it."""
    measured: dict[str, Shaped[Array, "..."]]
    """What each sensor shows, by its name; relative navigation's is the view (13,), SI units. Also the ages of what
    costly ones show."""
    port: Int[Array, ""]
    count: Int[Array, ""]
    """Actions taken."""
    outcome: Int[Array, ""]
    """An `Outcome`."""
    collided: Bool[Array, ""]
    """Whether the hull was ever touched."""
    clearance: Clearance
    """Of the bounding sphere to the keep-out boxes."""
    closest: Closest
    actuators: ActuatorState
    bias: Float[Array, "4 3"] | None
    """Time-correlated error of the sensors, of unit variance per axis; None without."""
    drawn: Drawn | None
    """What was drawn for this episode; None without randomisation."""
    looks: dict[str, PyTree]
    """What sensors drew for this episode, by their names; empty without."""
    noise_key: Key[Array, ""]
    """Of this episode's sensor errors."""
    next_key: Key[Array, ""]
    """From which the following episode in this slot starts."""


class StepResult(NamedTuple):
    """What a step returns beside the state."""

    observation: dict[str, Shaped[Array, "..."]]
    """Parts by name."""
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]


class DockingEnv:
    """Rendezvous and docking at the International Space Station.

    `reset` and `step` are pure and written for one episode: `vmap` them over states and keys. Actions are held for
    `config.steps_per_action` simulation steps. Slots chain their keys: after an episode, `reset(params,
    state.next_key)` starts the next one reproducibly. `place`, `begin`, `advance`, `finish` and `observe` are the
    pieces they are made of, for environments that put something in between.

    Environments of equal `structure` and `dynamics` are equal and run the same compiled programs; what else they are
    configured to is in their `params` alone. So pass `params` into a compiled function that takes the environment as
    a static argument, rather than ask for `default_params()` inside it.

    Args:
        config: as `load_config` takes it.
        dynamics: equations of motion of your own in place of the fidelity's, a hashable `Dynamics` (a frozen
            dataclass is); check them with `owm_envs.testing.check_env`.
        sensors: what the chaser carries beside relative navigation: each `Sensor` is a part of the observation.
        overrides: fields of `DockingConfig`.

    Raises:
        ValueError: an unknown or out-of-bounds field, naming it.
        TypeError: `dynamics` is not a hashable `Dynamics`, or a sensor not a hashable `Sensor`, naming what it lacks.
    """

    def __init__(
        self,
        config: DockingConfig | Mapping[str, Any] | str | None = None,
        *,
        dynamics: Dynamics | None = None,
        sensors: Sequence[Sensor] = (),
        **overrides: Any,
    ):
        self.config = load_config(config, **overrides)
        self.structure: Structure = self.config.structure
        if dynamics is not None:
            require_dynamics(dynamics)
        self.dynamics = DYNAMICS[self.config.fidelity](self.config) if dynamics is None else dynamics
        if self.structure.turning:
            self.dynamics = TurningTarget(self.dynamics)
        self.given_sensors = tuple(sensors)
        structure = self.structure
        navigation = RelativeNavigation(
            structure.precision, structure.steps_per_action, structure.quiet, structure.heavy_tailed
        )
        turning = [TargetRate(structure.steps_per_action, structure.quiet)] if structure.turning else []
        self.sensors = require_sensors([navigation, *turning, *_camera(self.config), *sensors])
        chaser = self.config.chaser
        self.layout = ObservationLayout(
            has_epoch=self.dynamics.has_epoch,
            has_goal_error=self.config.goal_error,
            normalize=self.config.normalize,
            reference_day=float(mjd_from_calendar(self.config.chief.reference_epoch)[0]),
            wrench_limit=(chaser.force_limit,) * 3 + (chaser.torque_limit,) * 3,
        )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.config.__repr_str__(', ')})"

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other._program_key == self._program_key

    def __hash__(self) -> int:
        return hash(self._program_key)

    @property
    def _program_key(self):
        return self.structure, self.dynamics, self.sensors

    @property
    def name(self) -> str:
        """The fidelity, or the class of dynamics of one's own."""
        dynamics = self.dynamics.orbits if self.structure.turning else self.dynamics
        own = DYNAMICS[self.config.fidelity](self.config) != dynamics
        return type(dynamics).__name__ if own else self.config.fidelity

    @property
    def observation_parts(self) -> dict[str, jax.ShapeDtypeStruct]:
        """Shape and dtype of each part that `reset` and `step` return, by its name."""
        return {**part_shapes(self.sensors), STATE: jax.ShapeDtypeStruct((self.layout.size,), jnp.float32)}

    @property
    def shown_parts(self) -> dict[str, jax.ShapeDtypeStruct]:
        """Those parts that the configured `observation` has; adapters show no other."""
        hidden = () if "state" in self.config.observation else (STATE, STATE_VALID)
        return {name: part for name, part in self.observation_parts.items() if name not in hidden}

    @property
    def costly(self) -> bool:
        """Whether a sensor's measurement costs more than to advance an episode."""
        return any(map(is_costly, self.sensors))

    def default_params(self) -> Params:
        """The configuration's numbers as arrays. Raises RuntimeError at float64 outside JAX's 64-bit mode."""
        return params_from_config(self.config)._replace(sensors=own_params(self.sensors))

    def reset(
        self,
        params: Params,
        *,
        key: Key[Array, ""],
        port: int | Int[Array, ""] = -1,
        before: EnvState | None = None,
        anew: Mapping[str, Bool[Array, ""]] | None = None,
    ) -> tuple[EnvState, dict[str, Array]]:
        """Start an episode: its state, and the parts of its first observation.

        Args:
            key: decides the whole episode, noise included, and the key of the next one.
            port: index of the port to dock at; negative draws one of the configured ports.
            before: an episode from which to keep what is not drawn anew; everything is when None.
            anew: of each of `owm_envs.task.randomization.VARIATIONS` whether it is drawn anew.
        """
        next_key, episode_key = jax.random.split(key)
        drawn = self.draw(params, episode_key)
        start = sample_start(params, key=named_key(episode_key, "start"), port=jnp.asarray(port, jnp.int32))
        if before is not None:
            drawn = drawn_anew(drawn, before.drawn, anew)
        state = self.place(params, start, drawn, episode_key, next_key)
        if before is not None:
            looks = {name: drawn_anew(look, before.looks[name], anew) for name, look in state.looks.items()}
            state = state._replace(looks=looks)
        return self.observe(params, state)

    def draw(self, params: Params, episode_key: Key[Array, ""]) -> Drawn | None:
        """What the configured ranges leave to each episode; None if they leave nothing."""
        if not self.structure.randomized:
            return None
        faulty, turning, key = self.structure.faulty, self.structure.turning, named_key(episode_key, "randomization")
        return draw(params.randomization, faulty=faulty, turning=turning, key=key)

    def place(
        self,
        params: Params,
        start: Start,
        drawn: Drawn | None,
        episode_key: Key[Array, ""],
        next_key: Key[Array, ""],
    ) -> EnvState:
        """The state of an episode about to begin at `start`, not observed yet."""
        params = episode_params(params, drawn)
        if self.structure.turning:
            start = start._replace(view=seen_turning(start.view, params.target_rate))
        noise_key = named_key(episode_key, "noise")
        physics = self.dynamics.init(params, start.epoch, start.view)
        bias = None
        if self.structure.biased:
            bias = start_bias(start.view.dtype, key=self._bias_key(noise_key, 0))
        clearance = clearance_at(View.of(start.view).position, params.chaser.radius, self._boxes(params))
        error = goal_error(start.view, params.goals[start.port])
        return EnvState(
            physics=physics,
            view=start.view,
            error=error,
            measured=blank(self.sensors),
            port=start.port,
            count=jnp.zeros((), jnp.int32),
            outcome=jnp.asarray(Outcome.RUNNING, jnp.int32),
            collided=clearance.now <= 0,
            clearance=clearance,
            closest=Closest(*error_norms(error), jnp.copy(physics.elapsed)),
            actuators=actuators_at_rest(self.structure, start.view.dtype),
            bias=bias,
            drawn=drawn,
            looks=own_draws(self.sensors, params, key=named_key(episode_key, "looks")),
            noise_key=noise_key,
            next_key=next_key,
        )

    def step(self, params: Params, state: EnvState, action: Float[Array, "6"]) -> tuple[EnvState, StepResult]:
        """Hold an action for one decision; an episode that has ended stays as it is, with reward zero.

        An action that is not finite moves nothing and ends the episode as `Outcome.INVALID_ACTION`; dynamics that
        come to no usable number end it as `Outcome.DIVERGED`, in the last state that was one.
        """
        started, wrench = self.begin(params, state, action)

        def substep(carry, _):
            now, touched = carry
            after, touches = self.advance(params, now, wrench)
            running = now.outcome == Outcome.RUNNING
            sound = is_sound(after.view)
            moves = stored(running & sound)
            kept = jax.tree.map(lambda new, old: jnp.where(moves, new, old), after, now)
            outcome = jnp.where(running & ~sound, Outcome.DIVERGED, kept.outcome).astype(jnp.int32)
            return (kept._replace(outcome=outcome), touched | (touches & moves)), None

        carry = (started, jnp.zeros((), bool))
        if self.structure.steps_per_action == 1:
            carry, _ = substep(carry, None)
        else:
            carry, _ = jax.lax.scan(substep, carry, length=self.structure.steps_per_action)
        ended, touched = carry
        return self.finish(params, state, ended, wrench, touched)

    def begin(self, params: Params, state: EnvState, action: Float[Array, "6"]) -> tuple[EnvState, Float[Array, "6"]]:
        """Before a decision's first simulation step: the state, ended if the action is not finite, and the wrench.

        Raises:
            TypeError: the action is not of real numbers, when it is traced.
        """
        if not any(jax.dtypes.issubdtype(jnp.result_type(action), kind) for kind in (np.floating, np.integer)):
            raise TypeError(f"action must be real numbers, got {jnp.result_type(action)}")
        params = episode_params(params, state.drawn)
        valid = all_of(jnp.isfinite(action))
        wrench = self.layout.wrench(jnp.where(valid, action, 0).astype(state.view.dtype), params.chaser.wrench_limit)
        invalid = (state.outcome == Outcome.RUNNING) & ~valid
        outcome = jnp.where(invalid, Outcome.INVALID_ACTION, state.outcome).astype(jnp.int32)
        return state._replace(outcome=outcome), wrench

    def finish(
        self, params: Params, state: EnvState, ended: EnvState, wrench: Float[Array, "6"], touched: Bool[Array, ""]
    ) -> tuple[EnvState, StepResult]:
        """After a decision's last simulation step: the horizon, the reward and the observation.

        Args:
            state: before the decision.
            ended: after its simulation steps.
            wrench: the command held, N and N m.
            touched: whether any of them touched something.
        """
        own = episode_params(params, state.drawn)
        was_running = state.outcome == Outcome.RUNNING
        count = state.count + was_running.astype(state.count.dtype)
        late = (ended.outcome == Outcome.RUNNING) & (count >= own.horizon_steps)
        ended = ended._replace(count=count, outcome=jnp.where(late, Outcome.TIMEOUT, ended.outcome).astype(jnp.int32))
        if state.bias is not None:
            key = self._bias_key(state.noise_key, count)
            lapse = own.dt * self.structure.steps_per_action
            bias = advance_bias(state.bias, own.noise.bias.correlation_time, lapse, key=key)
            ended = ended._replace(bias=jnp.where(was_running, bias, state.bias))
        earned = reward(
            own,
            error_norms(ended.error),
            safe_norm(state.error[:3]),
            wrench,
            touched,
            ended.outcome == Outcome.DOCKED,
            ended.outcome == Outcome.ESCAPED,
        )
        observed, observation = self.observe(params, ended, was_running)
        outcome = ended.outcome
        terminated = (outcome == Outcome.DOCKED) | (outcome == Outcome.COLLIDED) | (outcome == Outcome.ESCAPED)
        truncated = (outcome == Outcome.TIMEOUT) | (outcome == Outcome.INVALID_ACTION) | (outcome == Outcome.DIVERGED)
        earned = jnp.where(was_running, earned, 0).astype(state.view.dtype)
        return observed, StepResult(observation, earned, terminated, truncated)

    def relocate(self, params: Params, state: EnvState, view: Float[Array, "13"]) -> EnvState:
        """The same episode with its chaser at another true relative view; the next step measures its clearance."""
        params = episode_params(params, state.drawn)
        physics = self.dynamics.init(params, state.physics.epoch, view)
        unknown = state.clearance._replace(now=jnp.zeros_like(state.clearance.now))
        return state._replace(
            physics=physics, view=view, error=goal_error(view, params.goals[state.port]), clearance=unknown
        )

    def info(self, params: Params, state: EnvState) -> dict[str, Array]:
        """The truth behind a state: for recording and scoring, never for a policy.

        Returns:
            true_state and measured_state (13,), goal_pose (7,), true_goal_error (12,), epoch [MJD day, s of day],
            port, outcome, is_success, collided, clearance, the errors at closest approach, SI units, the ages
            [decisions] of what costly sensors show, and what was drawn.
        """
        goal = params.goals[state.port]
        return {
            "true_state": state.view,
            "measured_state": state.measured[STATE],
            "goal_pose": goal,
            "true_goal_error": state.error,
            "epoch": self._epoch(state),
            "port": state.port,
            "outcome": state.outcome,
            "is_success": state.outcome == Outcome.DOCKED,
            "collided": state.collided,
            "clearance": state.clearance.least,
            **{f"closest_{name}": value for name, value in state.closest._asdict().items()},
            **{age_name(sensor): state.measured[age_name(sensor)] for sensor in self.sensors if is_costly(sensor)},
            **({} if state.drawn is None else {f"drawn_{k}": v for k, v in named_draws(state.drawn).items()}),
            **{f"drawn_{n}_{k}": v for n, look in state.looks.items() for k, v in look._asdict().items()},
        }

    def advance(self, params: Params, state: EnvState, wrench: Float[Array, "6"]) -> tuple[EnvState, Bool[Array, ""]]:
        """One simulation step and its events, whatever the outcome so far; also whether the hull was touched."""
        params = episode_params(params, state.drawn)
        actuators, delivered = deliver(
            params.chaser, state.actuators, wrench, params.dt, self.near_hull(params, state.view)
        )
        physics = self.dynamics.step(params, state.physics, delivered, params.dt)
        view = self.dynamics.relative_state(params, physics)
        # Attitude and its negative are the same; keep the one next to the last.
        before, after = View.of(state.view), View.of(view)
        view = stored(view.at[VIEW_SLICES.attitude].multiply(quat_sign(after.attitude, before.attitude)))

        position = View.of(view).position
        clearance, touches = advance_clearance(
            state.clearance, before.position, position, params.chaser.radius, self._boxes(params)
        )
        error = stored(goal_error(view, params.goals[state.port]))
        norms = stored(error_norms(error))
        approach = Closest(*norms, physics.elapsed)
        nearer = approach.distance < state.closest.distance
        closest = jax.tree.map(lambda new, old: jnp.where(nearer, new, old), approach, state.closest)

        docked = is_docked(norms, params.docking)
        escaped = summed(position**2) > params.escape_radius**2
        crashed = touches & self.structure.collision_terminates
        outcome = jnp.select(
            [crashed, docked, escaped], [Outcome.COLLIDED, Outcome.DOCKED, Outcome.ESCAPED], Outcome.RUNNING
        ).astype(jnp.int32)
        state = state._replace(
            physics=physics,
            actuators=actuators,
            view=view,
            error=error,
            outcome=outcome,
            collided=state.collided | touches,
            clearance=clearance,
            closest=closest,
        )
        return state, touches

    def near_hull(self, params: Params, view: Float[Array, "13"]) -> NearHull | None:
        """The hull that throws plumes back to a chaser at a true relative view; None where none does."""
        return near_hull(params.chaser, view, self._boxes(params)) if self.structure.plume else None

    def _bias_key(self, noise_key, count):
        return jax.random.fold_in(named_key(noise_key, "bias"), count)

    def _boxes(self, params):
        return jnp.concatenate([params.hull, params.obstacles])

    def _epoch(self, state):
        epoch = state.physics.epoch
        return jnp.stack(normalize_epoch(epoch[0], epoch[1] + state.physics.elapsed))

    def observe(
        self, params: Params, state: EnvState, running: Bool[Array, ""] | bool = True
    ) -> tuple[EnvState, dict[str, Array]]:
        """Measure: the state with what its sensors show, and the parts of the observation.

        Args:
            running: whether the episode was at the last decision; after that, costly sensors hold what they show.
        """
        epoch = self._epoch(state)
        truth = Truth(
            params=episode_params(params, state.drawn),
            view=View.of(state.view),
            epoch=epoch,
            port=state.port,
            count=state.count,
            physics=state.physics,
            bias=state.bias,
            stream=state.noise_key,
        )
        key = jax.random.fold_in(named_key(state.noise_key, "sensors"), state.count)
        measured = sense(
            self.sensors,
            state.measured,
            truth,
            key=key,
            orbit=lambda truth: station_orbit(self.dynamics, truth.params, truth.physics),
            drawn=state.looks,
            running=running,
        )
        # Of the measurement as it is shown, in float32.
        view = measured[STATE]
        error = goal_error(view.astype(jnp.float32), params.goals[state.port].astype(jnp.float32))
        shown = self.layout.observe(epoch, view, error)
        observation = {name: measured[name] for name in self.observation_parts}
        return state._replace(measured=measured), {**observation, STATE: shown}


def restart_where(
    env: DockingEnv, params: Params, due: Bool[Array, "B"], state: EnvState, observation: dict[str, Array]
) -> tuple[EnvState, dict[str, Array]]:
    """Start the next episode in the slots of `due`; in a compiled loop, at a cost for those alone.

    Args:
        state: of a batch, leading axis B.
        observation: of the batch; kept in the other slots.
    """
    chunk = chunk_of_costly() or 1 if env.costly else 16
    return apply_where(due, lambda key: env.reset(params, key=key), (state, observation), state.next_key, chunk=chunk)


def _camera(config: DockingConfig) -> list[Sensor]:
    """The sensor behind pixels; the camera is imported for none but those who ask for it."""
    if not config.has_pixels:
        return []
    from owm_envs.camera.sensor import CameraSensor

    return [CameraSensor(config.camera, config.randomization.camera)]
