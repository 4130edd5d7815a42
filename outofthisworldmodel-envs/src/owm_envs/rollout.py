"""Fly episodes in batches, as one compiled program, and record them chunk by chunk."""

import os
import pickle
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key, Shaped

from owm_envs.config.params import Params
from owm_envs.env import DockingEnv
from owm_envs.episode import POLICY_NAMES, Episode
from owm_envs.flags import own_flags
from owm_envs.policies import ScriptedPolicy
from owm_envs.task.events import Outcome
from owm_envs.task.reset import named_key
from owm_envs.task.sensors import STATE


class Frame(NamedTuple):
    """What is recorded of one instant of one episode."""

    observation: dict[str, Shaped[Array, "..."]]
    """Parts by name; the state part is the measured relative view (13,) alone, in SI units."""
    true_state: Float[Array, "13"]
    epoch: Float[Array, "2"]


class Decision(NamedTuple):
    """What is recorded of one decision of one episode."""

    action: Float[Array, "6"]
    reward: Float[Array, ""]
    outcome: Int[Array, ""]


class Chunk(NamedTuple):
    """What a batch of B episodes flew in T decisions, as NumPy arrays with time first.

    A slot that has ended is flown on, to no effect: its frames and decisions after `stop` belong to no episode.
    """

    frames: Frame
    """(T, B, ...) the frame after each decision; the first chunk has one more at its beginning, the start."""
    decisions: Decision
    """(T, B, ...)"""
    ended: Int[np.ndarray, "E"]
    """Slots whose episodes ended in this chunk, ascending."""
    stop: Int[np.ndarray, "E"]
    """Decisions of this chunk that belong to each of them, 1 to T."""
    info: dict[str, np.ndarray]
    """(E, ...) the environment's final info of each of them."""
    policy: Int[np.ndarray, "B"]
    """Index into `POLICY_NAMES` of each slot's policy, -1 for one of another name."""


def rollout(
    env: DockingEnv,
    policies: ScriptedPolicy | Sequence[ScriptedPolicy],
    keys: Key[Array, "B"],
    ports: Int[np.ndarray, "B"],
    *,
    which: Int[np.ndarray, "B"] | None = None,
    params: Params | None = None,
    chunk: int = 360,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Chunk]:
    """Fly B episodes to their ends and yield every frame at the decision rate, a chunk at a time.

    The batch advances in chunks of `chunk` decisions, all running the same compiled program, until the last episode
    has ended. An episode depends on its key, port and policy alone, not on its neighbours in the batch. No chunk is
    kept: memory does not grow with the length of the episodes. `episodes` makes whole episodes of the chunks.

    Args:
        policies: one policy, or several of which each slot flies one.
        keys: (B,) one for each episode: start, sensor noise and the policy's draws.
        ports: (B,) indices of the assigned ports.
        which: (B,) index into `policies` for each slot; the first for all when None.
        params: the environment's numbers; its own defaults when None.
        progress: called after each chunk with decisions flown and the number of episodes still running.

    Returns:
        An iterator that flies as it is read.

    Raises:
        ValueError: shapes disagree or an index is out of range; at the call, before anything is read.
    """
    policies = tuple(policies) if isinstance(policies, Sequence) else (policies,)
    ports = np.asarray(ports, np.int32)
    which = np.zeros(ports.shape, np.int32) if which is None else np.asarray(which, np.int32)
    if not (keys.shape == ports.shape == which.shape and ports.ndim == 1):
        raise ValueError(f"keys {keys.shape}, ports {ports.shape} and which {which.shape} must all have shape (B,)")
    if which.size and not (0 <= which.min() and which.max() < len(policies)):
        raise ValueError(f"which must be indices into the {len(policies)} policies, got {which.tolist()}")
    with own_flags():
        params = env.default_params() if params is None else params
    if ports.size and not (0 <= ports.min() and ports.max() < params.goals.shape[0]):
        raise ValueError(f"ports must be from 0 to {params.goals.shape[0] - 1}, got {ports.tolist()}")
    return _chunks(env, params, policies, keys, ports, which, chunk, progress)


def _chunks(env, params, policies, keys, ports, which, length, progress) -> Iterator[Chunk]:
    names = np.array([POLICY_NAMES.index(p.name) if p.name in POLICY_NAMES else -1 for p in policies])
    running, flown = np.ones(ports.size, bool), 0
    carry = first = None
    while running.any():
        # As the adapters do, whatever the environment's precision: draws differ in 64-bit mode. Left before each
        # yield: the reader's code runs under its own flags.
        with own_flags():
            if carry is None:
                carry, first = _start(env, params, policies, keys, ports)
                first = jax.tree.map(lambda x: np.asarray(x)[None], first)
            carry, recorded = _fly(env, length, params, policies, which, carry)
            frames, decisions = jax.tree.map(np.asarray, recorded)
            over = decisions.outcome != Outcome.RUNNING
            ended = np.flatnonzero(running & over[-1])
            final = _info(env, params, carry[0]) if ended.size else {}
            info = {name: np.asarray(value)[ended] for name, value in final.items()}
        if first is not None:
            frames, first = jax.tree.map(lambda *x: np.concatenate(x), first, frames), None
        running &= ~over[-1]
        flown += length
        if progress is not None:
            progress(flown, int(running.sum()))
        stop = np.argmax(over[:, ended], axis=0) + 1
        made = Chunk(frames, decisions, ended, stop, info, names[which])
        del recorded, frames, decisions, over
        yield made
        # The next chunk must not be flown beside this one.
        del made


class Sink(Protocol):
    """Takes a part of the observation of one episode, some frames at a time."""

    def write(self, frames: Shaped[np.ndarray, "T ..."], /) -> None:
        """Take the next frames."""

    def close(self) -> Any:
        """Give what is to stand in the `Episode` in their place."""


def episodes(
    chunks: Iterable[Chunk],
    *,
    spill: str | os.PathLike | None = None,
    sinks: Mapping[str, Callable[[int], Sink]] = MappingProxyType({}),
) -> Iterator[Episode]:
    """Whole episodes in the order of the slots, each as soon as it and all before it have ended.

    Of a chunk only the running episodes' own frames are kept, in the types that an `Episode` has.

    Args:
        spill: folder for what is kept until its episode is handed out, so that memory holds one chunk and one episode,
            however many and long they are; in memory when None. It is emptied at the end.
        sinks: by a part of the observation that is not to be kept: what makes a slot's sink for it.
    """
    with tempfile.TemporaryDirectory(dir=spill) if spill else nullcontext() as folder:
        running: dict[int, list[Any]] | None = None
        pouring: dict[int, dict[str, Sink]] = {}
        whole: dict[int, tuple] = {}
        ahead = 0
        for number, chunk in enumerate(chunks):
            if running is None:
                running = {slot: [] for slot in range(len(chunk.policy))}
                pouring = {slot: {part: make(slot) for part, make in sinks.items()} for slot in running}
            length = len(chunk.decisions.outcome)
            stops = dict(zip(chunk.ended.tolist(), chunk.stop.tolist()))
            for slot, kept in running.items():
                piece = _piece(chunk, slot, stops.get(slot, length), pouring[slot])
                kept.append(piece if folder is None else _put_aside(Path(folder, f"{slot}-{number}"), piece))
            for row, (slot, stop) in enumerate(stops.items()):
                final = {name: value[row] for name, value in chunk.info.items()}
                outcome = int(chunk.decisions.outcome[stop - 1, slot])
                poured = {part: sink.close() for part, sink in pouring.pop(slot).items()}
                whole[slot] = running.pop(slot), poured, outcome, final, int(chunk.policy[slot])
            del chunk
            while ahead in whole:
                pieces, *about = whole.pop(ahead)
                yield _episode([piece if folder is None else _take_back(piece) for piece in pieces], *about)
                ahead += 1


def _put_aside(path: Path, piece: dict[str, Any]) -> Path:
    with open(path, "wb") as file:
        pickle.dump(piece, file, protocol=5)
    return path


def _take_back(path: Path) -> dict[str, Any]:
    with open(path, "rb") as file:
        piece = pickle.load(file)
    path.unlink()
    return piece


def _piece(chunk: Chunk, slot: int, stop: int, sinks: Mapping[str, Sink]) -> dict[str, Any]:
    """Copies of one slot's first `stop` decisions of a chunk and of their frames, but for what goes into a sink."""
    extra = len(chunk.frames.epoch) - len(chunk.decisions.outcome)
    for part, sink in sinks.items():
        sink.write(chunk.frames.observation[part][: stop + extra, slot])
    kept = {part: values for part, values in chunk.frames.observation.items() if part not in sinks}
    frames = chunk.frames._replace(observation=kept)
    frames = jax.tree.map(lambda values: values[: stop + extra, slot].copy(), frames)
    return {
        "observation": frames.observation,
        "true_state": frames.true_state.astype(np.float64),
        "epoch": frames.epoch.astype(np.float64),
        "action": chunk.decisions.action[:stop, slot].astype(np.float32),
        "reward": chunk.decisions.reward[:stop, slot].astype(np.float32),
    }


def _episode(pieces: list[dict[str, Any]], poured: dict, outcome: int, final: dict, policy: int) -> Episode:
    joined = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
    joined["observation"] |= poured
    length = len(joined["reward"])
    last = np.arange(length) == length - 1
    return Episode(
        **joined,
        done=last,
        success=last & (outcome == Outcome.DOCKED),
        port=int(final["port"]),
        goal_pose=final["goal_pose"].astype(np.float64),
        policy=policy,
        outcome=outcome,
        info=final,
    )


def _frame(env, params, state, observation):
    seen = {**observation, STATE: env.layout.measured_view(observation)}
    return Frame(seen, state.view, env.info(params, state)["epoch"])


@partial(jax.jit, static_argnames="env")
def _start(env, params, policies, keys, ports):
    def one(key, port):
        state, observation = env.reset(params, key=key, port=port)
        memories = tuple(policy.init(named_key(key, policy.name), port) for policy in policies)
        return (state, observation, memories), _frame(env, params, state, observation)

    return jax.vmap(one)(keys, ports)


@partial(jax.jit, static_argnames=("env", "length"), donate_argnames="carry")
def _fly(env, length, params, policies, which, carry):
    def one(choice, slot):
        state, observation, memories = slot
        # Every policy answers and one is heeded: cheaper than a batch, and a program, for each.
        answers = [policy.act(memory, observation) for policy, memory in zip(policies, memories)]
        action = jnp.stack([answer[0] for answer in answers])[choice]
        after, result = env.step(params, state, action)
        decision = Decision(env.layout.wrench(action, params.chaser.wrench_limit), result.reward, after.outcome)
        carried = (after, result.observation, tuple(answer[1] for answer in answers))
        return carried, (_frame(env, params, after, result.observation), decision)

    return jax.lax.scan(lambda slots, _: jax.vmap(one)(which, slots), carry, length=length)


@partial(jax.jit, static_argnames="env")
def _info(env, params, states) -> dict[str, Any]:
    return jax.vmap(env.info, in_axes=(None, 0))(params, states)
