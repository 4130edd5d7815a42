"""Scripted policies, which are pure and for one episode, flown by slots."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from owm_envs.policies.base import ScriptedPolicy
from owm_envs.policies.slots import SlotPolicy, Slots
from owm_envs.words import checked_seed


class VectorPolicy(SlotPolicy):
    """Fly a batch of slots with a scripted policy, as many as a reset names ports.

    Args:
        policy: from `make_policy`.
        seed: decides every random draw; each slot and each of its episodes has a key of its own.
    """

    def __init__(self, policy: ScriptedPolicy, *, seed: int = 0):
        super().__init__(policy.name, policy.layout)
        self.policy = policy
        self._seed = np.uint32(checked_seed(seed, bits=32))

    def __repr__(self) -> str:
        return f"VectorPolicy({self.name!r}, seed={self._seed})"

    def act(self, state: Any, observation: dict[str, np.ndarray], slots: Slots) -> tuple[Any, Any]:
        """Every slot's action and next state, in one compiled program."""
        episodes = slots.episode.astype(np.uint32)
        return _advance(self.policy, state, observation, slots.fresh, slots.port, self._seed, episodes)


@jax.jit
def _advance(policy, states, observations, fresh, ports, seed, episodes):
    slots = jnp.arange(ports.shape[0], dtype=jnp.uint32)

    def start(slot, episode, port):
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), slot), episode)
        return policy.init(key, port)

    started = jax.vmap(start)(slots, episodes, ports)
    if states is None:
        states = started
    else:

        def choose(new, old):
            # Keys have no arithmetic: select works on them, and on arrays alike.
            return jnp.where(fresh.reshape(fresh.shape + (1,) * (new.ndim - 1)), new, old)

        states = jax.tree.map(choose, started, states)
    return jax.vmap(policy.act)(states, observations)
