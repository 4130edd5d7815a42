"""Normalisation statistics, as LeRobot keeps them: for each episode, and aggregated over episodes."""

from collections.abc import Mapping, Sequence

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
NO_TRANSITION_ROWS = ("action", "next.reward")
"""Columns whose last row in an episode is padding and is left out."""

Statistics = dict[str, dict[str, np.ndarray]]
"""Column to {min, max, mean, std, count, q01, q10, q50, q90, q99}, each (width,), count (1,)."""


def episode_statistics(columns: Mapping[str, np.ndarray]) -> Statistics:
    """Statistics of one episode's columns; padding of the terminal row excluded."""
    result = {}
    for name, values in columns.items():
        rows = values[:-1] if name in NO_TRANSITION_ROWS else values
        rows = rows.reshape(len(rows), -1).astype(np.float64)
        ordered = np.sort(rows, axis=0)
        result[name] = {
            "min": ordered[0],
            "max": ordered[-1],
            "mean": rows.mean(axis=0),
            "std": rows.std(axis=0),
            "count": np.array([len(rows)]),
            **{key: _sorted_quantile(ordered, q) for key, q in QUANTILES.items()},
        }
    return result


def aggregate(parts: Sequence[Statistics]) -> Statistics:
    """Statistics of the union of episodes: exact, but for quantiles, which are means weighted by count.

    Averaged quantiles are LeRobot's own convention: they need no second pass over the data.
    """
    result = {}
    for name in parts[0]:
        counts = np.stack([part[name]["count"] for part in parts]).astype(np.float64)
        weights = counts / counts.sum()
        means = np.stack([part[name]["mean"] for part in parts])
        mean = np.sum(weights * means, axis=0)
        variances = np.stack([part[name]["std"] for part in parts]) ** 2
        result[name] = {
            "min": np.min([part[name]["min"] for part in parts], axis=0),
            "max": np.max([part[name]["max"] for part in parts], axis=0),
            "mean": mean,
            "std": np.sqrt(np.sum(weights * (variances + (means - mean) ** 2), axis=0)),
            "count": np.array([int(counts.sum())]),
            **{key: np.sum(weights * np.stack([part[name][key] for part in parts]), axis=0) for key in QUANTILES},
        }
    return result


def _sorted_quantile(ordered: np.ndarray, q: float) -> np.ndarray:
    place = q * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])
