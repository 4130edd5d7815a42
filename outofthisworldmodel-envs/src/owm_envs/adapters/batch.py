"""The compiled programs behind every adapter: a batch of episodes, one program a call.

All calls run in JAX's 64-bit mode, whatever the caller's; the state is opaque between calls.
"""

import operator
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode

from astrojax.compilation import compiler_options
from owm_envs.adapters.packing import Packing
from owm_envs.config import DockingConfig
from owm_envs.dynamics import Dynamics
from owm_envs.env import DockingEnv, EnvState, StepResult
from owm_envs.params import Params
from owm_envs.task.events import Outcome
from owm_envs.task.selected import apply_where

State = tuple[EnvState, ...]
_LEAST_PIECE = 128
"""Slots; below that a second thread costs more than it brings."""


class StepOutput(NamedTuple):
    """A batched step: the result after any automatic reset, and what it was before, None if no episode ended."""

    result: StepResult
    info: dict[str, Any]
    final_observation: Any
    final_info: dict[str, Any] | None


class BatchProgram:
    """`reset`, `reset_where` and `step` of a batch of episodes of one configuration.

    The programs behind it are shared by all batches of equal structure, automatic reset and size. On the CPU a batch
    is flown in equal pieces side by side, one to a core; a state is a tuple of them, opaque outside.
    """

    def __init__(
        self, config: DockingConfig, autoreset: AutoresetMode, num_envs: int, dynamics: Dynamics | None = None
    ):
        self.env = DockingEnv(config, dynamics=dynamics)
        self.autoreset = autoreset
        with jax.enable_x64(True):
            self.params: Params = self.env.default_params()
        pieces = piece_count(num_envs)
        self._slices = [slice(k * num_envs // pieces, (k + 1) * num_envs // pieces) for k in range(pieces)]
        self._programs = _programs(self.env, autoreset, num_envs // pieces)

    @property
    def traces(self) -> dict[str, int]:
        """Compilations so far by program, for tests and reports."""
        return self._programs.traces

    def keys(self, seeds: list[int]) -> jax.Array:
        """One key per slot from its seed; a seed may have up to 64 bits."""
        return seed_keys(seeds)

    def next_keys(self, state: State) -> jax.Array:
        """The key (B,) from which each slot's next episode starts."""
        with jax.enable_x64(True):
            return jnp.concatenate([piece.next_key for piece in state])

    def choose_keys(self, seeded: np.ndarray, seeds: list[int], state: State) -> jax.Array:
        """The key of its seed for each slot that is seeded, that of the next episode for the others."""
        with jax.enable_x64(True):
            return jnp.where(seeded, self.keys(seeds), self.next_keys(state))

    def reset(self, keys, ports) -> tuple[State, np.ndarray, dict[str, np.ndarray]]:
        """Start an episode in every slot: keys (B,), ports (B,) with -1 for a drawn one."""
        ports = np.asarray(ports, np.int32)
        state, host = self._side_by_side(lambda k, part: self._programs.reset(self.params, keys[part], ports[part]))
        return state, *self._programs.of_reset.unpack(host)

    def reset_where(self, state: State, mask, keys, ports) -> tuple[State, np.ndarray, dict[str, np.ndarray]]:
        """Start an episode in the slots of `mask` (B,); the observation is meaningful there only."""
        ports = np.asarray(ports, np.int32)
        state, host = self._side_by_side(
            lambda k, part: self._programs.reset_where(self.params, state[k], mask[part], keys[part], ports[part])
        )
        return state, *self._programs.of_reset_where.unpack(host)

    def step(self, state: State, actions: np.ndarray) -> tuple[State, StepOutput]:
        """Advance every slot by one decision: actions (B, 6)."""
        state, host, *final = self._side_by_side(
            lambda k, part: self._programs.step(self.params, state[k], actions[part])
        )
        result, info = self._programs.of_step.unpack(host)
        if final and (result.terminated | result.truncated).any():
            return state, StepOutput(result, info, *self._programs.of_end.unpack(final[0]))
        return state, StepOutput(result, info, None, None)

    def to_host(self, state: State) -> EnvState:
        """A state of the whole batch as NumPy arrays, which pickle without loss."""
        return joined([state_to_host(piece) for piece in state])

    def from_host(self, state: EnvState) -> State:
        """The inverse of `to_host`."""
        cut = [jax.tree.map(operator.itemgetter(part), state) for part in self._slices]
        return tuple(state_from_host(piece) for piece in cut)

    def _side_by_side(self, call: Callable[[int, slice], tuple]) -> list[Any]:
        """What `call` gives for each piece: first the states, then what comes to NumPy, of the whole batch."""

        def one(k):
            with jax.enable_x64(True):  # of this thread
                kept, *host = call(k, self._slices[k])
                return kept, *jax.device_get(host)

        others = [_workers().submit(one, k) for k in range(1, len(self._slices))]
        state, *host = zip(one(0), *(other.result() for other in others))
        return [state, *(joined(pieces) for pieces in host)]


class _Programs:
    """What is compiled once: functions of `params` and the state of a batch."""

    def __init__(self, env: DockingEnv, autoreset: AutoresetMode):
        self.env = env
        self.autoreset = autoreset
        self.traces = {"reset": 0, "reset_where": 0, "step": 0}
        options = compiler_options()
        self.reset = jax.jit(self._reset_batch, compiler_options=options)
        self.reset_where = jax.jit(self._reset_masked, compiler_options=options)
        self.step = jax.jit(self._step_batch, compiler_options=options)

        self.of_reset, self.of_reset_where, self.of_step, self.of_end = (Packing() for _ in range(4))

    def _info(self, params, state):
        return jax.vmap(self.env.info, (None, 0))(params, state)

    def _reset_batch(self, params, keys, ports):
        self.traces["reset"] += 1
        state, observation = jax.vmap(lambda key, port: self.env.reset(params, key=key, port=port))(keys, ports)
        return state, self.of_reset.pack((observation, self._info(params, state)))

    def _reset_masked(self, params, state, mask, keys, ports):
        self.traces["reset_where"] += 1
        fresh, observation = jax.vmap(lambda key, port: self.env.reset(params, key=key, port=port))(keys, ports)
        state = select(mask, fresh, state)
        return state, self.of_reset_where.pack((observation, self._info(params, state)))

    def _step_batch(self, params, state, actions):
        self.traces["step"] += 1
        had_ended = state.outcome != Outcome.RUNNING
        state, result = jax.vmap(self.env.step, (None, 0, 0))(params, state, actions)
        info = self._info(params, state)
        if self.autoreset == AutoresetMode.DISABLED:
            return state, self.of_step.pack((result, info))

        def start(key):
            state, observation = self.env.reset(params, key=key)
            return state, observation, self.env.info(params, state)

        same_step = self.autoreset == AutoresetMode.SAME_STEP
        due = (result.terminated | result.truncated) if same_step else had_ended
        final = (self.of_end.pack((result.observation, info)),) if same_step else ()
        state, observation, info = apply_where(due, start, (state, result.observation, info), state.next_key)
        result = result._replace(observation=observation)
        if not same_step:
            result = result._replace(
                reward=jnp.where(due, 0, result.reward),
                terminated=result.terminated & ~due,
                truncated=result.truncated & ~due,
            )
        return state, self.of_step.pack((result, info)), *final


@lru_cache(maxsize=32)
def _programs(env: DockingEnv, autoreset: AutoresetMode, num_envs: int) -> _Programs:
    """The programs of an environment's structure; its numbers play no part."""
    return _Programs(env, autoreset)


def piece_count(num_envs: int) -> int:
    """Into how many equal pieces a batch is cut: as many as there are cores, if each keeps enough to do."""
    if jax.default_backend() != "cpu":
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    fits = [n for n in range(1, cores + 1) if num_envs % n == 0 and num_envs // n >= _LEAST_PIECE]
    return max(fits, default=1)


@lru_cache(maxsize=1)
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="owm_envs")


def joined(pieces: Sequence[Any]) -> Any:
    """Pieces of a batch as one, leaf by leaf; always arrays of their own, which a caller may change."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *pieces)


def seed_keys(seeds: list[int]) -> jax.Array:
    """One key per seed, of up to 64 bits."""
    with jax.enable_x64(True):
        words = np.asarray([[seed >> 32 & 0xFFFFFFFF, seed & 0xFFFFFFFF] for seed in seeds], np.uint32)
        return jax.random.wrap_key_data(words, impl="threefry2x32")


def select(mask, new, old):
    """Leaf by leaf, `new` in the slots of `mask` (B,) and `old` elsewhere."""
    return jax.tree.map(lambda n, o: jnp.where(jnp.reshape(mask, mask.shape + (1,) * (n.ndim - 1)), n, o), new, old)


def state_to_host(state: EnvState) -> Any:
    """A state as NumPy arrays that pickle without loss."""
    with jax.enable_x64(True):
        state = state._replace(
            noise_key=jax.random.key_data(state.noise_key), next_key=jax.random.key_data(state.next_key)
        )
        return jax.device_get(state)


def state_from_host(state: Any) -> EnvState:
    """The inverse of `state_to_host`."""
    with jax.enable_x64(True):
        state = jax.tree.map(jnp.asarray, state)
        return state._replace(
            noise_key=jax.random.wrap_key_data(state.noise_key, impl="threefry2x32"),
            next_key=jax.random.wrap_key_data(state.next_key, impl="threefry2x32"),
        )
