"""How the arrays of a recorded episode are named in files."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from owm_envs.episode import Episode
from owm_envs.view import VIEW_NAMES, VIEW_SIZE

CODEBASE_VERSION = "v3.0"
"""The LeRobot dataset format written here; every v3 is read."""


class Feature(NamedTuple):
    """A column: its NumPy dtype name, or "video"; the shape of a row; a name for each number, or axis of a frame."""

    dtype: str
    shape: tuple[int, ...]
    names: list[str] | None = None

    @property
    def is_video(self) -> bool:
        """Whether its frames lie in files of their own."""
        return self.dtype == VIDEO


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
VIDEO = "video"
_IMAGES = "observation.images."
_VIEWS = {"pixels": "fpv"}
"""What a part is called among the images of a dataset, where not by its own name."""


def features_of(parts: Mapping[str, Any]) -> dict[str, Feature]:
    """The columns of episodes with these parts of the observation, each of a `shape` and `dtype`, by their names.

    Frames of three channels of 8 bits become videos.
    """
    named = {}
    for name, part in parts.items():
        dtype, shape = np.dtype(part.dtype).name, tuple(part.shape)
        if dtype == "uint8" and len(shape) == 3 and shape[2] == 3:
            named[_IMAGES + _VIEWS.get(name, name)] = Feature(VIDEO, shape, ["height", "width", "channels"])
        else:
            named[OBSERVATION + name] = Feature(dtype, shape)
    return FEATURES | {name: feature for name, feature in named.items() if name not in FEATURES}


def part_of(column: str) -> str:
    """The part of the observation that a column, or a video, holds."""
    if column.startswith(_IMAGES):
        view = column.removeprefix(_IMAGES)
        return next((part for part, known in _VIEWS.items() if known == view), view)
    return column.removeprefix(OBSERVATION)


def part_columns(names: Iterable[str]) -> list[str]:
    """The columns among these that are parts of the observation, beside those that every file has."""
    return [name for name in names if name.startswith(OBSERVATION) and name not in FEATURES]


def columns_from_episode(
    episode: Episode, *, episode_index: int, first_index: int, fps: float
) -> dict[str, np.ndarray]:
    """Lay an episode of T decisions out as T + 1 rows; parts of the observation that are not arrays are left out.

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
    columns |= {
        OBSERVATION + name: values for name, values in episode.observation.items() if isinstance(values, np.ndarray)
    }
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
