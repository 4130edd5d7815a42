"""The stateful shell that flies a batch of slots with a pure policy."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from owm_envs.flags import own_flags
from owm_envs.policies.base import ScriptedPolicy
from owm_envs.station import goal_poses, port_index


class VectorPolicy:
    """Fly a batch of slots with a scripted policy; the only place that keeps its state.

    Args:
        policy: from `make_policy`.
        seed: decides every random draw; each slot and each of its episodes has a key of its own.
    """

    def __init__(self, policy: ScriptedPolicy, *, seed: int = 0):
        self.policy = policy
        self.name = policy.name
        self._seed = seed
        self._ports: np.ndarray | None = None
        self._episodes: np.ndarray | None = None
        self._pending: np.ndarray | None = None
        self._state: Any = None

    def __repr__(self) -> str:
        return f"VectorPolicy({self.name!r}, seed={self._seed})"

    def reset(
        self, mask: Bool[np.ndarray, "B"] | None = None, ports: Sequence[str | int] | np.ndarray | None = None
    ) -> None:
        """Announce new episodes: their slots start afresh at the next `predict`.

        Args:
            mask: slots whose episode begins; all when None.
            ports: assigned port of every slot, as names (`info["port"]`) or indices, read where `mask` is True; the
                ones known so far when None.

        Raises:
            ValueError: shapes disagree, a port is unknown, or no ports were ever given.
        """
        if ports is None:
            if self._ports is None:
                raise ValueError("ports must be given on the first reset: one port index for each slot")
            ports = self._ports
        ports = _port_indices(ports)
        mask = np.ones(ports.shape, bool) if mask is None else np.atleast_1d(np.asarray(mask, bool))
        fresh = self._ports is None or (mask.all() and mask.shape == ports.shape != self._ports.shape)
        if fresh:
            self._ports, self._state = ports, None
            self._episodes = np.full(ports.shape, -1, np.int32)
            self._pending = np.ones(ports.shape, bool)
        elif mask.shape != self._ports.shape or ports.shape != self._ports.shape:
            raise ValueError(
                f"mask {mask.shape} and ports {ports.shape} must have one entry for each of the "
                f"{self._ports.size} slots"
            )
        else:
            self._ports = np.where(mask, ports, self._ports)
            self._pending = self._pending | mask

    def predict(
        self,
        observation: Float[np.ndarray, "B O"],
        state: Any = None,
        episode_start: Bool[np.ndarray, "B"] | None = None,
        deterministic: bool = False,
    ) -> tuple[Float[np.ndarray, "B 6"], Any]:
        """Actions for a batch of observations, as Stable-Baselines3 policies give them.

        Args:
            observation: (B, O), or (O,) for a single slot.
            state: what the last call returned; the state kept inside when None.
            episode_start: slots whose episode begins with this observation, at the port last announced.
            deterministic: has no effect: draws are part of a scripted policy and follow from its seed.

        Returns:
            float32 actions (B, 6), or (6,) for a single slot, and the state.

        Raises:
            ValueError: `reset` never told the ports, or the shape is wrong.
        """
        del deterministic
        if self._ports is None:
            raise ValueError("call reset(ports=...) before predict: the policy must know each slot's port")
        observation = np.asarray(observation, np.float32)
        single = observation.ndim == 1
        batch = observation[None] if single else observation
        expected = (self._ports.size, self.policy.layout.size)
        if batch.shape != expected:
            raise ValueError(f"observation must have shape {expected}, got {observation.shape}")
        if episode_start is not None:
            self.reset(np.broadcast_to(np.asarray(episode_start, bool), self._ports.shape))
        fresh = self._pending
        self._episodes = self._episodes + fresh
        kept = self._state if state is None else state
        fresh = np.ones_like(fresh) if kept is None else fresh
        with own_flags(jax.config.jax_enable_x64):
            actions, self._state = _advance(
                self.policy, kept, batch, fresh, self._ports, np.uint32(self._seed), self._episodes.astype(np.uint32)
            )
        self._pending = np.zeros_like(self._pending)
        actions = np.asarray(actions, np.float32)
        return (actions[0] if single else actions), self._state


def _port_indices(ports: Sequence[str | int] | np.ndarray) -> Int[np.ndarray, "B"]:
    values = np.atleast_1d(np.asarray(ports))
    if values.dtype.kind in "UO":
        values = np.array([port_index(str(name)) for name in values])
    count = len(goal_poses())
    if values.ndim != 1 or values.dtype.kind not in "iu" or (values < 0).any() or (values >= count).any():
        raise ValueError(f"ports must be a name or an index from 0 to {count - 1} for each slot, got {values.tolist()}")
    return values.astype(np.int32)


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
