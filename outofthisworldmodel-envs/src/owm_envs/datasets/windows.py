"""Equally long cuts of episodes, at a rate of their own, for anything that loads examples by number."""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float, Int

ACTION = "action"


def grid(decisions: int, stride: int, phase: int = 0) -> Int[np.ndarray, "S"]:
    """The rows that are `stride` apart, from `phase` to the last of an episode of so many decisions."""
    return np.arange(phase, decisions + 1, stride)


def mean_actions(action: Float[np.ndarray, "T A"], rows: Int[np.ndarray, "S"]) -> Float[np.ndarray, "S-1 A"]:
    """What acted on the mean from each of the rows to the next; they are equally far apart."""
    if len(rows) < 2:
        return action[:0]
    between = action[rows[0] : rows[-1]]
    return between.reshape(len(rows) - 1, rows[1] - rows[0], *action.shape[1:]).mean(axis=1)


class Episodic(Protocol):
    """What windows are cut of: a `Dataset`."""

    lengths: Int[np.ndarray, "E"]
    """Rows of each episode."""

    def columns(self, number: int) -> dict[str, Any]:
        """Arrays of an episode's rows, by column."""


class Windows:
    """Cuts of a dataset's episodes by number; it has the length and items that loaders of torch and grain ask for.

    An item is a dict of arrays: each part of the observation under its column's name, (context + rollout, ...), and
    `action`, (context + rollout - 1, ...), the mean from a view to the next. No cut crosses an episode's end, and the
    padded last row of an episode gives a view but no action.

    Args:
        dataset: what to cut.
        context, rollout, stride: as `Dataset.windows` takes them.

    Raises:
        ValueError: one of them is not positive, or no episode is long enough.
    """

    def __init__(self, dataset: Episodic, context: int = 8, rollout: int = 16, stride: int = 5):
        for name, value, least in (("context", context, 1), ("rollout", rollout, 1), ("stride", stride, 1)):
            if value < least:
                raise ValueError(f"{name} must be at least {least}, got {value}")
        self.dataset, self.context, self.rollout, self.stride = dataset, context, rollout, stride
        self._reach = (context + rollout - 1) * stride
        self._ends = np.cumsum(np.maximum(dataset.lengths - self._reach, 0))
        if not len(self):
            longest = int(dataset.lengths.max(initial=0))
            raise ValueError(f"a window spans {self._reach + 1} rows; the longest episode has {longest}")

    def __repr__(self) -> str:
        sizes = f"context={self.context}, rollout={self.rollout}, stride={self.stride}"
        return f"Windows({self.dataset!r}, {sizes})"

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __iter__(self) -> Iterator[dict[str, np.ndarray]]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: int) -> dict[str, np.ndarray]:
        """A cut; neighbours are one row apart.

        Raises:
            IndexError: there is none of that number.
            FileNotFoundError, ValueError: as `Dataset.columns`.
        """
        count = len(self)
        if not -count <= number < count:
            raise IndexError(f"there are {count} windows, got {number}")
        number = int(number) % count
        episode = int(np.searchsorted(self._ends, number, side="right"))
        first = number - (int(self._ends[episode - 1]) if episode else 0)
        columns = self.dataset.columns(episode)
        if ACTION not in columns:
            raise ValueError(f"{self.dataset} has no column {ACTION!r}; it has {', '.join(columns)}")
        rows = first + grid(self._reach, self.stride)
        seen = {name: np.array(values[rows]) for name, values in columns.items() if name.startswith("observation")}
        return seen | {ACTION: mean_actions(_flat(columns[ACTION]), rows)}


def _flat(action: Any) -> np.ndarray:
    return action if action.ndim > 1 else action[:, None]
