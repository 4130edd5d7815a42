"""The compiled programs behind every adapter: a batch of episodes, one program a call.

All calls run in JAX's 64-bit mode, whatever the caller's; the state is opaque between calls.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode

from owm_envs.config import DockingConfig
from owm_envs.dynamics import Dynamics
from owm_envs.env import DockingEnv, EnvState, StepResult
from owm_envs.params import Params
from owm_envs.task.events import Outcome


class StepOutput(NamedTuple):
    """A batched step: the result after any automatic reset, and what it was before."""

    result: StepResult
    info: dict[str, jax.Array]
    final_observation: jax.Array
    final_info: dict[str, jax.Array]


class BatchProgram:
    """`reset`, `reset_where` and `step` of a batch of episodes of one configuration.

    The programs behind it are shared by all batches of equal structure, automatic reset and size.
    """

    def __init__(
        self, config: DockingConfig, autoreset: AutoresetMode, num_envs: int, dynamics: Dynamics | None = None
    ):
        self.env = DockingEnv(config, dynamics=dynamics)
        self.autoreset = autoreset
        with jax.enable_x64(True):
            self.params: Params = self.env.default_params()
        self._programs = _programs(self.env, autoreset, num_envs)

    @property
    def traces(self) -> dict[str, int]:
        """Compilations so far by program, for tests and reports."""
        return self._programs.traces

    def keys(self, seeds: list[int]) -> jax.Array:
        """One key per slot from its seed; a seed may have up to 64 bits."""
        return seed_keys(seeds)

    def choose_keys(self, seeded: np.ndarray, seeds: list[int], following: jax.Array) -> jax.Array:
        """The key of its seed for each slot that is seeded, `following` for the others."""
        with jax.enable_x64(True):
            return jnp.where(seeded, self.keys(seeds), following)

    def reset(self, keys, ports) -> tuple[EnvState, np.ndarray, dict[str, np.ndarray]]:
        """Start an episode in every slot: keys (B,), ports (B,) with -1 for a drawn one."""
        with jax.enable_x64(True):
            state, *host = self._programs.reset(self.params, keys, np.asarray(ports, np.int32))
            return state, *jax.device_get(tuple(host))

    def reset_where(self, state, mask, keys, ports) -> tuple[EnvState, np.ndarray, dict[str, np.ndarray]]:
        """Start an episode in the slots of `mask` (B,); the observation is meaningful there only."""
        with jax.enable_x64(True):
            state, *host = self._programs.reset_where(self.params, state, mask, keys, np.asarray(ports, np.int32))
            return state, *jax.device_get(tuple(host))

    def step(self, state, actions) -> tuple[EnvState, StepOutput]:
        """Advance every slot by one decision: actions (B, 6)."""
        with jax.enable_x64(True):
            state, output = self._programs.step(self.params, state, actions)
            return state, jax.device_get(output)


class _Programs:
    """What is compiled once: functions of `params` and the state of a batch."""

    def __init__(self, env: DockingEnv, autoreset: AutoresetMode):
        self.env = env
        self.autoreset = autoreset
        self.traces = {"reset": 0, "reset_where": 0, "step": 0}
        self.reset = jax.jit(self._reset_batch)
        self.reset_where = jax.jit(self._reset_masked)
        self.step = jax.jit(self._step_batch)

    def _info(self, params, state):
        return jax.vmap(self.env.info, (None, 0))(params, state)

    def _reset_batch(self, params, keys, ports):
        self.traces["reset"] += 1
        state, observation = jax.vmap(lambda key, port: self.env.reset(params, key=key, port=port))(keys, ports)
        return state, observation, self._info(params, state)

    def _reset_masked(self, params, state, mask, keys, ports):
        self.traces["reset_where"] += 1
        fresh, observation = jax.vmap(lambda key, port: self.env.reset(params, key=key, port=port))(keys, ports)
        state = select(mask, fresh, state)
        return state, observation, self._info(params, state)

    def _step_batch(self, params, state, actions):
        self.traces["step"] += 1
        had_ended = state.outcome != Outcome.RUNNING
        state, result = jax.vmap(self.env.step, (None, 0, 0))(params, state, actions)
        final_observation, final_info = result.observation, self._info(params, state)
        if self.autoreset == AutoresetMode.DISABLED:
            return state, StepOutput(result, final_info, final_observation, final_info)

        same_step = self.autoreset == AutoresetMode.SAME_STEP
        due = (result.terminated | result.truncated) if same_step else had_ended

        def restart(state, observation):
            fresh, first = jax.vmap(lambda key: self.env.reset(params, key=key))(state.next_key)
            return select(due, fresh, state), jnp.where(due[:, None], first, observation)

        state, observation = jax.lax.cond(
            jnp.any(due), restart, lambda state, observation: (state, observation), state, result.observation
        )
        result = result._replace(observation=observation)
        if not same_step:
            result = result._replace(
                reward=jnp.where(due, 0, result.reward),
                terminated=result.terminated & ~due,
                truncated=result.truncated & ~due,
            )
        return state, StepOutput(result, self._info(params, state), final_observation, final_info)


@lru_cache(maxsize=32)
def _programs(env: DockingEnv, autoreset: AutoresetMode, num_envs: int) -> _Programs:
    """The programs of an environment's structure; its numbers play no part."""
    return _Programs(env, autoreset)


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
