"""Stable-Baselines3's `VecEnv` over the native batch: one compiled program and one host transfer a step."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode

from owm_envs.adapters.gymnasium import DockingVectorEnv, scalar_info
from owm_envs.adapters.parts import Shown, each
from owm_envs.config import DockingConfig
from owm_envs.registration import IDS
from owm_envs.task.events import Outcome
from owm_envs.words import checked_seed, install, unknown

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(f"owm_envs.sb3 needs Stable-Baselines3 ({error}): {install('sb3')}") from error

_INFOS = ("ended", "all")
_SHARED = ("config", "docking_env", "layout", "metadata", "render_mode", "spec", "traces")


def make_vec_env(
    id_or_config: str | os.PathLike | Mapping[str, Any] | DockingConfig = "iss-numerical",
    n_envs: int = 1,
    seed: int | None = None,
    *,
    preset: str | None = None,
    normalize: bool = True,
    infos: Literal["ended", "all"] = "ended",
    render_mode: str | None = None,
    **overrides: Any,
) -> "DockingVecEnv":
    """A batch of docking episodes as a Stable-Baselines3 `VecEnv`, ready for its algorithms and wrappers.

    Args:
        id_or_config: an environment id or short name ("ISSHCW-v0", "iss-hcw"), the path of a TOML file, a mapping of
            `DockingConfig` fields, or a `DockingConfig`, which is taken as it stands but for `normalize`.
        n_envs: slots, advanced together.
        seed: slot i starts from seed + i at the first `reset()`. An algorithm given a seed of its own replaces it.
        preset: where to start from, "rl" when None: the paper's 1 Hz decisions, reward and start shell. A
            `DockingConfig` takes none.
        normalize: actions in [-1, 1] and scaled observations, what `stable_baselines3` expects.
        infos: "ended" fills an info only when its episode ends, "all" every step (slower for large batches).
        render_mode: None or "rgb_array".
        overrides: fields of `DockingConfig`, and the other keywords of `DockingVectorEnv`.

    Raises:
        ValueError: an unknown id, field, preset or port (naming the nearest), or a value out of bounds.
    """
    if isinstance(id_or_config, str):
        name = id_or_config.removeprefix("owm_envs:")
        if name in IDS:
            id_or_config = {"fidelity": IDS[name]}
        elif not id_or_config.endswith(".toml"):
            raise ValueError(unknown("environment id", id_or_config, IDS) + " A file's name must end in .toml.")
    if preset is None:
        preset = "data" if isinstance(id_or_config, DockingConfig) else "rl"
    venv = DockingVecEnv(
        n_envs, id_or_config, infos=infos, render_mode=render_mode, preset=preset, normalize=normalize, **overrides
    )
    if seed is not None:
        venv.seed(checked_seed(seed))
    return venv


class DockingVecEnv(VecEnv):
    """`DockingVectorEnv` behind Stable-Baselines3's interface; build it with `make_vec_env`.

    The info of an ended episode holds `terminal_observation`, the truth at its end (outcome, port, closest approach,
    ...) and `TimeLimit.truncated`, true only if the horizon ended it. `reset_infos` holds the starts. A slot whose
    action is not finite ends as `Outcome.INVALID_ACTION`; wrap in `VecCheckNan` to have it raise.
    `set_options({"dock_port": NAME})`, or one such dict per slot, assigns ports at the next `reset()`; `"variation"`
    may be set for all slots alike.

    Args:
        n_envs, config, render_mode, overrides: as for `DockingVectorEnv`.
        infos: as for `make_vec_env`.
    """

    def __init__(
        self,
        n_envs: int,
        config: Mapping[str, Any] | DockingConfig | str | os.PathLike | None = None,
        *,
        infos: str = "ended",
        render_mode: str | None = None,
        **overrides: Any,
    ):
        if infos not in _INFOS:
            raise ValueError(unknown("infos", infos, _INFOS))
        self.batch = DockingVectorEnv(n_envs, config, render_mode, AutoresetMode.SAME_STEP, **overrides)
        self._all_infos = infos == "all"
        self._slots = [_Slot(self.batch, index) for index in range(n_envs)]
        self._actions: np.ndarray | None = None
        super().__init__(n_envs, self.batch.single_observation_space, self.batch.single_action_space)

    def reset(self) -> Shown:
        """Start an episode in every slot, with the seeds of `seed()` and options of `set_options()` once."""
        if len(self._options) != self.num_envs:
            raise ValueError(f"set_options names {len(self._options)} options for {self.num_envs} environments")
        ports = [_checked(options).get("dock_port") for options in self._options]
        options = {} if all(port is None for port in ports) else {"dock_port": ports}
        varied = [given["variation"] for given in self._options if "variation" in given]
        if varied:
            if len(varied) < self.num_envs or any(list(names) != list(varied[0]) for names in varied):
                raise ValueError("variation must be the same for every slot: set_options({'variation': NAMES})")
            options["variation"] = varied[0]
        observation, info = self.batch.reset(seed=self._seeds, options=options)
        self._actions = None
        self.reset_infos = _rows(info, np.arange(self.num_envs))
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (n_envs, 6) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Shown, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Advance by one decision: observations after any automatic reset, float32 rewards, dones, infos."""
        if self._actions is None:
            raise RuntimeError("call step_async() before step_wait()")
        actions, self._actions = self._actions, None
        observation, reward, terminated, truncated, info = self.batch.step(actions)
        done = terminated | truncated
        infos = _rows(info, np.arange(self.num_envs)) if self._all_infos else [{} for _ in range(self.num_envs)]
        for row in infos:
            row["TimeLimit.truncated"] = False
        ended = np.flatnonzero(done)
        if ended.size:
            ends, starts = _rows(info["final_info"], ended), _rows(info, ended)
            for slot, end, start in zip(ended.tolist(), ends, starts):
                end["TimeLimit.truncated"] = bool(end["outcome"] == Outcome.TIMEOUT)
                end["terminal_observation"] = _row(info["final_obs"], slot)
                infos[slot], self.reset_infos[slot] = end, start
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Release what the batch holds."""
        self.batch.close()

    def get_images(self) -> list[np.ndarray | None]:
        """A picture per slot, or None for each without a render mode."""
        return list(self.batch.render() or [None] * self.num_envs)

    def get_attr(self, attr_name: str, indices: int | Sequence[int] | None = None) -> list[Any]:
        """An attribute of each chosen slot: what the batch shares, or what `set_attr` put there."""
        return [getattr(slot, attr_name) for slot in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Sequence[int] | None = None) -> None:
        """Set an attribute of one's own on the chosen slots; AttributeError for what the compiled batch shares."""
        for slot in self._chosen(indices):
            setattr(slot, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Sequence[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call `reset(seed=, options=)`, `render()` or a callable put there by `set_attr`, on the chosen slots."""
        return [getattr(slot, method_name)(*method_args, **method_kwargs) for slot in self._chosen(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: int | Sequence[int] | None = None) -> list[bool]:
        """False for each chosen slot: there are no Gymnasium wrappers inside; use `VecEnvWrapper`s outside."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices) -> "list[_Slot]":
        return [self._slots[index] for index in self._get_indices(indices)]


class _Slot:
    """One slot as `get_attr`, `set_attr` and `env_method` see it."""

    def __init__(self, batch: DockingVectorEnv, index: int):
        self._batch = batch
        self._index = index
        self.observation_space = batch.single_observation_space
        self.action_space = batch.single_action_space

    def __getattr__(self, name: str) -> Any:
        if name not in _SHARED:
            raise AttributeError(f"a docking slot has no attribute {name!r}; the batch shares {', '.join(_SHARED)}")
        return getattr(self._batch, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _SHARED:
            raise AttributeError(f"{name} is the same for the whole compiled batch: make another environment")
        super().__setattr__(name, value)

    @property
    def unwrapped(self) -> "_Slot":
        return self

    def get_wrapper_attr(self, name: str) -> Any:
        return getattr(self, name)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode in this slot alone: (observation, info)."""
        count = self._batch.num_envs
        seeds, ports = [None] * count, [None] * count
        own = dict(_checked(options or {}))
        seeds[self._index], ports[self._index] = seed, own.pop("dock_port", None)
        mask = np.arange(count) == self._index
        observation, info = self._batch.reset(seed=seeds, options={**own, "dock_port": ports, "reset_mask": mask})
        return _row(observation, self._index), _rows(info, np.array([self._index]))[0]

    def render(self) -> np.ndarray | None:
        """The slot's state as an RGB picture, or None without a render mode."""
        return None if self.render_mode is None else self._batch._drawn([self._index])[0]


def _checked(options: Mapping[str, Any]) -> Mapping[str, Any]:
    for key in options:
        if key not in ("dock_port", "variation"):
            raise ValueError(unknown("reset option", key, ("dock_port", "variation")))
    return options


def _row(observation: Shown, slot: int) -> Shown:
    return each(lambda batch: batch[slot].copy(), observation)


def _rows(info: Mapping[str, Any], slots: np.ndarray) -> list[dict[str, Any]]:
    """The batched info of the chosen slots as a dict each, of numbers and arrays of their own."""
    picked = {n: v[slots] for n, v in info.items() if not n.startswith(("_", "final_"))}
    return [scalar_info(picked, row) for row in range(len(slots))]
