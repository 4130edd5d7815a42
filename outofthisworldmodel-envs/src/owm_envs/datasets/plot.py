"""The picture of a dataset: where each policy flew, how its flights ended, and what the sensors added."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from owm_envs.config import DockingConfig
from owm_envs.datasets.reader import dataset_folder, episodes, read_config, read_info
from owm_envs.episode import Episode
from owm_envs.figures import AXES, INK, PALETTE, silhouette, tidy
from owm_envs.station import hull_boxes
from owm_envs.view import View

ENDS: dict[str, tuple[str, str]] = {
    "docked": ("#009E73", "o"),
    "timeout": ("#56B4E9", "s"),
    "escaped": ("#CC79A7", "^"),
    "collided": ("#D55E00", "X"),
    "invalid_action": ("#E69F00", "D"),
    "diverged": ("#444444", "v"),
}
"""Colour and marker of each outcome; the colour-blind can tell them apart."""
_POINTS, _DRAWS = 240, 400  # of a path that is drawn, and of an episode that tells of the sensors
_VIEWS = (("from port side", 1, 2, 1), ("from below", 1, 0, -1))
_SENSED = (("position", "m", 1.0), ("velocity", "mm/s", 1e3), ("attitude", "mrad", 1e3), ("rate", "\u00b5rad/s", 1e6))


class Sketch(NamedTuple):
    """What is drawn of one episode."""

    policy: str
    outcome: str
    seconds: float
    path: Float[np.ndarray, "P 3"]
    errors: Float[np.ndarray, "Q 4"]
    """Sizes of the measurements' errors: m, m/s, rad, rad/s."""
    expected: Float[np.ndarray, "Q 4"]
    """The root-mean-square sizes that the configuration asks for there."""


def plot_dataset(
    path: str | Path, split: str | None = None, progress: Callable[[int, int | None], None] = lambda done, total: None
) -> Figure:
    """Draw a dataset: a column a policy, then outcomes, lengths and what was measured minus what was true.

    Args:
        path, split: as `read` takes them.
        progress: told how many episodes are read, of how many.

    Raises:
        FileNotFoundError, ValueError: as `read`.
    """
    folder = dataset_folder(path, split)
    config, info, sketches = read_config(folder), read_info(folder), []
    dt = 1 / info["fps"] if info.get("fps") else config.decision_dt
    for episode in episodes(folder):
        sketches.append(sketch(episode, config, dt))
        progress(len(sketches), info.get("total_episodes"))
    name = folder.resolve().name if split is None else f"{Path(path).resolve().name}, {split}"
    return dataset_figure(sketches, config, name)


def sketch(episode: Episode, config: DockingConfig, dt: float) -> Sketch:
    """What is drawn of an episode recorded every `dt` seconds."""
    rows = np.unique(np.linspace(0, len(episode), _DRAWS).astype(int))
    rows = rows[episode.observation.get("state_valid", np.ones((len(episode) + 1, 1), bool))[rows, 0]]
    measured, true, noise = episode.observation["state"][rows], episode.true_state[rows], config.noise
    navigation = config.navigation
    outlying = math.sqrt(1 + navigation.outlier_share * (navigation.outlier_scale**2 - 1))
    white, bias = ([getattr(part, name) for name, *_ in _SENSED] for part in (noise, noise.bias))
    expected = np.tile(white, (len(rows), 1))
    expected[:, 0] += noise.position_per_range * np.linalg.norm(true[:, :3], axis=1)
    expected = np.hypot(outlying * expected, bias)
    path = episode.true_state[np.unique(np.linspace(0, len(episode), _POINTS).astype(int)), :3]
    seconds = len(episode) * dt
    return Sketch(episode.policy_name, episode.outcome_name, seconds, path, residuals(measured, true), expected)


def residuals(measured: Float[np.ndarray, "Q 13"], true: Float[np.ndarray, "Q 13"]) -> Float[np.ndarray, "Q 4"]:
    """Sizes of the errors of measured views: position m, velocity m/s, attitude rad, rate rad/s."""
    seen, truth = View.of(np.asarray(measured, np.float64)), View.of(np.asarray(true, np.float64))
    turned = seen.attitude / np.linalg.norm(seen.attitude, axis=1, keepdims=True)
    # Half the chord between two unit quaternions is the sine of a quarter of the angle: exact for small ones too.
    chord = np.minimum(*(np.linalg.norm(turned - sign * truth.attitude, axis=1) for sign in (1, -1)))
    position, velocity, rate = (
        np.linalg.norm(getattr(seen, name) - getattr(truth, name), axis=1) for name in ("position", "velocity", "rate")
    )
    return np.stack([position, velocity, 4 * np.arcsin(np.clip(chord / 2, 0, 1)), rate], axis=1)


def dataset_figure(sketches: list[Sketch], config: DockingConfig, name: str) -> Figure:
    """Draw what `sketch` made of each episode."""
    policies = list(dict.fromkeys(one.policy for one in sketches))
    ends = [end for end in ENDS if any(one.outcome == end for one in sketches)]
    figure = Figure(figsize=(max(12.0, 4.4 * len(policies)), 12.4), layout="constrained", facecolor="white")
    flown, told = figure.subfigures(2, 1, height_ratios=(1.9, 1), hspace=0.02)
    hours = sum(one.seconds for one in sketches) / 3600
    title = f"{name}: {len(sketches)} episode{'s' * (len(sketches) != 1)}, {hours:.1f} h of flight, {config.fidelity}"
    figure.suptitle(title, fontsize=14, fontweight="bold", color=INK)
    _flights(flown, sketches, config, policies)
    first, marks = flown.axes[0], {"ls": "none", "ms": 7}
    handles = [first.plot([], [], ENDS[end][1], color=ENDS[end][0], mec="white", **marks)[0] for end in ends]
    handles += first.plot([], [], "o", color=INK, mfc="white", **marks)
    labels = [*(end.replace("_", " ") for end in ends), "start"]
    flown.legend(handles, labels, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    panels = told.subplots(1, 6, width_ratios=(1.5, 1.5, 1, 1, 1, 1))
    _outcomes(panels[0], sketches, policies, ends)
    _lengths(panels[1], sketches, policies)
    _noise(panels[2:], sketches)
    return figure


def _flights(figure, sketches, config, policies) -> None:
    boxes = hull_boxes() if config.hull == "iss" else np.array(config.hull)
    panels = figure.subplots(len(_VIEWS), len(policies), squeeze=False)
    for column, policy in enumerate(policies):
        some = [one for one in sketches if one.policy == policy]
        alpha = min(0.8, max(0.08, 12 / len(some)))
        points = np.concatenate([*(one.path for one in some), boxes.reshape(-1, 3)])
        low, high = points.min(axis=0), points.max(axis=0)
        half, middle = 0.54 * (high - low).max(), 0.5 * (low + high)  # one scale for both views
        for row, (view, i, j, sign) in enumerate(_VIEWS):
            axes = panels[row, column]
            silhouette(axes, boxes, i, j, sign, alpha=0.9, zorder=1)
            paths = [one.path[:, [i, j]] for one in some]
            axes.add_collection(LineCollection(paths, colors=INK, alpha=alpha, lw=0.9, zorder=2))
            starts = np.array([path[0] for path in paths])
            axes.plot(*starts.T, "o", color=INK, mfc="white", ms=3.5, mew=0.8, zorder=3)
            for end, (color, marker) in ENDS.items():
                last = np.array([p[-1] for p, one in zip(paths, some) if one.outcome == end]).reshape(-1, 2)
                axes.plot(*last.T, marker, color=color, ms=6, mec="white", mew=0.5, ls="none", zorder=4)
            axes.set(xlim=(middle[i] - half, middle[i] + half), ylim=(middle[j] - half, middle[j] + half))
            axes.set(xlabel=AXES[i], ylabel=AXES[j] if column == 0 else "", aspect="equal")
            count = f" ({len(some)})" if row == 0 else ""
            axes.set_title(f"{policy}{count}, {view}", loc="left", fontsize=10, color=INK)
            tidy(axes)


def _outcomes(axes, sketches, policies, ends) -> None:
    place, left = np.arange(len(policies)), np.zeros(len(policies))
    for end in ends:
        counts = np.array([sum(one.policy == policy and one.outcome == end for one in sketches) for policy in policies])
        axes.barh(place, counts, left=left, color=ENDS[end][0], height=0.62, zorder=2)
        for y, x, count in zip(place, left, counts):
            if count:
                axes.text(x + count / 2, y, str(count), ha="center", va="center", fontsize=8, color="white", zorder=3)
        left += counts
    axes.set_yticks(place, policies)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.invert_yaxis()
    _titled(axes, "episodes by outcome")


def _lengths(axes, sketches, policies) -> None:
    longest = max(one.seconds for one in sketches)
    edges = np.linspace(0, longest * 1.001, 25)
    lengths = [[one.seconds for one in sketches if one.policy == policy] for policy in policies]
    colors = [PALETTE[k % len(PALETTE)] for k in range(len(policies))]
    axes.hist(lengths, edges, stacked=True, color=colors, label=policies, zorder=2)
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _titled(axes, "length of episodes [s]")


def _noise(panels, sketches) -> None:
    errors, expected = (np.concatenate([getattr(one, what) for one in sketches]) for what in ("errors", "expected"))
    for k, (axes, (name, unit, scale)) in enumerate(zip(panels, _SENSED)):
        found, asked = (float(np.sqrt(np.mean(values[:, k] ** 2))) * scale for values in (errors, expected))
        axes.hist(errors[:, k] * scale, 40, color=PALETTE[0], zorder=2)
        axes.axvline(asked, color=PALETTE[1], lw=1.6, ls="--", zorder=3)
        axes.axvline(found, color=INK, lw=1.0, zorder=3)
        axes.set_yticks([])
        place = {"transform": axes.transAxes, "ha": "right", "va": "top"}
        axes.text(0.97, 0.95, f"RMS {found:.3g}\nset {asked:.3g}", fontsize=8, color=INK, **place)
        _titled(axes, f"{name} error [{unit}]")


def _titled(axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, color=INK)
    tidy(axes)
