"""PettingZoo's `ParallelEnv` over a fleet: one compiled program and one host transfer a step for all chasers."""

import os
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces

from owm_envs.adapters.actions import real_numbers
from owm_envs.adapters.batch import Seen, state_from_host, state_to_host
from owm_envs.adapters.fork import about_to_use_jax
from owm_envs.adapters.gymnasium import scalar_info
from owm_envs.adapters.parts import Shown, each, shown, space_of
from owm_envs.adapters.pictures import RENDER_MODES, SIZE, Pictures, need_reset, require_station
from owm_envs.adapters.seeds import drawn_seed, seed_keys
from owm_envs.config import DockingConfig, load_config
from owm_envs.config.params import Params
from owm_envs.env import FleetEnv, FleetLayout, FleetState, StepResult
from owm_envs.flags import own_flags
from owm_envs.station import port_index
from owm_envs.task.events import Outcome
from owm_envs.task.sensors import Sensor
from owm_envs.view import VIEW_SIZE
from owm_envs.words import checked_seed, install, unknown

try:
    from pettingzoo import AECEnv, ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec
except ImportError as error:
    raise ImportError(f"owm_envs.pettingzoo needs PettingZoo ({error}): {install('pettingzoo')}") from error


def parallel_env(
    num_chasers: int = 3, config: Mapping[str, Any] | DockingConfig | str | os.PathLike | None = None, **kwargs: Any
) -> "DockingParallelEnv":
    """Several chasers to distinct ports at once, acting together: `DockingParallelEnv` of the same arguments."""
    return DockingParallelEnv(num_chasers, config, **kwargs)


def raw_env(
    num_chasers: int = 3, config: Mapping[str, Any] | DockingConfig | str | os.PathLike | None = None, **kwargs: Any
) -> AECEnv:
    """The same with the chasers acting in turn; time goes on when all of them have."""
    return parallel_to_aec(parallel_env(num_chasers, config, **kwargs))


env = raw_env  # actions are clipped and checked inside: nothing to wrap


class FleetProgram:
    """`reset` and `step` of one episode of several chasers, compiled once per configuration.

    `traces` counts compilations by program.
    """

    def __init__(self, config: DockingConfig, num_chasers: int, observe_others: bool, sensors: tuple[Sensor, ...]):
        self.env = FleetEnv(num_chasers, config, observe_others=observe_others, sensors=sensors)
        self.traces = {"reset": 0, "step": 0}
        self._reset = jax.jit(self._reset_fleet)
        self._step = jax.jit(self._step_fleet)

    @cached_property
    def params(self) -> Params:
        """The configuration's numbers as arrays; made when first asked for, not in the constructor."""
        about_to_use_jax()
        with own_flags():
            return self.env.default_params()

    def reset(self, key: jax.Array, ports: np.ndarray) -> tuple[FleetState, Seen, dict[str, np.ndarray]]:
        """Start an episode: a key, ports (N,) with -1 for a drawn one."""
        with own_flags():
            state, *host = self._reset(self.params, key, np.asarray(ports, np.int32))
            return state, *jax.device_get(tuple(host))

    def step(self, state: FleetState, actions: np.ndarray) -> tuple[FleetState, StepResult, dict[str, np.ndarray]]:
        """Advance all chasers by one decision: actions (N, 6). Returns the state, a StepResult and the info."""
        with own_flags():
            state, *host = self._step(self.params, state, actions)
            return state, *jax.device_get(tuple(host))

    def _reset_fleet(self, params, key, ports):
        self.traces["reset"] += 1
        state, observations = self.env.reset(params, key=key, ports=ports)
        return state, observations, self.env.info(params, state)

    def _step_fleet(self, params, state, actions):
        self.traces["step"] += 1
        state, result = self.env.step(params, state, actions)
        return state, result, self.env.info(params, state)


@lru_cache(maxsize=32)
def fleet_program(
    config: DockingConfig, num_chasers: int, observe_others: bool, sensors: tuple[Sensor, ...]
) -> FleetProgram:
    """The program of a configuration, shared by all environments that have it."""
    return FleetProgram(config, num_chasers, observe_others, sensors)


class DockingParallelEnv(ParallelEnv):
    """`num_chasers` agents "chaser_0", "chaser_1", ... that dock at distinct ports at once; see `FleetEnv`.

    An agent leaves `agents` when its episode has ended; its vehicle stays where it is, an obstacle to the others.
    Observations, or the state part of those with `sensors`, are laid out as `layout` (a `FleetLayout`) says; infos
    hold the truth, for scoring. `state()` is the truth of the whole fleet, for centralised critics: for each chaser,
    its true relative view (13), true goal error (12) and whether its episode is running.

    Args:
        num_chasers: agents, at most the number of configured ports.
        config: a `DockingConfig`, a mapping of its fields, or the path of a TOML file.
        observe_others: whether observations end with where the other chasers are.
        sensors: what each chaser carries beside relative navigation, as `DockingEnv` takes them.
        render_mode: None or "rgb_array".
        width, height, camera_name: as for `DockingGymEnv`; a chaser's camera is that of the first.
        overrides: fields of `DockingConfig` (`fidelity="iss-hcw"`, `noise="cooperative"`, ...), and `preset`.

    `reset(options={"dock_ports": NAMES})` assigns a port to each chaser, in order; what is None or missing is drawn.
    An action outside the box is clipped; one that is not finite raises ValueError naming the agent.
    """

    metadata = {  # noqa: RUF012 - PettingZoo's interface
        "name": "iss_docking_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": 20,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        num_chasers: int = 3,
        config: Mapping[str, Any] | DockingConfig | str | os.PathLike | None = None,
        *,
        observe_others: bool = True,
        sensors: Sequence[Sensor] = (),
        render_mode: str | None = None,
        width: int = SIZE[0],
        height: int = SIZE[1],
        camera_name: str | None = None,
        **overrides: Any,
    ):
        self.config: DockingConfig = load_config(config, **overrides)
        require_station(self.config, render_mode)
        self.render_mode = render_mode
        self._observe_others = observe_others
        self._sensors = tuple(sensors)
        self._program = fleet_program(self.config, num_chasers, observe_others, self._sensors)
        self._pictures = Pictures(render_mode, width, height, camera_name, num_chasers)
        self.metadata = {**type(self).metadata, "render_fps": max(1, round(1 / self.config.decision_dt))}
        self.possible_agents = [f"chaser_{index}" for index in range(num_chasers)]
        self.agents: list[str] = []
        limit = np.ones(6) if self.config.normalize else np.asarray(self.layout.own.wrench_limit)
        self._limit = limit = limit.astype(np.float32)
        self._action_spaces = {agent: spaces.Box(-limit, limit, dtype=np.float32) for agent in self.possible_agents}
        self._observation_spaces = {agent: space_of(self._program.env.shown_parts) for agent in self.possible_agents}
        self.state_space = spaces.Box(-np.inf, np.inf, ((VIEW_SIZE + 12 + 1) * num_chasers,), np.float32)
        self._state: FleetState | None = None
        self._info: dict[str, np.ndarray] = {}

    @property
    def fleet_env(self) -> FleetEnv:
        """The pure environment."""
        return self._program.env

    @property
    def layout(self) -> FleetLayout:
        """How an agent's observation is laid out: `layout.own` as that of a lone chaser, then the others."""
        return self._program.env.layout

    @property
    def traces(self) -> dict[str, int]:
        """Compilations so far of this configuration's programs."""
        return dict(self._program.traces)

    def observation_space(self, agent: str) -> spaces.Space:
        """The space of an agent's observations."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """The space of an agent's actions: body force and torque [N, N m], or fractions of the limits."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode; without a seed it follows from the last one."""
        ports = self._ports(options or {})
        if seed is None and self._state is not None:
            key = self._state.next_key
        else:
            if seed is None:
                seed = drawn_seed(gymnasium.utils.seeding.np_random()[0])
            key = seed_keys([checked_seed(seed)])[0]
        self._state, observations, self._info = self._program.reset(key, ports)
        self.agents = list(self.possible_agents)
        self._pictures.begin(self._info["true_state"], range(len(self.possible_agents)))
        return self._by_agent(observations, self.agents), self._infos(self.agents)

    def step(self, actions: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], ...]:
        """Hold each agent's action for one decision.

        Raises:
            ValueError: an agent is unknown, or has no action, or one of the wrong shape or not finite.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        acting, stacked = self.agents, self._stacked(actions)
        if not acting:
            return {}, {}, {}, {}, {}
        self._state, result, self._info = self._program.step(self._state, stacked)
        moved = np.isin(self.possible_agents, acting)
        self._pictures.extend(self._info["true_state"], stacked, self._limit, moved)
        rewards, terminated, truncated = (
            {agent: values[self.possible_agents.index(agent)].item() for agent in acting}
            for values in (result.reward, result.terminated, result.truncated)
        )
        self.agents = [agent for agent in acting if not (terminated[agent] or truncated[agent])]
        return self._by_agent(result.observation, acting), rewards, terminated, truncated, self._infos(acting)

    def state(self) -> np.ndarray:
        """The truth of the whole fleet, float32: view 13, goal error 12 and whether it is running, of each chaser."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before state()")
        running = (self._info["outcome"] == Outcome.RUNNING)[:, None]
        parts = [self._info["true_state"], self._info["true_goal_error"], running]
        return np.concatenate(parts, axis=1).astype(np.float32).ravel()

    def render(self) -> np.ndarray | None:
        """The fleet as an RGB picture, or None without a render mode."""
        if self.render_mode is None:
            return None
        need_reset(self._state)
        distances = np.linalg.norm(self._info["true_goal_error"][:, :3], axis=1)
        outcomes = [Outcome(code) for code in self._info["outcome"].tolist()]
        notes = [
            f"{distance:.1f} m" if outcome is Outcome.RUNNING else outcome.name.lower()
            for distance, outcome in zip(distances, outcomes)
        ]
        seconds = float(jax.device_get(self._state.chasers.physics.elapsed))
        boxes = np.concatenate([self._program.params.hull, self._program.params.obstacles])
        together = [range(len(notes))]
        title = f"{self.config.fidelity}   t {seconds:.1f} s"
        views, ports = self._info["true_state"], self._info["port"]
        return self._pictures.drawn(together, views, ports, notes, [title], [[]], boxes)[0]

    def close(self) -> None:
        """Nothing to release."""

    def _ports(self, options: Mapping[str, Any]) -> np.ndarray:
        for name in options:
            if name != "dock_ports":  # PettingZoo asks that any option be taken
                warnings.warn(unknown("reset option", name, ("dock_ports",)), stacklevel=3)
        count = len(self.possible_agents)
        given = options.get("dock_ports") or []
        if isinstance(given, (str, bytes)) or not isinstance(given, Sequence) or len(given) > count:
            raise ValueError(f"dock_ports must be a list of at most {count} port names, got {given!r}")
        assigned = [port_index(name) for name in given if name is not None]
        if len(set(assigned)) < len(assigned):
            raise ValueError(f"dock_ports must be distinct, got {', '.join(map(str, given))}")
        if len(set(assigned) | {port_index(name) for name in self.config.ports}) < count:
            raise ValueError(f"dock_ports {given!r} leave too few ports for {count} chasers")
        ports = [-1 if name is None else port_index(name) for name in given]
        return np.array(ports + [-1] * (count - len(ports)), np.int32)

    def _stacked(self, actions: Mapping[str, np.ndarray]) -> np.ndarray:
        for agent in actions:
            if agent not in self.possible_agents:
                raise ValueError(unknown("agent", agent, self.possible_agents))
        stacked = np.zeros((len(self.possible_agents), 6), self.config.precision)
        for index, agent in enumerate(self.possible_agents):
            if agent not in self.agents:
                continue
            if agent not in actions:
                raise ValueError(f"no action for {agent}; acting are {', '.join(self.agents)}")
            action = real_numbers(actions[agent], (6,), f"the action of {agent}").astype(self.config.precision)
            if not np.isfinite(action).all():
                raise ValueError(f"the action of {agent} must be finite, got {action}")
            stacked[index] = action
        return stacked

    def _by_agent(self, parts: dict[str, np.ndarray], agents: list[str]) -> dict[str, Shown]:
        slots = {agent: self.possible_agents.index(agent) for agent in agents}
        seen = shown({name: parts[name] for name in self._program.env.shown_parts})
        return {agent: each(lambda rows, slot=slot: rows[slot].copy(), seen) for agent, slot in slots.items()}

    def _infos(self, agents: list[str]) -> dict[str, dict[str, Any]]:
        info = {name: np.array(value) for name, value in self._info.items()}
        return {agent: scalar_info(info, self.possible_agents.index(agent)) for agent in agents}

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in self.__dict__.items() if name != "_program"}
        if self._state is not None:
            kept["_state"] = jax.device_get(self._state._replace(chasers=state_to_host(self._state.chasers)))
        return kept

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept)
        self._program = fleet_program(self.config, len(self.possible_agents), self._observe_others, self._sensors)
        if self._state is not None:
            with own_flags():
                separation, others = jax.tree.map(jax.numpy.asarray, (self._state.separation, self._state.others))
            self._state = FleetState(state_from_host(self._state.chasers), separation, others)
