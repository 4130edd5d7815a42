"""Exact geometry of the primitives in NumPy: distance, bounds, surface samples."""

import numpy as np
from jaxtyping import Float

from owm_envs.station.primitives import Part

ROUND = ("cylinder", "cone")


def rotation(part: Part) -> Float[np.ndarray, "3 3"]:
    """Give the rotation from the part's frame to the table's frame; columns are local x, y, z."""
    axis, side = np.asarray(part.axis, np.float64), np.asarray(part.side, np.float64)
    return np.stack([side, np.cross(axis, side), axis], axis=1)


def bounds(part: Part) -> Float[np.ndarray, "2 3"]:
    """Give the smallest axis-aligned box around a part.

    Returns:
        (2, 3) float64 lower and upper corners [m], exact for every primitive and pose.
    """
    centre, size = np.asarray(part.position, np.float64), np.asarray(part.dimensions, np.float64)
    if part.primitive == "sphere":
        return centre + 0.5 * np.outer((-1.0, 1.0), size)
    if part.primitive in ROUND:
        axis = np.asarray(part.axis, np.float64)
        rim = 0.5 * np.sqrt(np.maximum(1.0 - axis * axis, 0.0))  # reach of a disc of diameter 1 normal to the axis
        ends = [centre + s * 0.5 * size[2] * axis for s in (-1.0, 1.0)]
        discs = np.stack([end + s * d * rim for end, d in zip(ends, size[:2]) for s in (-1.0, 1.0)])
        return np.stack([discs.min(axis=0), discs.max(axis=0)])
    half = 0.5 * np.abs(rotation(part)) @ size
    return np.stack([centre - half, centre + half])


def signed_distance(part: Part, points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
    """Give the Euclidean distance of points to a part's surface, negative inside.

    Args:
        part: a row of the table.
        points: (..., 3) places in the table's frame [m].

    Returns:
        (...) float64 [m], exact for every primitive.
    """
    size = np.asarray(part.dimensions, np.float64)
    local = (np.asarray(points, np.float64) - np.asarray(part.position, np.float64)) @ rotation(part)
    if part.primitive == "sphere":
        return np.linalg.norm(local, axis=-1) - 0.5 * size[0]
    if part.primitive in ROUND:
        return _frustum_distance(np.hypot(local[..., 0], local[..., 1]), local[..., 2], *(0.5 * size))
    gap = np.abs(local) - 0.5 * size
    return np.linalg.norm(np.maximum(gap, 0.0), axis=-1) + np.minimum(gap.max(axis=-1), 0.0)


def _frustum_distance(rho: np.ndarray, height: np.ndarray, r0: float, r1: float, half: float) -> np.ndarray:
    """Distance in the half plane (distance from the axis, height) to a trapezoid, negative inside."""
    inside = (np.abs(height) <= half) & (rho <= 0.5 * (r0 + r1) + 0.5 * (r1 - r0) * height / half)
    edges = [((0.0, -half), (r0, -half)), ((r0, -half), (r1, half)), ((r1, half), (0.0, half))]
    distance = np.full(np.shape(rho), np.inf)
    for (a0, a1), (b0, b1) in edges:
        u, v = b0 - a0, b1 - a1
        along = np.clip(((rho - a0) * u + (height - a1) * v) / max(u * u + v * v, 1e-300), 0.0, 1.0)
        distance = np.minimum(distance, np.hypot(rho - a0 - along * u, height - a1 - along * v))
    return np.where(inside, -distance, distance)


def nearest_part(
    parts: tuple[Part, ...], points: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "N"], np.ndarray]:
    """Give the signed distance of points to the nearest of some parts, and which part that is.

    Args:
        parts: rows of a table; at least one.
        points: (N, 3) places in the table's frame [m].

    Returns:
        (N,) distance [m], the least of the parts' signed distances, and the (N,) index of that part.
    """
    points = np.asarray(points, np.float64)
    best, owner = np.full(len(points), np.inf), np.zeros(len(points), np.intp)
    for index, part in enumerate(parts):
        lower, upper = bounds(part)
        gap = np.maximum(np.maximum(lower - points, points - upper), 0.0)
        near = np.flatnonzero(np.einsum("ij,ij->i", gap, gap) < np.where(best > 0.0, best * best, 1e-18))
        found = signed_distance(part, points[near])
        closer = found < best[near]
        best[near[closer]], owner[near[closer]] = found[closer], index
    return best, owner


def sample_surface(part: Part, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count 3"]:
    """Draw points uniformly by area from a part's surface.

    Returns:
        (count, 3) places in the table's frame [m].
    """
    size = np.asarray(part.dimensions, np.float64)
    if part.primitive == "sphere":
        local = rng.normal(size=(count, 3))
        local *= 0.5 * size[0] / np.linalg.norm(local, axis=1, keepdims=True)
    elif part.primitive in ROUND:
        r0, r1, half = 0.5 * size
        area = np.array([r0 * r0, r1 * r1, (r0 + r1) * np.hypot(2.0 * half, r1 - r0)])
        face = rng.choice(3, count, p=area / area.sum())
        u = rng.random(count)
        span = r0 + r1
        # Along the mantle the density grows with the radius.
        t = u if r0 == r1 else (np.sqrt(r0 * r0 + u * (r1 - r0) * span) - r0) / (r1 - r0)
        radius = np.choose(face, [r0 * np.sqrt(u), r1 * np.sqrt(u), r0 + (r1 - r0) * t])
        height = np.choose(face, [-half, half, half * (2.0 * t - 1.0)])
        turn = rng.uniform(0.0, 2.0 * np.pi, count)
        local = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
    else:
        area = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
        face = rng.choice(3, count, p=area / area.sum())
        local = rng.uniform(-0.5, 0.5, (count, 3))
        local[np.arange(count), face] = np.where(rng.random(count) < 0.5, -0.5, 0.5)
        local *= size
    return local @ rotation(part).T + np.asarray(part.position, np.float64)
