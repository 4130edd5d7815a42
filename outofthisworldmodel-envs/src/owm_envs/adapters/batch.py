"""The compiled programs behind every adapter: a batch of episodes, one program a call.

All calls run in JAX's 64-bit mode, whatever the caller's; the state is opaque between calls.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode

from astrojax.compilation import compiler_options
from owm_envs.adapters.fork import about_to_use_jax
from owm_envs.adapters.packing import Packing
from owm_envs.adapters.seeds import seed_words
from owm_envs.config.params import Params
from owm_envs.cores import core_count, workers
from owm_envs.env import DockingEnv, EnvState, StepResult, restart_where
from owm_envs.flags import own_flags
from owm_envs.task.events import Outcome
from owm_envs.task.selected import apply_where
from owm_envs.task.sensors import chunk_of_costly

_PackedParams = tuple[dict[str, jax.Array], dict[str, Any]]
State = tuple[dict[str, jax.Array], ...]
"""Of each piece of a batch, packed, its keys as words. Each array in or out costs a call a microsecond and more, and a
typed key JAX's slow path."""
Seen = dict[str, np.ndarray]
"""The parts of a batch's observations, by name."""
_LEAST_PIECE = 128
"""Slots; below that a second thread costs more than it brings."""


class StepOutput(NamedTuple):
    """A batched step: the result after any automatic reset, and what it was before, None if no episode ended."""

    result: StepResult
    info: dict[str, Any]
    final_observation: Seen | None
    final_info: dict[str, Any] | None


class BatchProgram:
    """`reset`, `reset_where` and `step` of a batch of episodes of one environment.

    The programs behind it are shared by all batches of equal structure and size. On the CPU a batch
    is flown in equal pieces side by side, one to a core; a state is a tuple of them, opaque outside.
    """

    def __init__(self, env: DockingEnv, autoreset: AutoresetMode, num_envs: int):
        self.env = env
        self.autoreset = autoreset
        self.num_envs = num_envs

    # JAX starts with the first of these that is asked for, not in the constructor: Gymnasium's asynchronous vector
    # environment makes one environment before it forks.

    @cached_property
    def params(self) -> Params:
        """The configuration's numbers as arrays."""
        about_to_use_jax()
        with own_flags():
            return self.env.default_params()

    @cached_property
    def _slices(self) -> list[slice]:
        about_to_use_jax()
        # A frame is enough for a thread to do.
        count, pieces = self.num_envs, piece_count(self.num_envs, 1 if self.env.costly else _LEAST_PIECE)
        return [slice(k * count // pieces, (k + 1) * count // pieces) for k in range(pieces)]

    @cached_property
    def _programs(self) -> "_Programs":
        return _programs(self.env, self.num_envs // len(self._slices))

    @cached_property
    def _packed(self) -> _PackedParams:
        with own_flags():
            return self._programs.pack_params(self.params)

    @property
    def traces(self) -> dict[str, int]:
        """Compilations so far by program, for tests and reports."""
        return self._programs.traces

    def keys(self, seeds: list[int]) -> np.ndarray:
        """One key (B, 2) per slot from its seed, as words."""
        return seed_words(seeds)

    def next_keys(self, state: State) -> np.ndarray:
        """The key (B, 2) from which each slot's next episode starts."""
        return self.to_host(state).next_key

    def choose_keys(self, seeded: np.ndarray, seeds: list[int], state: State) -> np.ndarray:
        """The key of its seed for each slot that is seeded, that of the next episode for the others."""
        return np.where(seeded[:, None], self.keys(seeds), self.next_keys(state))

    def reset(self, keys: np.ndarray, ports: np.ndarray) -> tuple[State, Seen, dict[str, np.ndarray]]:
        """Start an episode in every slot: keys (B, 2), ports (B,) with -1 for a drawn one."""
        ports = np.asarray(ports, np.int32)
        state, host = self._side_by_side(lambda k, part: self._programs.reset(self._packed, keys[part], ports[part]))
        return state, *self._programs.of_seen.unpack(host)

    def reset_where(
        self,
        state: State,
        mask: np.ndarray,
        keys: np.ndarray,
        ports: np.ndarray,
        anew: Mapping[str, bool] | None = None,
    ) -> tuple[State, Seen, dict[str, np.ndarray]]:
        """Start an episode in the slots of `mask` (B,); the observation is meaningful there only.

        Args:
            anew: of each of `VARIATIONS` whether it is drawn anew, or kept from the slot's last episode; all when None.
        """
        ports = np.asarray(ports, np.int32)
        program = self._programs.reset_where
        state, host = self._side_by_side(
            lambda k, part: program(self._packed, state[k], mask[part], keys[part], ports[part], anew)
        )
        return state, *self._programs.of_seen.unpack(host)

    def step(self, state: State, actions: np.ndarray) -> tuple[State, StepOutput]:
        """Advance every slot by one decision: actions (B, 6)."""
        state, seen, earned = self._side_by_side(
            lambda k, part: self._programs.step(self._packed, state[k], actions[part])
        )
        reward, terminated, truncated, had_ended = self._programs.of_earned.unpack(earned)
        final = (None, None)
        if self.autoreset == AutoresetMode.SAME_STEP and (due := terminated | truncated).any():
            final = self._programs.of_seen.unpack({name: matrix.copy() for name, matrix in seen.items()})
            state = self._restart(state, due, seen)
        elif self.autoreset == AutoresetMode.NEXT_STEP and had_ended.any():
            state = self._restart(state, had_ended, seen)
            reward[had_ended], terminated[had_ended], truncated[had_ended] = 0, False, False
        observation, info = self._programs.of_seen.unpack(seen)
        return state, StepOutput(StepResult(observation, reward, terminated, truncated), info, *final)

    def _restart(self, state: State, due: np.ndarray, seen: dict[str, np.ndarray]) -> State:
        """Start the next episode in the slots of `due` (B,), and write what is seen of it over what was."""

        def start(k, part):
            return self._programs.restart(self._packed, state[k], due[part]) if due[part].any() else (state[k], None)

        state, fresh = self._side_by_side(start, join=False)
        for part, matrices in zip(self._slices, fresh):
            for name in matrices or ():
                seen[name][part][due[part]] = matrices[name][due[part]]
        return state

    def to_host(self, state: State) -> EnvState:
        """A state of the whole batch as NumPy arrays, which pickle without loss."""
        return self._programs.of_state.unpack(joined(jax.device_get(state)))

    def from_host(self, state: EnvState) -> State:
        """The inverse of `to_host`."""
        with own_flags():
            packed = self._programs.of_state.pack(state)
            return tuple({name: matrix[part] for name, matrix in packed.items()} for part in self._slices)

    def _side_by_side(self, call: Callable[[int, slice], tuple], join: bool = True) -> list[Any]:
        """What `call` gives for each piece: the states, then what comes to NumPy, of the whole batch if joined."""

        def one(k):
            with own_flags():  # of this thread
                kept, *host = call(k, self._slices[k])
                return kept, *jax.tree.map(np.asarray, host)  # views; `jax.device_get` takes three times as long

        slices, _ = self._slices, self._packed  # before other threads ask for them
        others = [workers().submit(one, k) for k in range(1, len(slices))]
        state, *host = zip(one(0), *(other.result() for other in others))
        return [state, *(joined(pieces) if join else pieces for pieces in host)]


class _Programs:
    """What is compiled once: functions of the packed params and state of a batch.

    Restarting is a program of its own, called when an episode has ended: in the step it would cost every step.
    """

    def __init__(self, env: DockingEnv):
        self.env = env
        self.traces = {"reset": 0, "reset_where": 0, "step": 0, "restart": 0}
        # A library's sum or product goes on in another thread: of little use to a single step, and two pieces have
        # two cores to share.
        options = compiler_options(libraries=False)
        self.reset = jax.jit(self._reset_batch, compiler_options=options)
        self.reset_where = jax.jit(self._reset_masked, compiler_options=options)
        self.step = jax.jit(self._step_batch, compiler_options=options)
        self.restart = jax.jit(self._restart_batch, compiler_options=options)
        self.of_params, self.of_state, self.of_seen, self.of_earned = (Packing() for _ in range(4))

    def pack_params(self, params: Params) -> _PackedParams:
        """All numbers as one row for each dtype, but for those of sensors; equal structures have equal shapes."""
        numbers = jax.tree.map(lambda leaf: leaf[None], params._replace(sensors={}))
        return self.of_params.pack(numbers), params.sensors

    def _unpack_params(self, packed):
        numbers, sensors = packed
        return jax.tree.map(lambda leaf: leaf[0], self.of_params.unpack(numbers))._replace(sensors=sensors)

    def _pack_state(self, state):
        return self.of_state.pack(key_words(state))

    def unpack_state(self, packed: dict[str, jax.Array]) -> EnvState:
        """The state of a piece, its keys typed."""
        return typed_keys(self.of_state.unpack(packed))

    def _seen(self, params, state, observation):
        observation = {name: observation[name] for name in self.env.shown_parts}
        return self.of_seen.pack((observation, jax.vmap(self.env.info, (None, 0))(params, state)))

    def _start(self, params, words, ports):
        return jax.vmap(lambda key, port: self.env.reset(params, key=key, port=port))(_typed(words), ports)

    def _reset_batch(self, params, keys, ports):
        self.traces["reset"] += 1
        params = self._unpack_params(params)
        state, observation = self._start(params, keys, ports)
        return self._pack_state(state), self._seen(params, state, observation)

    def _reset_masked(self, params, state, mask, keys, ports, anew):
        self.traces["reset_where"] += 1
        params, before = self._unpack_params(params), self.unpack_state(state)

        def start(words, port, before):
            kept = {} if anew is None else {"before": before, "anew": anew}
            return self.env.reset(params, key=_typed(words), port=port, **kept)

        if self.env.costly:
            old = before, self._nothing(mask.shape[0])
            state, observation = apply_where(mask, start, old, keys, ports, before, chunk=chunk_of_costly() or 1)
        else:
            fresh, observation = jax.vmap(start)(keys, ports, before)
            state = select(mask, fresh, before)
        return self._pack_state(state), self._seen(params, state, observation)

    def _nothing(self, count):
        """The parts of observations that nobody reads."""
        return {n: jnp.zeros((count, *part.shape), part.dtype) for n, part in self.env.observation_parts.items()}

    def _step_batch(self, params, state, actions):
        self.traces["step"] += 1
        params = self._unpack_params(params)
        state = self.unpack_state(state)
        had_ended = state.outcome != Outcome.RUNNING
        state, result = jax.vmap(self.env.step, (None, 0, 0))(params, state, actions)
        earned = self.of_earned.pack((result.reward, result.terminated, result.truncated, had_ended))
        return self._pack_state(state), self._seen(params, state, result.observation), earned

    def _restart_batch(self, params, state, due):
        self.traces["restart"] += 1
        params = self._unpack_params(params)
        observation = self._nothing(due.shape[0])
        state, observation = restart_where(self.env, params, due, self.unpack_state(state), observation)
        return self._pack_state(state), self._seen(params, state, observation)


@lru_cache(maxsize=32)
def _programs(env: DockingEnv, num_envs: int) -> _Programs:
    """The programs of an environment's structure; its numbers play no part."""
    return _Programs(env)


def piece_count(num_envs: int, least: int = _LEAST_PIECE) -> int:
    """Into how many equal pieces a batch is cut: as many as there are cores, if each keeps enough to do."""
    if jax.default_backend() != "cpu":
        return 1
    fits = [n for n in range(1, core_count() + 1) if num_envs % n == 0 and num_envs // n >= least]
    return max(fits, default=1)


def joined(pieces: Sequence[Any]) -> Any:
    """Pieces of a batch as one, leaf by leaf; always arrays of their own, which a caller may change."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *pieces)


def select(mask: jax.Array, new: Any, old: Any) -> Any:
    """Leaf by leaf, `new` in the slots of `mask` (B,) and `old` elsewhere."""
    return jax.tree.map(lambda n, o: jnp.where(jnp.reshape(mask, mask.shape + (1,) * (n.ndim - 1)), n, o), new, old)


def key_words(state: EnvState) -> EnvState:
    """A state with its keys as plain words."""
    return state._replace(noise_key=jax.random.key_data(state.noise_key), next_key=jax.random.key_data(state.next_key))


def typed_keys(state: EnvState) -> EnvState:
    """The inverse of `key_words`."""
    return state._replace(noise_key=_typed(state.noise_key), next_key=_typed(state.next_key))


def _typed(words) -> jax.Array:
    return jax.random.wrap_key_data(words, impl="threefry2x32")


def state_to_host(state: EnvState) -> Any:
    """A state as NumPy arrays that pickle without loss."""
    with own_flags():
        return jax.device_get(key_words(state))


def state_from_host(state: Any) -> EnvState:
    """The inverse of `state_to_host`."""
    with own_flags():
        return typed_keys(jax.tree.map(jnp.asarray, state))
