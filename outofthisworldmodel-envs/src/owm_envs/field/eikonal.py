"""The eikonal solver behind the geodesic field: grids, speeds, upwind relaxation and far continuation.

Near the hull phi lives on a fine grid, where nodes that see the goal through open space hold the exact
distance and the others follow from Godunov's upwind scheme. The fine grid's box is convex; its rim and
everything beyond are open: there phi is exactly the least of phi(s) + |x - s| over the part of the rim
that x sees (Hopf-Lax), kept on a coarse grid whose nodes fall on the fine grid's faces.

Source: E. Rouy, A. Tourin, "A viscosity solutions approach to shape-from-shading", SIAM J. Numer. Anal. 29
(1992), for the upwind scheme.
"""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

_UNREACHED = 1.0e4  # larger than any phi; its square still fits float32 easily


@dataclass(frozen=True)
class FieldConfig:
    """The numbers that shape the field (static; metres and degrees where named so)."""

    fine_spacing: float = 1.0
    coarse_spacing: float = 8.0
    extent: float = 260.0
    """The coarse grid reaches at least this far from the origin along each axis."""
    slow_distance: float = 4.0
    """The speed falls within this distance of a touching sphere."""
    touching_speed: float = 0.15
    inside_speed: float = 0.02
    cone_half_angle_deg: float = 35.0
    cone_length: float = 20.0
    """Inside this cone about the port normal the speed is 1 however near the hull is."""
    side_half_angle_deg: float = 60.0
    side_range: tuple[float, float] = (3.0, 12.0)
    side_speed: float = 0.3
    """Outside the side cone, at these distances from the goal, the speed is at most this."""
    exact_radius: float = 3.0
    """Within this distance of the goal phi is the straight distance."""
    tolerance: float = 1.0e-3
    """The relaxation stops once eight iterations change no node by more than this [m]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if any(isinstance(n, bool) or not 1e-6 <= n <= 1e4 for n in (value if name == "side_range" else (value,))):
                raise ValueError(f"{name} must be from 1e-6 to 1e4; got {value}")
        if self.fine_spacing < 0.1 or self.extent > 500 * self.coarse_spacing:
            raise ValueError(
                "fine_spacing must be at least 0.1 m and coarse_spacing a 500th of extent, for their nodes to fit into "
                f"memory; got {self.fine_spacing}, {self.coarse_spacing} and {self.extent}"
            )
        ratio = self.coarse_spacing / self.fine_spacing
        if self.fine_spacing <= 0.0 or ratio < 1.0 or not math.isclose(ratio, round(ratio)):
            raise ValueError(
                "coarse_spacing must be a whole multiple of fine_spacing > 0; "
                f"got {self.coarse_spacing} and {self.fine_spacing}"
            )


class Grid(NamedTuple):
    origin: tuple[float, float, float]
    spacing: float
    shape: tuple[int, int, int]

    def axes(self) -> list[np.ndarray]:
        return [np.float32(o) + np.float32(self.spacing) * np.arange(n, dtype=np.float32)
                for o, n in zip(self.origin, self.shape)]  # fmt: skip

    def points(self) -> np.ndarray:
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1)


def grid_layout(
    boxes: Float[np.ndarray, "N 2 3"],
    goals: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    sphere_radius: float,
    config: FieldConfig,
) -> tuple[Grid, Grid]:
    """Place the fine grid over all slow space, and the coarse grid with nodes on the fine grid's faces.

    Args:
        boxes: (N, 2, 3) hull boxes [m], station frame.
        goals: (P, 3) goal positions [m], station frame.
        normals: (P, 3) outward unit normals of the ports.
        sphere_radius: radius of the chaser's bounding sphere [m].
        config: the field's numbers.

    Returns:
        The fine and the coarse grid.
    """
    reach = sphere_radius + config.slow_distance
    # How far the slow shell around a goal reaches along each half-axis: it has a hole, the side cone.
    side = math.radians(config.side_half_angle_deg)
    tilt = np.arccos(np.clip(np.concatenate([normals, -normals], axis=1), -1.0, 1.0))  # (P, 6)
    shell = config.side_range[1] * np.where(tilt >= side, 1.0, np.cos(side - tilt))
    shell = np.maximum(shell, config.exact_radius)
    lower = np.concatenate([boxes[:, 0] - reach, goals - shell[:, 3:]]).min(axis=0)
    upper = np.concatenate([boxes[:, 1] + reach, goals + shell[:, :3]]).max(axis=0)
    step = config.coarse_spacing
    cells = np.ceil((upper - lower) / step - 1e-9).astype(int)
    origin = 0.5 * (lower + upper) - 0.5 * cells * step
    below = np.ceil(np.maximum(config.extent + origin, step) / step).astype(int)
    above = np.ceil(np.maximum(config.extent - (origin + cells * step), step) / step).astype(int)
    ratio = round(step / config.fine_spacing)
    fine = Grid(tuple(origin.tolist()), config.fine_spacing, tuple((cells * ratio + 1).tolist()))
    coarse = Grid(tuple((origin - below * step).tolist()), step, tuple((cells + below + above + 1).tolist()))
    return fine, coarse


@functools.partial(jax.jit, static_argnames="grid")
def grid_clearance(boxes: Float[Array, "N 2 3"], sphere_radius: float, grid: Grid) -> Float[Array, "..."]:
    """Exact signed distance from every node to the union of the boxes, less the sphere's radius."""
    x, y, z = (jnp.asarray(a) for a in grid.axes())

    def nearer(best, box):
        dx, dy, dz = (jnp.maximum(box[0, i] - a, a - box[1, i]) for i, a in enumerate((x, y, z)))
        dx, dy, dz = dx[:, None, None], dy[None, :, None], dz[None, None, :]
        outside = jnp.sqrt(sum(jnp.maximum(d, 0.0) ** 2 for d in (dx, dy, dz)))
        inside = jnp.minimum(jnp.maximum(jnp.maximum(dx, dy), dz), 0.0)
        return jnp.minimum(best, outside + inside), None

    far = jnp.full(grid.shape, _UNREACHED, dtype=jnp.float32)
    return jax.lax.scan(nearer, far, boxes)[0] - sphere_radius


def _speed(points: Array, clearance: Array, goal: Array, normal: Array, config: FieldConfig) -> Array:
    """Speed at points (..., 3) whose clearance is `clearance`."""
    offset = points - goal
    distance = jnp.sqrt(jnp.sum(offset**2, axis=-1))
    along = offset @ normal
    slope = (1.0 - config.touching_speed) / config.slow_distance
    open_space = jnp.clip(config.touching_speed + slope * clearance, config.touching_speed, 1.0)
    beside = along < math.cos(math.radians(config.side_half_angle_deg)) * distance
    near = (distance > config.side_range[0]) & (distance < config.side_range[1])
    speed = jnp.where(beside & near, jnp.minimum(open_space, config.side_speed), open_space)
    corridor = (along > math.cos(math.radians(config.cone_half_angle_deg)) * distance) & (distance < config.cone_length)
    speed = jnp.where(corridor | (distance < config.exact_radius), 1.0, speed)
    return jnp.where(clearance < 0.0, config.inside_speed, speed)


def _godunov(phi: Array, cost: Array) -> Array:
    """One upwind update of all nodes; `cost` is spacing over speed."""
    padded = jnp.pad(phi, 1, constant_values=_UNREACHED)
    mid = slice(1, -1)
    a = jnp.minimum(padded[:-2, mid, mid], padded[2:, mid, mid])
    b = jnp.minimum(padded[mid, :-2, mid], padded[mid, 2:, mid])
    c = jnp.minimum(padded[mid, mid, :-2], padded[mid, mid, 2:])
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    low, high, middle = jnp.minimum(low, c), jnp.maximum(high, c), jnp.maximum(low, jnp.minimum(high, c))
    d, e = middle - low, high - low  # relative to the lowest, to keep float32's digits
    one = cost
    two = 0.5 * (d + jnp.sqrt(jnp.maximum(2.0 * cost**2 - d**2, 0.0)))
    three = (d + e + jnp.sqrt(jnp.maximum((d + e) ** 2 - 3.0 * (d**2 + e**2 - cost**2), 0.0))) / 3.0
    step = jnp.where(one <= d, one, jnp.where(two <= e, two, three))
    return jnp.minimum(phi, low + step)


@functools.partial(jax.jit, static_argnames=("grid", "config"))
def solve_fine(clearance: Array, goal: Array, normal: Array, grid: Grid, config: FieldConfig) -> Array:
    """phi on the fine grid."""
    points = jnp.asarray(grid.points())
    speed = _speed(points, clearance, goal, normal, config)
    is_open = (speed >= 1.0).reshape(-1)
    offset = points - goal
    distance = jnp.sqrt(jnp.sum(offset**2, axis=-1))

    # Nodes that see the goal through open space hold the exact distance: no smaller value is possible.
    samples = math.ceil(grid.spacing * math.dist(grid.shape, (0, 0, 0)) / (1.5 * grid.spacing))
    start, step = (goal - jnp.asarray(grid.origin, dtype=clearance.dtype)) / grid.spacing, offset / grid.spacing
    strides = jnp.asarray([grid.shape[1] * grid.shape[2], grid.shape[2], 1], dtype=jnp.int32)

    def look(k, seen):
        nearest = jnp.round(start + step * ((k + 1.0) / samples).astype(clearance.dtype)).astype(jnp.int32)
        return seen & is_open[jnp.sum(nearest * strides, axis=-1)]

    seen = jax.lax.fori_loop(0, samples, look, jnp.ones(grid.shape, dtype=bool))
    phi = jnp.where(seen | (distance < 1.8 * grid.spacing), distance, _UNREACHED)
    cost = grid.spacing / speed

    def advance(carry):
        phi, _ = carry
        new = jax.lax.fori_loop(0, 8, lambda _, p: _godunov(p, cost), phi)
        return new, jnp.max(phi - new)

    return jax.lax.while_loop(
        lambda carry: carry[1] > config.tolerance, advance, (phi, jnp.asarray(_UNREACHED, dtype=phi.dtype))
    )[0]


def _faces(grid: Grid, stride: int) -> list[np.ndarray]:
    """Flat indices of every stride-th node of each face of a grid: lower and upper x, then y, then z."""
    faces = []
    for axis, count in enumerate(grid.shape):
        for end in (0, count - 1):
            lines = [np.array([end]) if i == axis else np.arange(0, n, stride) for i, n in enumerate(grid.shape)]
            faces.append(np.ravel_multi_index(np.meshgrid(*lines, indexing="ij"), grid.shape).reshape(-1))
    return faces


@jax.jit
def _least_sum(
    targets: Float[Array, "B K 3"], beyond: Bool[Array, "B K 6"], sources: list[Array], phi: list[Array]
) -> Float[Array, "B K"]:
    """The least of phi(s) + |x - s| over the nodes of the faces that x lies beyond, one block at a time."""

    def block(target):
        x, outer = target
        least = jnp.full(x.shape[:1], _UNREACHED, dtype=x.dtype)
        for face, (place, value) in enumerate(zip(sources, phi)):
            square = sum((x[:, None, i] - place[None, :, i]) ** 2 for i in range(3))
            candidate = jnp.min(jnp.sqrt(square) + value, axis=1)
            least = jnp.where(outer[:, face], jnp.minimum(least, candidate), least)
        return least

    return jax.lax.map(block, (targets, beyond))


def _hopf_lax(targets: np.ndarray, phi_fine: np.ndarray, fine: Grid, stride: int) -> np.ndarray:
    """phi at targets (K, 3) outside the fine grid, by straight lines that do not cut through it."""
    lower, upper = (np.array(corner) for corner in (fine.points()[0, 0, 0], fine.points()[-1, -1, -1]))
    beyond = np.stack([targets < lower, targets > upper], axis=-1).reshape(-1, 6)
    blocks = -(-len(targets) // 256)
    pad = ((0, blocks * 256 - len(targets)), (0, 0))
    places, values = fine.points().reshape(-1, 3), phi_fine.reshape(-1)
    faces = _faces(fine, stride)
    least = _least_sum(
        jnp.asarray(np.pad(targets, pad).reshape(blocks, 256, 3), dtype=jnp.float32),
        jnp.asarray(np.pad(beyond, pad).reshape(blocks, 256, 6)),
        [jnp.asarray(places[face]) for face in faces],
        [jnp.asarray(values[face]) for face in faces],
    )
    return np.asarray(least).reshape(-1)[: len(targets)]


def _trilinear(values: np.ndarray, grid: Grid, points: np.ndarray) -> np.ndarray:
    """Interpolate node values (nx, ny, nz) at points (K, 3) inside a grid."""
    scaled = (points - np.array(grid.origin)) / grid.spacing
    cell = np.clip(scaled.astype(int), 0, np.array(grid.shape) - 2)
    fraction = scaled - cell
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, fraction, 1.0 - fraction), axis=-1)
        total += weight * values[tuple((cell + corner).T)]
    return total


def shared_nodes(fine: Grid, coarse: Grid) -> tuple[tuple[slice, slice, slice], int]:
    """Where the coarse grid's nodes lie in the fine grid: their slices, and the step between them there."""
    ratio = round(coarse.spacing / fine.spacing)
    first = np.round((np.array(fine.origin) - np.array(coarse.origin)) / coarse.spacing).astype(int)
    return tuple(slice(i, i + (n - 1) // ratio + 1) for i, n in zip(first, fine.shape)), ratio


def solve_coarse(phi_fine: np.ndarray, goal: np.ndarray, fine: Grid, coarse: Grid) -> np.ndarray:
    """phi on the coarse grid (mx, my, mz), from phi on the fine grid's rim."""
    core, ratio = shared_nodes(fine, coarse)
    points = coarse.points().astype(np.float64)
    lower = np.array(fine.origin)
    upper = lower + fine.spacing * (np.array(fine.shape) - 1)
    gap = np.linalg.norm(np.maximum(np.maximum(lower - points, points - upper), 0.0), axis=-1)
    outside, far = gap > 1e-3, gap >= 4.0 * coarse.spacing
    phi = np.zeros(coarse.shape)
    # Sampling the rim errs by (half a stride)^2 / gap: a closer look where the gap is small.
    for chosen, stride in ((outside & ~far, max(ratio // 4, 1)), (far, max(ratio // 2, 1))):
        phi[chosen] = _hopf_lax(points[chosen], phi_fine, fine, stride)
    # The straight way to the goal, through the very point where it enters the fine grid.
    ray = points[outside] - goal
    extent = np.where(ray > 0.0, upper - goal, goal - lower)
    entry = goal + ray * np.min(extent / np.maximum(np.abs(ray), 1e-9), axis=-1, keepdims=True)
    straight = np.linalg.norm(entry - goal, axis=-1)
    detour = _trilinear(phi_fine - np.linalg.norm(fine.points() - goal, axis=-1), fine, entry)
    phi[outside] = np.minimum(phi[outside], detour + straight + np.linalg.norm(points[outside] - entry, axis=-1))
    phi[core] = phi_fine[::ratio, ::ratio, ::ratio]
    return phi


def close_seam(on_fine: np.ndarray, on_coarse: np.ndarray, fine: Grid, coarse: Grid) -> np.ndarray:
    """Bend values near the fine grid's rim to meet the coarse grid's interpolation without a step."""
    width = 8
    index = np.stack(np.meshgrid(*(np.arange(n) for n in fine.shape), indexing="ij"), axis=-1)
    last = np.array(fine.shape) - 1
    depths = np.concatenate([index, last - index], axis=-1)
    shell = depths.min(axis=-1) < width
    face = depths[shell].argmin(axis=-1)
    on_rim = index[shell]
    rows = np.arange(len(on_rim))
    on_rim[rows, face % 3] = np.where(face < 3, 0, last[face % 3])
    flat = np.ravel_multi_index(tuple(on_rim.T), fine.shape)
    rim, place = np.unique(flat, return_inverse=True)
    points = fine.points().reshape(-1, 3)[rim]
    step = (_trilinear(on_coarse, coarse, points) - on_fine.reshape(-1)[rim])[place]
    ramp = 1.0 - depths[shell].min(axis=-1) / width
    bent = on_fine.copy()
    bent[shell] += (step * ramp * ramp * (3.0 - 2.0 * ramp)).astype(on_fine.dtype)
    return bent
