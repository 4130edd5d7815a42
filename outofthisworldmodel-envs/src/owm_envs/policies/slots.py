"""The one shell around policies that fly slots: it keeps episodes, ports and state, and checks what it is given."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from owm_envs.flags import own_flags
from owm_envs.station import PORT_NAMES, port_indices
from owm_envs.task.observation import Observation, ObservationLayout, part, seen_now
from owm_envs.task.sensors import STATE


class Slots(NamedTuple):
    """What the shell knows of its slots at a decision.

    Attributes:
        fresh: whose episode begins with this observation.
        port: index of the assigned port.
        episode: how many episodes the slot has flown before this one.
        active: False where an episode has ended and no other has begun.
        measured: False where relative navigation is quiet: the state part is then an old one.
    """

    fresh: Bool[np.ndarray, "B"]
    port: Int[np.ndarray, "B"]
    episode: Int[np.ndarray, "B"]
    active: Bool[np.ndarray, "B"]
    measured: Bool[np.ndarray, "B"]


class SlotPolicy(ABC):
    """Fly a batch of slots; the only place that keeps their state.

    A policy of this kind gives `act`, and where it needs them `begin` and `check_ports`: functions of what they are
    given. It sees observations and ports, never `info`.

    Args:
        name: what reports call it.
        layout: of observations and actions.
        num_slots: episodes flown side by side; when None, as many as the first reset names ports.

    Attributes:
        active: (num_slots,) set to False where an episode has ended: such a slot gets zero actions until its next
            reset.
    """

    def __init__(self, name: str, layout: ObservationLayout, num_slots: int | None = None):
        if num_slots is not None and num_slots < 1:
            raise ValueError(f"num_slots must be at least 1, got {num_slots}")
        self.name = name
        self.layout = layout
        self.num_slots = num_slots
        self.active = np.ones(num_slots or 0, bool)
        self._any_number = num_slots is None
        self._ports: np.ndarray | None = None
        self._common: np.integer | None = None  # port of every slot, until a batch shows how many there are
        self._one_port = False  # for good, whoever begins
        self._episodes = self._pending = np.zeros(0)
        self._first = 0
        self._state: Any = None

    @abstractmethod
    def act(self, state: Any, observation: dict[str, np.ndarray], slots: Slots) -> tuple[Any, Any]:
        """Actions (B, 6) in the environment's layout for the parts (B, ...) of observations, and the next state."""

    def begin(self, count: int) -> Any:
        """The state of so many slots before their first measurement; None unless a policy has another."""
        return None

    def check_ports(self, ports: Int[np.ndarray, "N"]) -> None:  # noqa: B027 - most can be flown to all of them
        """Raise ValueError if one of the ports cannot be flown to."""

    def reset(
        self,
        mask: Bool[np.ndarray, "B"] | None = None,
        ports: Sequence[str | int] | Int[np.ndarray, "B"] | str | int | None = None,
    ) -> None:
        """Announce new episodes: their slots forget everything and start afresh at the next `predict`.

        Args:
            mask: slots whose episode begins; all when None.
            ports: assigned port of every slot, by name or index (`info["port"]`), read where `mask` is True; a single
                one is that of all; the ones known so far when None.

        Raises:
            ValueError: shapes disagree, a port is unknown or cannot be flown to, or no ports were ever given.
        """
        self._common = None
        self._one_port = self._one_port if ports is None else np.ndim(ports) == 0
        if ports is None and self._ports is None:
            raise ValueError("ports must be given on the first reset: one port index for each slot")
        if ports is not None and np.ndim(ports) == 0:
            (port,) = port_indices(ports)
            if mask is None and self._any_number:
                self._common = port
                return
            ports = np.full(self.num_slots if mask is None else np.size(mask), port)
        given = self._ports if ports is None else port_indices(ports)
        # A policy of any number of slots takes another number when all of them begin.
        anew = self._ports is None or (self._any_number and (mask is None or np.all(mask)))
        count = given.size if anew and self._any_number else self.num_slots
        mask = np.ones(count, bool) if mask is None else np.atleast_1d(np.asarray(mask, bool))
        for name, array in (("mask", mask), ("ports", given)):
            if array.shape != (count,):
                raise ValueError(f"{name} must have shape ({count},), one for each slot, got {array.shape}")
        self.check_ports(given[mask])
        if self._ports is None and not mask.all():
            raise ValueError("the first reset must start every slot")
        if self._ports is None or count != self.num_slots:
            self.num_slots = count
            with own_flags(jax.config.jax_enable_x64):
                self._state = self.begin(count)
            self._ports, self._episodes = given.astype(np.int32), np.full(count, self._first - 1, np.int32)
            self._pending = self.active = np.ones(count, bool)
        self._ports = np.where(mask, given, self._ports).astype(np.int32)
        self._pending = self._pending | mask
        self.active = self.active | mask

    def restart(self, episode: int = 0) -> None:
        """Forget all that has been flown, as if newly made.

        Args:
            episode: the number of every slot's next one, which draws may depend on.
        """
        self._ports, self._first = None, episode

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Bool[np.ndarray, "B"] | None = None,
        deterministic: bool = True,
    ) -> tuple[Float[np.ndarray, "B 6"], Any]:
        """Actions for a batch of observations, as Stable-Baselines3 policies give them.

        Args:
            observation: (B, O), or (O,) for a single slot; or a mapping of such parts, `state_valid` among them where
                relative navigation may go quiet.
            state: what the last call returned; the state kept inside when None.
            episode_start: slots whose episode begins with this observation, at the port last announced; where that was
                another episode's, and not one port for all, a warning says so.
            deterministic: has no effect: all draws follow from the policy's seed.

        Returns:
            float32 actions (B, 6), or (6,) for a single slot, in the environment's layout, and the state.

        Raises:
            ValueError: `reset` never told the ports, or the shape is wrong.
        """
        del deterministic
        shape = np.shape(part(observation, STATE))
        single = len(shape) == 1
        if self._common is not None:
            self.reset(ports=np.full(1 if single else shape[0], self._common))
            self._one_port = True
        if self._ports is None:
            raise ValueError("call reset(ports=...) before predict: the policy must know each slot's port")
        parts = dict(observation) if isinstance(observation, Mapping) else {STATE: observation}
        parts[STATE] = np.asarray(parts[STATE], np.float32)
        batch = {name: np.asarray(values)[None] if single else np.asarray(values) for name, values in parts.items()}
        expected = (self.num_slots, self.layout.size)
        if batch[STATE].shape != expected:
            raise ValueError(f"observation must have shape {expected}, got {shape}")
        if episode_start is not None:
            begun = np.broadcast_to(np.asarray(episode_start, bool), (self.num_slots,))
            self._warn_of_old_ports(begun & ~self._pending)
            self.reset(begun)
        fresh, self._pending = self._pending, np.zeros_like(self._pending)
        self._episodes = self._episodes + fresh
        seen = seen_now(batch)
        measured = np.ones(self.num_slots, bool) if seen is None else seen
        slots = Slots(fresh, self._ports, self._episodes, self.active, measured)
        with own_flags(jax.config.jax_enable_x64):
            actions, self._state = self.act(self._state if state is None else state, batch, slots)
        actions = np.where(self.active[:, None], np.asarray(actions, np.float32), np.float32(0))
        return (actions[0] if single else actions), self._state

    def _warn_of_old_ports(self, begun: Bool[np.ndarray, "B"]) -> None:
        """Say that slots begin an episode whose port nobody has announced: an environment may have drawn another."""
        if begun.any() and not self._one_port:
            slot = int(np.flatnonzero(begun)[0])
            warnings.warn(
                f"slot {slot} begins an episode, but its port was not announced: it flies to that of the last one, "
                f"{PORT_NAMES[self._ports[slot]]}; call reset(mask, ports=info['port']), or reset(ports=NAME) once "
                "where all fly to one port",
                stacklevel=3,
            )
