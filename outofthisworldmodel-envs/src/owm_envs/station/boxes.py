"""Axis-aligned boxes around solids: cover each part finely, then merge to a requested number with little added volume.

A box is a pair of corners, lower and upper, in metres. The measure of a merge is the empty volume it takes in as a
chaser feels it: volume where the centre of its bounding sphere could have been. So boxes and solids are both grown by
the sphere's reach before they are compared, and a sliver counts as much as it blocks. Each cubic metre is weighted by
how much it would be missed; a summed-volume table gives the sum for any box in constant time.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from owm_envs.station.geometry import ROUND, bounds, rotation
from owm_envs.station.primitives import Part

Boxes = Float[np.ndarray, "N 2 3"]
_NEIGHBOURS = 48  # partners tried for a box: those with the least gap


# ---------------------------------------------------------------- cover


def cover(part: Part, step: float = 1.0) -> Boxes:
    """Cover one part finely by boxes, none of whose points is missed.

    Args:
        part: a row of the table.
        step: longest slice [m] of what lies askew; round parts along a frame axis are cut in strips.

    Returns:
        (n, 2, 3) lower and upper corners [m] in the table's frame; they touch or overlap slightly.
    """
    if part.primitive == "sphere":
        return _ball_boxes(part)
    if part.primitive in ROUND:
        aligned = max(map(abs, part.axis)) > 1.0 - 1e-9
        return _round_boxes(part) if aligned else _slices(part, (1, 1, _count(part.dimensions[2], step)))
    columns = np.abs(rotation(part)).max(axis=0)
    straight = columns > 1.0 - 1e-9
    return _slices(part, tuple(1 if s else _count(d, step) for s, d in zip(straight, part.dimensions)))


def _count(length: float, step: float) -> int:
    return max(math.ceil(length / step - 1e-9), 1)


def _slices(part: Part, counts: tuple[int, int, int]) -> Boxes:
    """Bounds of equal pieces of a part, cut across its own axes."""
    turn, size = rotation(part), np.asarray(part.dimensions, np.float64)
    steps = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    boxes = []
    for a, b, c in np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3):
        if part.primitive in ROUND:  # a shorter frustum
            ends = [size[0] + (size[1] - size[0]) * (c + 0.5 + s * 0.5 / counts[2]) for s in (-1.0, 1.0)]
            place, piece = turn @ (0.0, 0.0, c * size[2]), (*ends, size[2] / counts[2])
        else:
            place, piece = turn @ (np.array((a, b, c)) * size), tuple(size / counts)
        centre = tuple((np.asarray(part.position) + place).tolist())
        boxes.append(bounds(part._replace(position=centre, dimensions=piece)))
    return np.stack(boxes)


def _strips(radius: float, strips: int) -> list[tuple[float, float, float]]:
    """Strips that cover a disc: lower and upper edge, half-width."""
    edges = radius * np.sin(0.5 * np.pi * (2.0 * np.arange(strips + 1) / strips - 1.0))
    widths = np.sqrt(np.maximum(radius * radius - np.minimum(np.abs(edges[1:]), np.abs(edges[:-1])) ** 2, 0.0))
    widths = np.where(edges[1:] * edges[:-1] < 0.0, radius, widths)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), widths.tolist()))


def _round_boxes(part: Part) -> Boxes:
    """Strips of the cross-section, for a cylinder at once and for a cone slice by slice."""
    axis = int(np.argmax(np.abs(part.axis)))
    first, second = (i for i in range(3) if i != axis)
    d0, d1, length = part.dimensions
    if part.axis[axis] < 0.0:
        d0, d1 = d1, d0
    widest = max(d0, d1)
    strips = 7 if widest > 1.6 else 5 if widest > 0.9 else 3 if widest > 0.6 else 1
    slices = 1 if d0 == d1 else min(max(math.ceil(abs(d1 - d0) / 0.4), 1), 4)
    boxes = []
    for i in range(slices):
        radius = 0.5 * max(d0 + (d1 - d0) * f / slices for f in (i, i + 1))
        for low, high, half in _strips(radius, strips):
            box = np.zeros((2, 3))
            box[:, axis] = (-0.5 * length + length * i / slices, -0.5 * length + length * (i + 1) / slices)
            box[:, first] = (low, high)
            box[:, second] = (-half, half)
            boxes.append(box)
    return np.stack(boxes) + np.asarray(part.position, np.float64)


def _ball_boxes(part: Part) -> Boxes:
    radius = 0.5 * part.dimensions[0]
    layers = _strips(radius, 5 if radius > 0.5 else 1)
    boxes = [[(-half, -half, low), (half, half, high)] for low, high, half in layers]
    return np.asarray(boxes, np.float64) + np.asarray(part.position, np.float64)


# ---------------------------------------------------------------- emptiness


class Emptiness(NamedTuple):
    """A summed-volume table of weighted empty space: how much of it a box takes, by eight look-ups."""

    origin: Float[np.ndarray, "3"]
    spacing: float
    reach: float
    """Boxes are grown by this on all sides [m], as the solids were."""
    table: Float[np.ndarray, "nx ny nz"]
    """Integral of the density from the origin to each node of the grid."""

    def of(self, boxes: Float[np.ndarray, "... 2 3"]) -> Float[np.ndarray, "..."]:
        """Weighted empty volume of grown boxes [m3], exact for a density that is constant in each cell."""
        grown = np.stack([boxes[..., 0, :] - self.reach, boxes[..., 1, :] + self.reach], axis=-2)
        place = (grown - self.origin) / self.spacing
        shape = np.array(self.table.shape)
        cell = np.clip(place.astype(np.int64), 0, shape - 2)
        part = np.clip(place - cell, 0.0, 1.0)
        flat = self.table.reshape(-1)
        stride = (shape[1] * shape[2], shape[2], 1)
        # For each corner of the box eight nodes; along an axis the four look-ups are (end, node) with these weights.
        total = 0.0
        index = [[cell[..., e, a] * stride[a] for e in (0, 1)] for a in range(3)]
        share = [[(1.0 - part[..., e, a], part[..., e, a]) for e in (0, 1)] for a in range(3)]
        for ex in (0, 1):
            for ey in (0, 1):
                for ez in (0, 1):
                    sign = -1.0 if (ex + ey + ez) % 2 == 0 else 1.0
                    base = index[0][ex] + index[1][ey] + index[2][ez]
                    for i in (0, 1):
                        for j in (0, 1):
                            both = share[0][ex][i] * share[1][ey][j]
                            for k in (0, 1):
                                node = flat[base + i * stride[0] + j * stride[1] + k]
                                total = total + sign * both * share[2][ez][k] * node
        return total


class Grid(NamedTuple):
    """Cubic cells around some boxes, with room to grow them."""

    origin: Float[np.ndarray, "3"]
    spacing: float
    cells: int
    """How many cells solids and boxes are grown by."""
    shape: tuple[int, int, int]

    def centres(self) -> list[np.ndarray]:
        """Coordinates of the cells' centres along each axis [m]."""
        return [start + self.spacing * (np.arange(n) + 0.5) for start, n in zip(self.origin, self.shape)]


def grid_around(boxes: Boxes, spacing: float, reach: float) -> Grid:
    """Lay a grid around boxes; `reach` is rounded to whole cells."""
    cells = round(reach / spacing)
    origin = np.floor(boxes[:, 0].min(axis=0) / spacing) * spacing - (cells + 1) * spacing
    size = np.ceil((boxes[:, 1].max(axis=0) - origin) / spacing).astype(int) + cells + 1
    return Grid(origin, spacing, cells, tuple(size.tolist()))


def emptiness(
    occupancy: Float[np.ndarray, "nx ny nz"], grid: Grid, weight: Float[np.ndarray, "nx ny nz"] | float = 1.0
) -> Emptiness:
    """Sum up the weighted empty space of a grid, of which solids and what is too near to them are no part.

    Args:
        occupancy: share of each cell that is solid, 0 to 1.
        grid: its place.
        weight: how much a cubic metre of each cell counts.
    """
    grown = occupancy.copy()
    for axis in range(3):
        still = np.moveaxis(grown.copy(), axis, 0)
        moving = np.moveaxis(grown, axis, 0)
        for shift in range(1, grid.cells + 1):
            np.maximum(moving[shift:], still[:-shift], out=moving[shift:])
            np.maximum(moving[:-shift], still[shift:], out=moving[:-shift])
    density = (1.0 - grown) * weight * grid.spacing**3
    table = np.zeros(tuple(n + 1 for n in grid.shape))
    table[1:, 1:, 1:] = density.cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    return Emptiness(np.asarray(grid.origin, np.float64), grid.spacing, grid.cells * grid.spacing, table)


def occupancy_of(boxes: Boxes, grid: Grid) -> Float[np.ndarray, "nx ny nz"]:
    """Share of each cell of a grid that boxes fill, their overlaps counted once at most where a cell is full."""
    shape = grid.shape
    filled = np.zeros(shape)
    for lower, upper in (boxes - grid.origin) / grid.spacing:
        first = np.maximum(np.floor(lower).astype(int), 0)
        last = np.minimum(np.ceil(upper).astype(int), shape)
        edges = [np.arange(a, b) for a, b in zip(first, last)]
        x, y, z = (np.minimum(e + 1.0, high) - np.maximum(e, low) for e, low, high in zip(edges, lower, upper))
        cut = tuple(slice(a, b) for a, b in zip(first, last))
        filled[cut] = np.minimum(filled[cut] + x[:, None, None] * y[:, None] * z, 1.0)
    return filled


# ---------------------------------------------------------------- merge


def merge(boxes: Boxes, count: int, space: Emptiness, progress: Callable[[int, int], None] | None = None) -> Boxes:
    """Merge boxes pairwise until `count` are left, each time the pair whose common box adds least empty space.

    Every given box ends up whole inside one of the result's boxes. Costs are compared after rounding to a millionth,
    ties go to the lower index, and only elementary arithmetic is used, so every machine finds the same boxes.

    Args:
        boxes: (N, 2, 3) boxes that together cover what must stay covered.
        count: number of boxes to return.
        space: what merging should avoid.
        progress: called with the number of boxes left and `count`.

    Returns:
        (count, 2, 3) boxes, or fewer if fewer were given.

    Raises:
        ValueError: no boxes, or a count below 1.
    """
    boxes = np.array(boxes, np.float64)
    if len(boxes) == 0 or count < 1:
        raise ValueError(f"needs at least one box and a count of at least 1; got {len(boxes)} boxes, count {count}")
    alive = np.ones(len(boxes), bool)
    empty = np.round(space.of(boxes), 6)
    price, partner = np.full(len(boxes), np.inf), np.full(len(boxes), -1)

    def look_around(i: int) -> tuple[np.ndarray, np.ndarray]:
        """The nearest other boxes, and the price of merging with each."""
        others = np.flatnonzero(alive)
        gap = np.maximum(np.maximum(boxes[others, 0] - boxes[i, 1], boxes[i, 0] - boxes[others, 1]), 0.0)
        gap = gap[:, 0] + gap[:, 1] + gap[:, 2]
        gap[np.searchsorted(others, i)] = np.inf
        others = others[np.argsort(gap, kind="stable")[:_NEIGHBOURS]] if len(others) > _NEIGHBOURS else others
        others = others[others != i]
        union = np.stack([np.minimum(boxes[i, 0], boxes[others, 0]), np.maximum(boxes[i, 1], boxes[others, 1])], axis=1)
        return others, np.round(space.of(union) - empty[i] - empty[others], 6)

    def settle(i: int) -> None:
        others, prices = look_around(i)
        best = np.lexsort((others, prices))[0]
        price[i], partner[i] = prices[best], others[best]

    left = len(boxes)
    for i in range(left if left > count else 0):
        settle(i)
    while left > count:
        i = int(np.argmin(price))
        j = int(partner[i])
        i, j = min(i, j), max(i, j)
        boxes[i] = np.minimum(boxes[i, 0], boxes[j, 0]), np.maximum(boxes[i, 1], boxes[j, 1])
        empty[i] = np.round(space.of(boxes[i]), 6)
        inside = alive & np.all((boxes[:, 0] >= boxes[i, 0]) & (boxes[:, 1] <= boxes[i, 1]), axis=1)
        inside[[i, j]] = False
        gone = [j, *np.flatnonzero(inside)[: left - 1 - count].tolist()]
        alive[gone], price[gone] = False, np.inf
        left -= len(gone)
        if left <= count:
            break
        stale = np.flatnonzero(alive & (np.isin(partner, gone) | (partner == i)))
        for k in {i, *stale.tolist()}:
            settle(k)
        others, prices = look_around(i)
        better = prices < price[others]
        price[others[better]], partner[others[better]] = prices[better], i
        if progress is not None:
            progress(left, count)
    return boxes[alive]


def trim(boxes: Boxes, atoms: Boxes) -> Boxes:
    """Shrink boxes that overlap: each to the atoms that no other box holds.

    Args:
        boxes: (N, 2, 3) boxes; every atom lies whole in at least one.
        atoms: (M, 2, 3) what must stay covered.

    Returns:
        (N, 2, 3) boxes that still hold every atom; one that isn't needed at all keeps its size.
    """
    boxes = boxes.copy()
    holds = np.all((atoms[None, :, 0] >= boxes[:, None, 0]) & (atoms[None, :, 1] <= boxes[:, None, 1]), axis=-1)
    extent = boxes[:, 1] - boxes[:, 0]
    for i in np.argsort(-(extent[:, 0] * extent[:, 1] * extent[:, 2]), kind="stable"):
        own = holds[i] & (holds.sum(axis=0) == 1)
        if own.any():
            boxes[i] = atoms[own, 0].min(axis=0), atoms[own, 1].max(axis=0)
            holds[i] = np.all((atoms[:, 0] >= boxes[i, 0]) & (atoms[:, 1] <= boxes[i, 1]), axis=-1)
    return boxes


# ---------------------------------------------------------------- measure


def outer_samples(boxes: Boxes, count: int, rng: np.random.Generator) -> Float[np.ndarray, "M 3"]:
    """Draw points uniformly by area from the outer surface of a union of boxes.

    Each face is sampled in proportion to its area, and what lies inside another box is dropped; so about `count`
    less the hidden share come back.
    """
    size = boxes[:, 1] - boxes[:, 0]
    area = np.stack([size[:, 1] * size[:, 2], size[:, 0] * size[:, 2], size[:, 0] * size[:, 1]], axis=1)
    weights = np.repeat(area.reshape(-1), 2)
    face = rng.choice(len(weights), count, p=weights / weights.sum())
    owner, axis, end = face // 6, face // 2 % 3, face % 2
    points = boxes[owner, 0] + rng.random((count, 3)) * size[owner]
    rows = np.arange(count)
    points[rows, axis] = boxes[owner, end, axis]
    hidden = np.zeros(count, bool)
    for lower, upper in boxes:
        hidden |= np.all((points > lower + 1e-9) & (points < upper - 1e-9), axis=1)
    return points[~hidden]


def distance_to(boxes: Boxes, points: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M"]:
    """Euclidean distance of points to the nearest box [m], 0 inside."""
    nearest = np.full(len(points), np.inf)
    for lower, upper in boxes:
        gap = np.maximum(np.maximum(lower - points, points - upper), 0.0)
        nearest = np.minimum(nearest, np.einsum("ij,ij->i", gap, gap))
    return np.sqrt(nearest)
