"""The station as the collision test sees it: axis-aligned boxes made from the table of parts."""

import functools
import math

import numpy as np
from jaxtyping import Float

from owm_envs.station.parts import PARTS, Part


def _cylinder_boxes(part: Part) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cover a cylinder or cone frustum along a frame axis by boxes that overlap in a stepped cross-section.

    Box k of n reaches cos(a_k) along one cross axis and sin(a_(k+1)) along the other, a_k = k 90 deg / n, so
    that the union contains the whole disc.
    """
    length, start, end = part.dimensions
    long_axis = int(np.argmax(np.abs(part.axis)))
    cross = [i for i in range(3) if i != long_axis]
    slices = 1 if start == end else 2
    boxes = []
    for i in range(slices):
        ends = [start + (end - start) * f / slices for f in (i, i + 1)]
        radius = 0.5 * max(ends)
        along = [-0.5 * length + length * f / slices for f in (i, i + 1)]
        for k in range(part.boxes):
            half = np.zeros(3)
            half[cross[0]] = radius * math.cos(0.5 * math.pi * k / part.boxes)
            half[cross[1]] = radius * math.sin(0.5 * math.pi * (k + 1) / part.boxes)
            lower, upper = -half, half.copy()
            lower[long_axis], upper[long_axis] = along
            boxes.append((lower, upper))
    return boxes


def _panel_boxes(part: Part) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cover a thin plate, tilted about x, by a flight of tiles along its axis."""
    length, width, thickness = part.dimensions
    _, along_y, along_z = part.axis
    half = 0.5 * np.array(
        [
            width,
            abs(along_y) * length / part.boxes + abs(along_z) * thickness,
            abs(along_z) * length / part.boxes + abs(along_y) * thickness,
        ]
    )
    steps = (np.arange(part.boxes) + 0.5) / part.boxes - 0.5
    return [(centre - half, centre + half) for centre in steps[:, None] * length * np.array(part.axis)]


def part_boxes(part: Part) -> Float[np.ndarray, "n 2 3"]:
    """Give the axis-aligned boxes that cover one part.

    Args:
        part: a row of `PARTS`.

    Returns:
        (n, 2, 3) float64 lower and upper corners [m], station frame.
    """
    if part.primitive == "box":
        half = 0.5 * np.asarray(part.dimensions)
        boxes = [(-half, half)]
    else:
        boxes = _cylinder_boxes(part) if part.primitive == "cylinder" else _panel_boxes(part)
    return np.asarray(boxes, np.float64) + np.asarray(part.position, np.float64)


@functools.cache
def _hull() -> Float[np.ndarray, "n 2 3"]:
    return np.concatenate([part_boxes(part) for part in PARTS])


def hull_boxes() -> Float[np.ndarray, "n 2 3"]:
    """Give the station's collision boxes.

    Returns:
        (N, 2, 3) float64 lower and upper corners [m], station frame; a fresh array.
    """
    return _hull().copy()
