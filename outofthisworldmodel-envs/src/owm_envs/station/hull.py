"""The station as the collision test sees it: 313 axis-aligned boxes, made from the table of parts.

`build_hull` makes them in about ten seconds; what it made is kept beside this file, and a test makes it again. After a
change of the table: `save_hull("hull.csv", build_hull())` in this folder.
"""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from owm_envs.files import read_text
from owm_envs.station.boxes import cover, distance_to, emptiness, grid_around, merge, occupancy_of, outer_samples, trim
from owm_envs.station.geometry import nearest_part, sample_surface
from owm_envs.station.parts import PARTS, Part
from owm_envs.station.ports import goal_poses

BOXES = 313
_KEPT = Path(__file__).with_name("hull.csv")
_SPACING = 0.45  # of the grid on which empty space is counted [m]
_REACH = 2.25  # radius of the chaser's bounding sphere [m]
_NEAR = 10.0  # within this distance of a hold point [m] empty space counts in full


def part_boxes(part: Part, step: float = 1.0) -> Float[np.ndarray, "n 2 3"]:
    """Give fine axis-aligned boxes that cover one part, corners rounded outwards to the millimetre.

    Args:
        part: a row of `PARTS`.
        step: longest slice of what lies askew [m].

    Returns:
        (n, 2, 3) float64 lower and upper corners [m], station frame.
    """
    boxes = cover(part, step) * 1000.0
    return np.stack([np.floor(boxes[:, 0] + 1e-6), np.ceil(boxes[:, 1] - 1e-6)], axis=1) / 1000.0


def build_hull(parts: tuple[Part, ...] = PARTS, count: int = BOXES) -> Float[np.ndarray, "count 2 3"]:
    """Make the hull from a table: cover each part finely, then merge where the least empty space is taken in.

    Empty space at distance d from the nearest hold point counts 1 / (1 + (d / 10 m)^2): as much as it lies in the way
    of chasers that converge on the ports.

    Args:
        parts: the table, station frame.
        count: number of boxes.

    Returns:
        (count, 2, 3) float64 lower and upper corners [m], whole millimetres, sorted by lower corner.
    """
    atoms = np.concatenate([part_boxes(part) for part in parts])
    grid = grid_around(atoms, _SPACING, _REACH)
    nearest = np.full(grid.shape, np.inf)
    for goal in goal_poses()[:, :3]:
        x, y, z = ((a - g) ** 2 for a, g in zip(grid.centres(), goal))
        nearest = np.minimum(nearest, x[:, None, None] + y[:, None] + z)
    space = emptiness(occupancy_of(atoms, grid), grid, 1.0 / (1.0 + nearest / _NEAR**2))
    boxes = trim(merge(atoms, count, space), atoms)
    return boxes[np.lexsort(np.round(boxes.reshape(-1, 6).T[::-1], 3))]


def save_hull(path: Path, boxes: Float[np.ndarray, "N 2 3"], title: str = "") -> None:
    """Write boxes as text: one a line, lower x y z and upper x y z in metres, rounded outwards to the millimetre."""
    rows = np.stack([np.floor(boxes[:, 0] * 1e3 + 1e-6), np.ceil(boxes[:, 1] * 1e3 - 1e-6)], axis=1) / 1e3
    lines = [f"# {title or 'collision boxes'}; station frame, m", "# x0,y0,z0,x1,y1,z1"]
    lines += [",".join(f"{v:.3f}" for v in row) for row in rows.reshape(-1, 6)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def load_hull(path: Path | str) -> Float[np.ndarray, "N 2 3"]:
    """Read boxes that `save_hull` or `owm-envs station import` wrote.

    Args:
        path: a text file of six numbers a line: lower x, y, z, upper x, y, z [m], station frame; # starts a comment.

    Returns:
        (N, 2, 3) float64 lower and upper corners [m].

    Raises:
        ValueError: the file is missing, empty, not such a table, or holds a box whose corners are out of order.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"hull: cannot read {path}: {error}") from None
    rows = [line.split("#")[0].strip() for line in text.splitlines()]
    try:
        boxes = np.array([[float(v) for v in row.split(",")] for row in rows if row], np.float64).reshape(-1, 2, 3)
    except ValueError:
        raise ValueError(f"hull: {path} must hold six numbers a line, x0,y0,z0,x1,y1,z1") from None
    if len(boxes) == 0 or not np.isfinite(boxes).all() or not np.all(boxes[:, 1] > boxes[:, 0]):
        raise ValueError(f"hull: {path} must hold at least one box, finite, lower corner below the upper one")
    return boxes


@functools.cache
def _hull() -> Float[np.ndarray, "N 2 3"]:
    return load_hull(_KEPT)


def hull_boxes() -> Float[np.ndarray, "N 2 3"]:
    """Give the station's collision boxes.

    Returns:
        (313, 2, 3) float64 lower and upper corners [m], station frame; a fresh array.
    """
    return _hull().copy()


class HullQuality(NamedTuple):
    """How well boxes stand for parts; all lengths in metres."""

    boxes: int
    covered: float
    """Share of the parts' surface samples inside the boxes."""
    excess_mean: float
    """Distance from the union's outer surface to the nearest part, mean over its area."""
    excess_p99: float
    excess_max: float
    reach: float
    """Farthest corner from the origin."""


def hull_quality(
    boxes: Float[np.ndarray, "N 2 3"], parts: tuple[Part, ...] = PARTS, samples: int = 20_000, seed: int = 0
) -> HullQuality:
    """Measure coverage and excess of boxes against the exact parts.

    Args:
        boxes: (N, 2, 3) corners [m], station frame.
        parts: the table, station frame.
        samples: points on the faces of the boxes, uniform by area; those inside another box are dropped.
        seed: of the draws.
    """
    rng = np.random.default_rng(seed)
    surface = np.concatenate([sample_surface(part, max(samples // 100, 50), rng) for part in parts])
    excess = np.maximum(nearest_part(parts, outer_samples(boxes, samples, rng))[0], 0.0)
    return HullQuality(
        len(boxes),
        float(np.mean(distance_to(boxes, surface) <= 1e-6)),
        float(excess.mean()),
        float(np.quantile(excess, 0.99)),
        float(excess.max()),
        float(np.linalg.norm(np.abs(boxes).max(axis=1), axis=-1).max()),
    )
