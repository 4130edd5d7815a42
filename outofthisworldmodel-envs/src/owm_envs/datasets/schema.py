"""How the arrays of a recorded episode are named in files."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from owm_envs.episode import Episode
from owm_envs.view import VIEW_NAMES, VIEW_SIZE

CODEBASE_VERSION = "v3.0"
"""The LeRobot dataset format written here; every v3 is read."""


class Feature(NamedTuple):
    """A column: its NumPy dtype name, the shape of a row, and a name for each number."""

    dtype: str
    shape: tuple[int, ...]
    names: list[str] | None = None


FEATURES: dict[str, Feature] = {
    "observation.state": Feature("float32", (VIEW_SIZE,), list(VIEW_NAMES)),
    "observation.environment_state": Feature("float64", (VIEW_SIZE,), list(VIEW_NAMES)),
    "action": Feature("float32", (6,), [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]),
    "next.reward": Feature("float32", (1,)),
    "next.done": Feature("bool", (1,)),
    "next.success": Feature("bool", (1,)),
    "port": Feature("int64", (1,)),
    "goal_pose": Feature("float64", (7,), [f"position_{a}" for a in "xyz"] + [f"attitude_{a}" for a in "wxyz"]),
    "policy": Feature("int64", (1,)),
    "epoch": Feature("float64", (2,), ["mjd_day", "seconds_of_day"]),
    "outcome": Feature("int64", (1,)),
    "timestamp": Feature("float32", (1,)),
    "frame_index": Feature("int64", (1,)),
    "episode_index": Feature("int64", (1,)),
    "index": Feature("int64", (1,)),
    "task_index": Feature("int64", (1,)),
}
"""Columns that every file has, in order; the last five are LeRobot's own."""
OBSERVATION = "observation."
"""How the column of a part of the observation begins."""


def features_of(parts: Mapping[str, Any]) -> dict[str, Feature]:
    """The columns of episodes with these parts of the observation, each of a `shape` and `dtype`, by their names."""
    named = {OBSERVATION + name: Feature(np.dtype(part.dtype).name, tuple(part.shape)) for name, part in parts.items()}
    return FEATURES | {name: feature for name, feature in named.items() if name not in FEATURES}


def part_columns(names: Iterable[str]) -> list[str]:
    """The columns among these that are parts of the observation, beside those that every file has."""
    return [name for name in names if name.startswith(OBSERVATION) and name not in FEATURES]


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
    columns |= {OBSERVATION + name: values for name, values in episode.observation.items()}
    typed = {name: columns.pop(name).astype(feature.dtype) for name, feature in FEATURES.items()}
    return typed | columns


def episode_from_columns(columns: dict[str, np.ndarray]) -> Episode:
    """The episode whose rows these are: the inverse of `columns_from_episode`."""
    return Episode(
        observation={
            name.removeprefix(OBSERVATION): columns[name] for name in ("observation.state", *part_columns(columns))
        },
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
