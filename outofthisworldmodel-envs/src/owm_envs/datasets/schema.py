"""How the arrays of a recorded episode are named in files."""

from typing import NamedTuple

import numpy as np

from owm_envs.episode import Episode

CODEBASE_VERSION = "v3.0"
"""The LeRobot dataset format written here; every v3 is read."""


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
