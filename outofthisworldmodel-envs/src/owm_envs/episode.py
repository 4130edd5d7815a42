"""What a recorded flight is."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped

POLICY_NAMES: tuple[str, ...] = (
    "random",
    "orbit",
    "dock",
    "dock-geodesic",
    "excite",
    "dock-geodesic-integral",
    "dock-safe",
)
"""Scripted policies; a policy's id in files is its place in this tuple. New names go to the end."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One whole episode of T decisions, NumPy arrays in SI units.

    Row t of `action`, `reward`, `done` and `success` leads from frame t to frame t + 1.
    """

    observation: dict[str, Shaped[np.ndarray, "T+1 ..."]]
    """What the policy saw, by parts: "state" is the float32 measured relative view (T+1, 13), whatever the
    observation's layout was; the others are as their sensors gave them. Of a file a video's frames are a
    `owm_envs.datasets.frames.Frames`, which decodes them when they are looked at."""
    true_state: Float[np.ndarray, "T+1 13"]
    """float64 true relative view."""
    epoch: Float[np.ndarray, "T+1 2"]
    """float64 [whole MJD, seconds of day] UTC."""
    action: Float[np.ndarray, "T 6"]
    """float32 commanded body wrench [N, N m] after clipping to the limits, before any actuation fault or delay."""
    reward: Float[np.ndarray, "T"]
    """float32."""
    done: Bool[np.ndarray, "T"]
    success: Bool[np.ndarray, "T"]
    port: int
    """Index into `owm_envs.station.PORTS`."""
    goal_pose: Float[np.ndarray, "7"]
    """float64 hold position and attitude of the port."""
    policy: int
    """Index into `POLICY_NAMES`; -1 for a policy of your own."""
    outcome: int
    """An `owm_envs.task.events.Outcome`."""
    info: dict[str, Any] | None = None
    """`DockingEnv.info` at the end of the flight; None when read from a file."""

    def __len__(self) -> int:
        return len(self.action)

    @property
    def policy_name(self) -> str:
        """Name of the policy that flew it."""
        return POLICY_NAMES[self.policy] if 0 <= self.policy < len(POLICY_NAMES) else "other"

    @property
    def outcome_name(self) -> str:
        """What the episode came to, in lower case."""
        from owm_envs.task.events import OUTCOME_NAMES

        return OUTCOME_NAMES[self.outcome]
