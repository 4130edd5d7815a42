"""Scored flights as recorded episodes: what was seen and done, decision by decision."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from owm_envs.episode import POLICY_NAMES, Episode
from owm_envs.task.events import Outcome
from owm_envs.task.sensors import STATE, STATE_VALID


class Tape:
    """A batch of B flights as it goes: a frame, then a decision and a frame again and again.

    Args:
        policy: name of who flies.
        goals: hold pose of each port.
    """

    def __init__(self, policy: str, goals: Float[np.ndarray, "8 7"]):
        self._goals = goals
        self.policy = POLICY_NAMES.index(policy) if policy in POLICY_NAMES else -1
        self._frames: list[tuple[np.ndarray, ...]] = []
        self._fresh: list[np.ndarray] = []
        self._decisions: list[tuple[np.ndarray, ...]] = []
        self._outcome = np.zeros(0, np.int64)

    def frame(
        self, measured: Float[np.ndarray, "B 13"], info: Mapping[str, Any], fresh: Bool[np.ndarray, "B"] | None = None
    ) -> None:
        """Keep what was seen, whether it was measured at this very instant where it may not be, and what was true."""
        self._frames.append((np.float32(measured), np.float64(info["true_state"]), np.float64(info["epoch"])))
        if fresh is not None:
            self._fresh.append(np.asarray(fresh, bool))
        self._outcome = np.asarray(info["outcome"], np.int64)

    def decision(
        self, wrench: Float[np.ndarray, "B 6"], reward: Float[np.ndarray, "B"], running: Bool[np.ndarray, "B"]
    ) -> None:
        """Keep what was commanded, N and N m, by those who were still flying."""
        self._decisions.append((np.float32(wrench), np.float32(reward), running.copy()))

    def episodes(self, ports: Int[np.ndarray, "N"]) -> list[Episode]:
        """The first N flights, each until its end; `ports` are theirs."""
        measured, true, epoch = (np.stack(values, axis=1) for values in zip(*self._frames))
        action, reward, flying = (np.stack(values, axis=1) for values in zip(*self._decisions))
        seen = {STATE: measured} | ({STATE_VALID: np.stack(self._fresh, axis=1)[..., None]} if self._fresh else {})
        made, goals = [], self._goals
        for slot, port in enumerate(ports):
            length = int(flying[slot].sum())
            last = np.arange(length) == length - 1
            outcome = int(self._outcome[slot])
            made.append(
                Episode(
                    observation={name: part[slot, : length + 1] for name, part in seen.items()},
                    true_state=true[slot, : length + 1],
                    epoch=epoch[slot, : length + 1],
                    action=action[slot, :length],
                    reward=reward[slot, :length],
                    done=last,
                    success=last & (outcome == Outcome.DOCKED),
                    port=int(port),
                    goal_pose=goals[port],
                    policy=self.policy,
                    outcome=outcome,
                )
            )
        return made
