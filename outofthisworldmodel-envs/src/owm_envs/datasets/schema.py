"""What a recorded episode is, and how its arrays are named in files."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

POLICY_NAMES: tuple[str, ...] = ("random", "orbit", "dock", "dock-geodesic", "excite", "dock-geodesic-integral")
"""Scripted policies; a policy's id in files is its place in this tuple. New names go to the end."""

CODEBASE_VERSION = "v3.0"
"""The LeRobot dataset format written here; every v3 is read."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One whole episode of T decisions, NumPy arrays in SI units.

    Row t of `action`, `reward`, `done` and `success` leads from frame t to frame t + 1.
    """

    observation: Float[np.ndarray, "T+1 13"]
    """float32 measured relative view, as the policy saw it."""
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
        from owm_envs.task.events import Outcome

        return Outcome(self.outcome).name.lower()


class Feature(NamedTuple):
    """A column: its NumPy dtype name, its width, and a name for each number."""

    dtype: str
    width: int
    names: list[str] | None = None


def _view_names() -> list[str]:
    parts = [f"{part}_{axis}" for part in ("position", "velocity") for axis in "xyz"]
    return parts + [f"attitude_{axis}" for axis in "wxyz"] + [f"rate_{axis}" for axis in "xyz"]


FEATURES: dict[str, Feature] = {
    "observation.state": Feature("float32", 13, _view_names()),
    "observation.environment_state": Feature("float64", 13, _view_names()),
    "action": Feature("float32", 6, [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]),
    "next.reward": Feature("float32", 1),
    "next.done": Feature("bool", 1),
    "next.success": Feature("bool", 1),
    "port": Feature("int64", 1),
    "goal_pose": Feature("float64", 7, [f"position_{a}" for a in "xyz"] + [f"attitude_{a}" for a in "wxyz"]),
    "policy": Feature("int64", 1),
    "epoch": Feature("float64", 2, ["mjd_day", "seconds_of_day"]),
    "outcome": Feature("int64", 1),
    "timestamp": Feature("float32", 1),
    "frame_index": Feature("int64", 1),
    "episode_index": Feature("int64", 1),
    "index": Feature("int64", 1),
    "task_index": Feature("int64", 1),
}
"""Columns of the files, in order; the last five are LeRobot's own."""


def columns_from_episode(
    episode: Episode, *, episode_index: int, first_index: int, fps: float
) -> dict[str, np.ndarray]:
    """Lay an episode of T decisions out as T + 1 rows.

    The last row holds the terminal observation, a zero action and reward, and `next.done`: it starts no transition.
    """
    rows = len(episode) + 1

    def padded(values):
        return np.concatenate([values, np.zeros_like(values[:1])])

    def repeated(value, dtype):
        return np.repeat(np.asarray(value, dtype)[None], rows, axis=0)

    columns = {
        "observation.state": episode.observation,
        "observation.environment_state": episode.true_state,
        "action": padded(episode.action),
        "next.reward": padded(episode.reward),
        "next.done": np.append(episode.done, True),
        "next.success": np.append(episode.success, episode.success[-1]),
        "port": repeated(episode.port, np.int64),
        "goal_pose": repeated(episode.goal_pose, np.float64),
        "policy": repeated(episode.policy, np.int64),
        "epoch": episode.epoch,
        "outcome": repeated(episode.outcome, np.int64),
        "timestamp": np.arange(rows) / fps,
        "frame_index": np.arange(rows),
        "episode_index": repeated(episode_index, np.int64),
        "index": first_index + np.arange(rows),
        "task_index": repeated(episode.port, np.int64),
    }
    return {name: columns[name].astype(feature.dtype) for name, feature in FEATURES.items()}


def episode_from_columns(columns: dict[str, np.ndarray]) -> Episode:
    """The episode whose rows these are: the inverse of `columns_from_episode`."""
    return Episode(
        observation=columns["observation.state"],
        true_state=columns["observation.environment_state"],
        epoch=columns["epoch"],
        action=columns["action"][:-1],
        reward=columns["next.reward"][:-1],
        done=columns["next.done"][:-1],
        success=columns["next.success"][:-1],
        port=int(columns["port"][0]),
        goal_pose=columns["goal_pose"][0],
        policy=int(columns["policy"][0]),
        outcome=int(columns["outcome"][0]),
    )
