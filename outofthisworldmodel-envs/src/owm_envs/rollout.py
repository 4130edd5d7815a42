"""Fly whole episodes in batches, as one compiled program, and record them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from owm_envs.config.params import Params
from owm_envs.env import DockingEnv
from owm_envs.episode import POLICY_NAMES, Episode
from owm_envs.policies import ScriptedPolicy
from owm_envs.task.events import Outcome
from owm_envs.task.reset import named_key


class Frame(NamedTuple):
    """What is recorded of one instant of one episode."""

    observation: Float[Array, "13"]
    true_state: Float[Array, "13"]
    epoch: Float[Array, "2"]


class Decision(NamedTuple):
    """What is recorded of one decision of one episode."""

    action: Float[Array, "6"]
    reward: Float[Array, ""]
    outcome: Int[Array, ""]


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
) -> list[Episode]:
    """Fly B episodes to their ends, recording every frame at the decision rate.

    The batch advances in chunks of `chunk` decisions, all running the same compiled program, until the last episode
    has ended. An episode depends on its key, port and policy alone, not on its neighbours in the batch.

    Args:
        policies: one policy, or several of which each slot flies one.
        keys: (B,) one for each episode: start, sensor noise and the policy's draws.
        ports: (B,) indices of the assigned ports.
        which: (B,) index into `policies` for each slot; the first for all when None.
        params: the environment's numbers; its own defaults when None.
        progress: called after each chunk with decisions flown and the number of episodes still running.

    Returns:
        B episodes in the order of `keys`.

    Raises:
        ValueError: shapes disagree or an index is out of range.
    """
    policies = tuple(policies) if isinstance(policies, Sequence) else (policies,)
    ports = np.asarray(ports, np.int32)
    which = np.zeros(ports.shape, np.int32) if which is None else np.asarray(which, np.int32)
    if not (keys.shape == ports.shape == which.shape and ports.ndim == 1):
        raise ValueError(f"keys {keys.shape}, ports {ports.shape} and which {which.shape} must all have shape (B,)")
    if which.size and not (0 <= which.min() and which.max() < len(policies)):
        raise ValueError(f"which must be indices into the {len(policies)} policies, got {which.tolist()}")

    # As the adapters do, whatever the environment's precision: draws differ in 64-bit mode.
    with jax.enable_x64(True):
        params = env.default_params() if params is None else params
        if ports.size and not (0 <= ports.min() and ports.max() < params.goals.shape[0]):
            raise ValueError(f"ports must be from 0 to {params.goals.shape[0] - 1}, got {ports.tolist()}")
        carry, first = _start(env, params, policies, keys, ports)
        frames, decisions = [jax.tree.map(lambda x: np.asarray(x)[None], first)], []
        running = ports.size
        while running:
            carry, (frame, decision) = _fly(env, chunk, params, policies, which, carry)
            frames.append(jax.tree.map(np.asarray, frame))
            decisions.append(jax.tree.map(np.asarray, decision))
            running = int(np.sum(decisions[-1].outcome[-1] == Outcome.RUNNING))
            if progress is not None:
                progress(chunk * len(decisions), running)
        final = jax.tree.map(np.asarray, _info(env, params, carry[0]))
    if not ports.size:
        return []
    names = [POLICY_NAMES.index(p.name) if p.name in POLICY_NAMES else -1 for p in policies]
    return [_episode(i, frames, decisions, final, names[which[i]]) for i in range(ports.size)]


def _episode(slot: int, frames: list[Frame], decisions: list[Decision], final: dict, policy: int) -> Episode:
    """One slot's flight, out of the chunks of the batch."""

    def joined(chunks, name, stop, dtype):
        return np.concatenate([getattr(chunk, name)[:, slot] for chunk in chunks])[:stop].astype(dtype)

    outcomes = joined(decisions, "outcome", None, np.int32)
    length = int(np.argmax(outcomes != Outcome.RUNNING)) + 1
    outcome = int(outcomes[length - 1])
    last = np.arange(length) == length - 1
    return Episode(
        observation=joined(frames, "observation", length + 1, np.float32),
        true_state=joined(frames, "true_state", length + 1, np.float64),
        epoch=joined(frames, "epoch", length + 1, np.float64),
        action=joined(decisions, "action", length, np.float32),
        reward=joined(decisions, "reward", length, np.float32),
        done=last,
        success=last & (outcome == Outcome.DOCKED),
        port=int(final["port"][slot]),
        goal_pose=final["goal_pose"][slot].astype(np.float64),
        policy=policy,
        outcome=outcome,
        info={name: value[slot] for name, value in final.items()},
    )


def _frame(env, params, state, observation):
    return Frame(env.layout.measured_view(observation), state.view, env.info(params, state)["epoch"])


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
