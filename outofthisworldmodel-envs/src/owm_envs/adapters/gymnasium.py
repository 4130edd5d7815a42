"""Gymnasium's `Env` and `VectorEnv` over the compiled batch; the scalar one is a batch of one."""

import os
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from owm_envs.adapters.actions import real_numbers
from owm_envs.adapters.batch import BatchProgram, Seen
from owm_envs.adapters.parts import Shown, each, shown, space_of
from owm_envs.adapters.pictures import RENDER_MODES, SIZE, Pictures, need_reset, require_station
from owm_envs.adapters.seeds import drawn_seed, slot_seeds
from owm_envs.config import DockingConfig, load_config
from owm_envs.dynamics import Dynamics
from owm_envs.env import DockingEnv
from owm_envs.station import PORT_NAMES, goal_poses, port_index
from owm_envs.task.events import OUTCOME_NAMES
from owm_envs.task.observation import ObservationLayout
from owm_envs.task.randomization import VARIATIONS, drawable
from owm_envs.task.sensors import Sensor
from owm_envs.view import View
from owm_envs.words import checked_count, checked_seed, unknown


class _Shell:
    """What both adapters share: the configuration, spaces, the opaque state and its pictures."""

    def _build(self, config, overrides, num_envs: int, autoreset: AutoresetMode, pictures: Pictures, dynamics, sensors):
        self.config: DockingConfig = load_config(config, **overrides)
        require_station(self.config, pictures.mode)
        self.render_mode = pictures.mode
        self._pictures = pictures
        self.docking_env = DockingEnv(self.config, dynamics=dynamics, sensors=sensors)
        self._program = BatchProgram(self.docking_env, autoreset, num_envs)
        self._num_slots = num_envs
        self._state = None
        layout = self.docking_env.layout
        self._limit = limit = np.ones(6) if self.config.normalize else np.asarray(layout.wrench_limit)
        action_space = spaces.Box(-limit.astype(np.float32), limit.astype(np.float32), dtype=np.float32)
        return space_of(self.docking_env.shown_parts), action_space

    @property
    def layout(self) -> ObservationLayout:
        """How observations and actions are laid out."""
        return self.docking_env.layout

    @property
    def traces(self) -> dict[str, int]:
        """Compilations so far of the programs that environments of this structure and size share."""
        return dict(self._program.traces)

    def _port_choice(self, port) -> int:
        if isinstance(port, str):
            return port_index(port)
        if isinstance(port, (int, np.integer)) and not isinstance(port, bool) and 0 <= port < len(PORT_NAMES):
            return int(port)
        raise ValueError(unknown("dock_port", port, PORT_NAMES))

    def _slot_ports(self, options: Mapping[str, Any]) -> np.ndarray:
        given = options.get("dock_port")
        if given is None:
            return np.full(self._num_slots, -1, np.int32)
        if isinstance(given, str) or np.ndim(given) == 0:
            return np.full(self._num_slots, self._port_choice(given), np.int32)
        if len(given) != self._num_slots:
            raise ValueError(f"dock_port names {len(given)} ports for {self._num_slots} environments")
        return np.array([-1 if port is None else self._port_choice(port) for port in given], np.int32)

    def _check_options(self, options: Mapping[str, Any] | None, known: tuple[str, ...]) -> Mapping[str, Any]:
        for key in options or {}:
            if key not in known:
                raise ValueError(unknown("reset option", key, known))
        return options or {}

    def _anew(self, options: Mapping[str, Any]) -> dict[str, bool] | None:
        """Of what may be drawn by itself whether it is drawn anew; None for all of it."""
        if "variation" not in options:
            return None
        asked, known = options["variation"], drawable(self.config)
        if isinstance(asked, str) or not isinstance(asked, Collection):
            raise ValueError(f"variation must be a list of names ({', '.join(known) or 'none'}), got {asked!r}")
        for name in asked:
            if not known:
                raise ValueError(f"variation {name!r} has nothing to draw from: configure ranges in randomization")
            if name not in known:
                raise ValueError(unknown("variation", name, known))
        return {name: name in asked for name in VARIATIONS}

    def _actions(self, action, shape: tuple[int, ...]) -> np.ndarray:
        action, precision = real_numbers(action, shape), np.dtype(self.config.precision)
        if action.dtype.itemsize > precision.itemsize:
            # Too large for the precision is still a number, to be clipped.
            largest = np.finfo(precision).max
            action = np.where(np.isfinite(action), np.clip(action, -largest, largest), action)
        action = action.astype(precision, copy=False)
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        return action.reshape(self._num_slots, 6)

    def _drawn(self, slots: Sequence[int]) -> list[np.ndarray]:
        need_reset(self._state)
        host = self._program.to_host(self._state)
        titles, rows = [], []
        for slot in slots:
            goal, view = goal_poses()[host.port[slot]], View.of(host.view[slot])
            titles.append(f"{self.docking_env.name}   {PORT_NAMES[host.port[slot]]}")
            values = {
                "time": f"{host.physics.elapsed[slot]:.1f} s",
                "outcome": OUTCOME_NAMES[int(host.outcome[slot])],
                "to goal": f"{np.linalg.norm(view.position - goal[:3]):.2f} m",
                "speed": f"{np.linalg.norm(view.velocity):.3f} m/s",
                "clearance": f"{host.clearance.least[slot]:.2f} m (least)",
            }
            rows.append(list(values.items()))
        boxes = np.concatenate([self._program.params.hull, self._program.params.obstacles])
        alone = [[slot] for slot in slots]
        return self._pictures.drawn(alone, host.view, host.port, [""] * self._num_slots, titles, rows, boxes)

    def __getstate__(self) -> dict[str, Any]:
        kept = {k: v for k, v in self.__dict__.items() if k not in ("_program", "_state")}
        kept["_autoreset"] = self._program.autoreset
        kept["_host_state"] = None if self._state is None else self._program.to_host(self._state)
        return kept

    def __setstate__(self, kept: dict[str, Any]) -> None:
        kept = dict(kept)
        self._program = BatchProgram(kept["docking_env"], kept.pop("_autoreset"), kept["_num_slots"])
        state = kept.pop("_host_state")
        self._state = None if state is None else self._program.from_host(state)
        self.__dict__.update(kept)


class DockingGymEnv(_Shell, gymnasium.Env):
    """One docking episode at a time.

    Args:
        config: a `DockingConfig`, a mapping of its fields, or the path of a TOML file (a `str`, if the spec is to
            survive JSON).
        render_mode: None or "rgb_array".
        width, height: pixels of a picture.
        camera_name: whose picture, of `owm_envs.camera.views.CAMERA_NAMES`; None draws the flight from outside, with
            a view along its corridor and the chaser's own.
        dynamics: equations of motion of your own in place of the fidelity's, as `DockingEnv` takes them.
        sensors: what the chaser carries beside relative navigation, as `DockingEnv` takes them. With any,
            observations are dicts of parts.
        overrides: fields of `DockingConfig`, and `preset`.

    `reset(options={"dock_port": NAME})` assigns the port of that episode, and `"variation": NAMES` says which of the
    configured ranges it draws from anew ("vehicle", "orbit", "light", "camera", "material"); the rest stays as it was
    in the last episode. Without it everything is drawn anew. An action outside the box is clipped; one
    that is not finite raises ValueError.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012 - Gymnasium's interface

    def __init__(
        self,
        config: Mapping[str, Any] | DockingConfig | str | os.PathLike | None = None,
        render_mode: str | None = None,
        *,
        width: int = SIZE[0],
        height: int = SIZE[1],
        camera_name: str | None = None,
        dynamics: Dynamics | None = None,
        sensors: Sequence[Sensor] = (),
        **overrides: Any,
    ):
        pictures = Pictures(render_mode, width, height, camera_name, 1)
        spaces_ = self._build(config, overrides, 1, AutoresetMode.DISABLED, pictures, dynamics, sensors)
        self.observation_space, self.action_space = spaces_
        self.metadata = {**type(self).metadata, "render_fps": max(1, round(1 / self.config.decision_dt))}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.config.__repr_str__(', ')})"

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; without a seed it follows from the last one."""
        options = self._check_options(options, ("dock_port", "variation"))
        ports, anew = self._slot_ports(options), self._anew(options)
        if seed is None and self._state is not None:
            keys = self._program.next_keys(self._state)
        else:
            seed = drawn_seed(self.np_random) if seed is None else checked_seed(seed)
            keys = self._program.keys([seed])
            # What the environment reports as its seed names the episode that it flies.
            super().reset(seed=seed)
        if anew is None or self._state is None:
            self._state, observation, info = self._program.reset(keys, ports)
        else:
            self._state, observation, info = self._program.reset_where(self._state, np.ones(1, bool), keys, ports, anew)
        self._pictures.begin(info["true_state"], [0])
        return _first(observation), scalar_info(info, 0)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold an action [N, N m] (or fractions of the limits when normalised) for one decision."""
        actions = self._actions(action, (6,))
        if not np.isfinite(actions).all():
            raise ValueError(f"action must be finite, got {np.asarray(action)}")
        self._state, output = self._program.step(self._state, actions)
        result = output.result
        self._pictures.extend(output.info["true_state"], actions, self._limit, np.ones(1, bool))
        return (
            _first(result.observation),
            float(result.reward[0]),
            bool(result.terminated[0]),
            bool(result.truncated[0]),
            scalar_info(output.info, 0),
        )

    def render(self) -> np.ndarray | None:
        """The current state as an RGB picture, or None without a render mode."""
        return None if self.render_mode is None else self._drawn([0])[0]


class DockingVectorEnv(_Shell, VectorEnv):
    """A batch of docking episodes, advanced by one compiled program a step.

    Slot i reset with seed s equals a `DockingGymEnv` reset with seed s + i, later automatic resets included.

    Args:
        num_envs: slots.
        config, render_mode, width, height, camera_name, dynamics, sensors, overrides: as for `DockingGymEnv`.
        autoreset_mode: one of Gymnasium's `AutoresetMode`, or its name (which survives the spec's JSON).
        max_episode_steps: decisions after which an episode is truncated, if the horizon does not end it before.
        disable_env_checker: taken as `gymnasium.make` takes it; there is no checker of vector environments.

    `reset(options={"dock_port": NAME or one per slot (None draws it), "reset_mask": (num_envs,) bool,
    "variation": NAMES})`, the last as for `DockingGymEnv`. A slot whose
    action is not finite ends as `Outcome.INVALID_ACTION`. In `info`, arrays are batched; a mask `_name` says where
    `name` is set.
    """

    metadata = {  # noqa: RUF012 - Gymnasium's interface
        "render_modes": list(RENDER_MODES),
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | DockingConfig | str | os.PathLike | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        *,
        width: int = SIZE[0],
        height: int = SIZE[1],
        camera_name: str | None = None,
        dynamics: Dynamics | None = None,
        sensors: Sequence[Sensor] = (),
        max_episode_steps: int | None = None,
        disable_env_checker: bool | None = None,
        **overrides: Any,
    ):
        del disable_env_checker  # there is none for vector environments
        if max_episode_steps is not None:
            config = _cut(load_config(config, **overrides), max_episode_steps)
            overrides = {}
        num_envs = checked_count("num_envs", num_envs)
        mode = _autoreset_mode(autoreset_mode)
        self.num_envs = num_envs
        pictures = Pictures(render_mode, width, height, camera_name, num_envs)
        self.single_observation_space, self.single_action_space = self._build(
            config, overrides, num_envs, mode, pictures, dynamics, sensors
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        rate = max(1, round(1 / self.config.decision_dt))
        self.metadata = {**type(self).metadata, "autoreset_mode": mode, "render_fps": rate}
        self.autoreset_mode = mode
        self._observation: Shown | None = None
        self._ended = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every slot, or in those of `options["reset_mask"]`."""
        options = self._check_options(options, ("dock_port", "reset_mask", "variation"))
        ports, anew = self._slot_ports(options), self._anew(options)
        mask = self._reset_mask(options)
        if seed is None and self._state is None:
            seed = drawn_seed(self.np_random)
        seeds = slot_seeds(seed, self.num_envs)
        if seed is not None and np.ndim(seed) == 0:
            self._np_random, self._np_random_seed = gymnasium.utils.seeding.np_random(seeds[0])
        if self._state is None:
            keys = self._program.keys([drawn_seed(self.np_random) if s is None else s for s in seeds])
        else:
            seeded = np.array([s is not None for s in seeds])
            keys = self._program.choose_keys(seeded, [s or 0 for s in seeds], self._state)
        if self._state is None or (mask.all() and anew is None):
            if not mask.all():
                raise gymnasium.error.ResetNeeded("the first reset() must start every slot: no reset_mask yet")
            self._state, parts, info = self._program.reset(keys, ports)
            self._observation = shown(parts)
        else:
            self._state, parts, info = self._program.reset_where(self._state, mask, keys, ports, anew)
            self._observation = each(partial(_where, mask), shown(parts), self._observation)
        self._ended = self._ended & ~mask
        self._pictures.begin(info["true_state"], np.flatnonzero(mask))
        return each(np.copy, self._observation), _vector_info(info, mask)

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold one action (num_envs, 6) per slot for one decision."""
        actions = self._actions(actions, (self.num_envs, 6))
        if not np.isfinite(actions).all():
            broken = np.flatnonzero(~np.isfinite(actions).all(axis=1))
            gymnasium.logger.warn(f"the actions of slots {broken.tolist()} are not finite: their episodes end")
        was_ended = self._ended if self.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP else None
        self._state, output = self._program.step(self._state, actions)
        result = output.result
        ended = result.terminated | result.truncated
        info = _vector_info(output.info, np.ones(self.num_envs, bool))
        restarted = np.zeros(self.num_envs, bool) if was_ended is None else was_ended
        if self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP:
            restarted = ended
            if ended.any():
                info["final_obs"], info["_final_obs"] = shown(output.final_observation), ended
                info["final_info"], info["_final_info"] = _vector_info(output.final_info, ended), ended
        self._ended = ended
        self._pictures.extend(output.info["true_state"], actions, self._limit, ~restarted)
        self._pictures.begin(output.info["true_state"], np.flatnonzero(restarted))
        self._observation = shown(result.observation)
        terminated, truncated = result.terminated.copy(), result.truncated.copy()
        return each(np.copy, self._observation), result.reward.astype(np.float64), terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture per slot, or None without a render mode."""
        return None if self.render_mode is None else tuple(self._drawn(range(self.num_envs)))

    def _reset_mask(self, options) -> np.ndarray:
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, bool)
        mask = np.asarray(mask)
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask must be a boolean array of shape ({self.num_envs},) with at least one True, "
                f"got {mask.dtype} {mask.shape}"
            )
        return mask


def _cut(config: DockingConfig, decisions: int) -> DockingConfig:
    """A configuration whose episodes last so many decisions at most."""
    horizon = min(config.horizon, checked_count("max_episode_steps", decisions) * config.decision_dt)
    return config.model_copy(update={"horizon": horizon})


def _autoreset_mode(mode) -> AutoresetMode:
    known = {m.value: m for m in AutoresetMode} | {m.name.lower(): m for m in AutoresetMode}
    if isinstance(mode, AutoresetMode):
        return mode
    if mode not in known:
        raise ValueError(unknown("autoreset_mode", mode, known))
    return known[mode]


def _where(mask: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    return np.where(mask.reshape(-1, *[1] * (new.ndim - 1)), new, old)


def _first(parts: Seen) -> Shown:
    return each(lambda batch: batch[0].copy(), shown(parts))


def scalar_info(info: dict[str, np.ndarray], slot: int) -> dict[str, np.ndarray | np.generic]:
    """The info of one slot: NumPy scalars and arrays; truths as arrays (), since converters refuse `numpy.bool_`."""
    return {name: v[slot, ...] if v.ndim > 1 or v.dtype == bool else v[slot] for name, v in info.items()}


def _vector_info(info: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    return {**info, **{f"_{name}": mask.copy() for name in info}}
