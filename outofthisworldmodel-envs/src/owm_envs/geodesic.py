"""The geodesic cost-to-go: how far it is to a docking port along the safest short way around the hull.

phi solves the eikonal equation |grad phi| = 1 / speed with phi = 0 at the goal. The speed is 1 in the open and
falls near the hull, so that -grad phi leads around the station with room to spare and into the approach corridor.

Near the hull phi lives on a fine grid, where nodes that see the goal through open space hold the exact distance
and the others follow from Godunov's upwind scheme. The fine grid's box is convex, its rim is open space and so is
everything beyond: there phi is exactly the least of phi(s) + |x - s| over the rim (Hopf-Lax), kept on a coarse
grid whose nodes fall on the fine grid's faces.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

_UNREACHED = 1.0e4  # larger than any phi; its square still fits float32 with room


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
        ratio = self.coarse_spacing / self.fine_spacing
        if self.fine_spacing <= 0.0 or ratio < 1.0 or not math.isclose(ratio, round(ratio)):
            raise ValueError(
                "coarse_spacing must be a whole multiple of fine_spacing > 0; "
                f"got {self.coarse_spacing} and {self.fine_spacing}"
            )


class GeodesicField(NamedTuple):
    """Cost-to-go and hull clearance at the nodes of two nested grids: fine around the hull, coarse beyond.

    One flat table serves both grids, so that a look-up is eight short gathers whichever grid it falls in.
    """

    nodes: Float[Array, "P M 4"]
    """phi [m] and its gradient, station frame; fine nodes first, then coarse, each in C order."""
    clearances: Float[Array, "M"]
    """Distance of the sphere's surface to the hull [m], negative when it touches; same order."""
    origins: Float[Array, "2 3"]
    """First node of the fine and of the coarse grid [m], station frame."""
    spacings: Float[Array, "2"]
    shapes: Int[Array, "2 3"]
    goals: Float[Array, "P 3"]
    """Goal positions [m], station frame."""

    def _grid(self, values: Array, grid: int) -> Array:
        shape = tuple(int(n) for n in self.shapes[grid])
        split = math.prod(int(n) for n in self.shapes[0])
        part = values[..., :split] if grid == 0 else values[..., split:]
        return part.reshape(*values.shape[:-1], *shape)

    @property
    def phi_fine(self) -> Float[Array, "P nx ny nz"]:
        """phi on the fine grid [m]."""
        return self._grid(self.nodes[..., 0], 0)

    @property
    def phi_coarse(self) -> Float[Array, "P mx my mz"]:
        """phi on the coarse grid [m]."""
        return self._grid(self.nodes[..., 0], 1)

    @property
    def clearance_fine(self) -> Float[Array, "nx ny nz"]:
        """Clearance on the fine grid [m]."""
        return self._grid(self.clearances, 0)

    @property
    def clearance_coarse(self) -> Float[Array, "mx my mz"]:
        """Clearance on the coarse grid [m]."""
        return self._grid(self.clearances, 1)

    fine_origin = property(lambda self: self.origins[0])
    coarse_origin = property(lambda self: self.origins[1])
    fine_spacing = property(lambda self: self.spacings[0])
    coarse_spacing = property(lambda self: self.spacings[1])


# ---------------------------------------------------------------- look-up


def _safe_norm(vector: Float[Array, "3"]) -> tuple[Array, Array]:
    """Norm and unit vector, zero with zero gradient at the origin."""
    square = jnp.sum(vector * vector)
    positive = square > 0.0
    norm = jnp.sqrt(jnp.where(positive, square, 1.0))
    return jnp.where(positive, norm, 0.0), jnp.where(positive, vector / norm, 0.0)


def _corners(field: GeodesicField, position: Float[Array, "3"]) -> tuple[Array, Array, Array]:
    """The eight nodes around a position, their trilinear weights, and how far it lies beyond the grids."""
    upper = field.origins + field.spacings[:, None] * (field.shapes - 1).astype(field.origins.dtype)
    excess = position - jnp.clip(position, field.origins[1], upper[1])
    position = position - excess
    fine = jnp.all((position >= field.origins[0]) & (position <= upper[0]))
    shape = jnp.where(fine, field.shapes[0], field.shapes[1])
    start = jnp.where(fine, 0, jnp.prod(field.shapes[0]))
    scaled = (position - jnp.where(fine, field.origins[0], field.origins[1])) / jnp.where(
        fine, field.spacings[0], field.spacings[1]
    )
    cell = jnp.clip(scaled.astype(field.shapes.dtype), 0, shape - 2)
    upper_weight = scaled - cell.astype(scaled.dtype)
    offsets = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
    index = cell + offsets.astype(np.int32)
    index = start + (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
    weights = jnp.prod(jnp.where(offsets == 1, upper_weight, 1.0 - upper_weight), axis=-1)
    return index, weights, excess


def cost_to_go(
    field: GeodesicField, port_index: Int[Array, ""], position: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Look up the cost-to-go of one position and the direction in which it grows.

    Args:
        field: the solved field.
        port_index: row of the field, an integer; the order of the goals it was solved for.
        position: (3,) centre of the chaser [m], station frame; valid everywhere.

    Returns:
        phi [m], and its (3,) gradient interpolated between nodes: continuous within each grid, finite everywhere.
        Beyond the coarse grid phi grows by the distance to it. Both in the position's dtype.
    """
    position = jnp.asarray(position)
    where_to = position.astype(field.nodes.dtype)
    index, weights, excess = _corners(field, where_to)
    phi, *gradient = weights @ field.nodes[port_index, index]
    gradient = jnp.stack(gradient)
    beyond, outward = _safe_norm(excess)
    phi, gradient = phi + beyond, jnp.where(excess != 0.0, outward, gradient)
    # A grid cannot follow the cone at the goal; the straight distance takes over within two to three cells.
    distance, away = _safe_norm(where_to - field.goals[port_index])
    ramp = jnp.clip(distance / field.spacings[0] - 2.0, 0.0, 1.0)
    blend = ramp * ramp * (3.0 - 2.0 * ramp)
    phi = distance + blend * (phi - distance)
    gradient = away + blend * (gradient - away)
    return phi.astype(position.dtype), gradient.astype(position.dtype)


def clearance(field: GeodesicField, position: Float[Array, "3"]) -> Float[Array, ""]:
    """Look up how far the chaser's bounding sphere is from the hull.

    Args:
        field: the solved field.
        position: (3,) centre of the chaser [m], station frame.

    Returns:
        Distance from the sphere's surface to the nearest box [m] in the position's dtype, negative when they
        touch; beyond the coarse grid the value at its edge, which is never too large.
    """
    position = jnp.asarray(position)
    index, weights, _ = _corners(field, position.astype(field.nodes.dtype))
    return (weights @ field.clearances[index]).astype(position.dtype)


# ---------------------------------------------------------------- solution


class _Grid(NamedTuple):
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
) -> tuple[_Grid, _Grid]:
    """Place the fine grid over all slow space and the coarse grid so that its nodes meet the fine grid's faces.

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
    # How far the slow shell around a goal reaches along each half-axis: nothing of it lies inside the side cone.
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
    fine = _Grid(tuple(origin.tolist()), config.fine_spacing, tuple((cells * ratio + 1).tolist()))
    coarse = _Grid(tuple((origin - below * step).tolist()), step, tuple((cells + below + above + 1).tolist()))
    return fine, coarse


@functools.partial(jax.jit, static_argnames="grid")
def _grid_clearance(boxes: Float[Array, "N 2 3"], sphere_radius: float, grid: _Grid) -> Float[Array, "..."]:
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


def _speed(points: Array, room: Array, goal: Array, normal: Array, config: FieldConfig) -> Array:
    """Speed at points (..., 3) whose clearance is `room`."""
    offset = points - goal
    distance = jnp.sqrt(jnp.sum(offset**2, axis=-1))
    along = offset @ normal
    slope = (1.0 - config.touching_speed) / config.slow_distance
    open_space = jnp.clip(config.touching_speed + slope * room, config.touching_speed, 1.0)
    beside = along < math.cos(math.radians(config.side_half_angle_deg)) * distance
    near = (distance > config.side_range[0]) & (distance < config.side_range[1])
    speed = jnp.where(beside & near, jnp.minimum(open_space, config.side_speed), open_space)
    corridor = (along > math.cos(math.radians(config.cone_half_angle_deg)) * distance) & (
        distance < config.cone_length
    )
    speed = jnp.where(corridor | (distance < config.exact_radius), 1.0, speed)
    return jnp.where(room < 0.0, config.inside_speed, speed)


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
def _solve_fine(room: Array, goal: Array, normal: Array, grid: _Grid, config: FieldConfig) -> Array:
    """phi on the fine grid."""
    points = jnp.asarray(grid.points())
    speed = _speed(points, room, goal, normal, config)
    is_open = (speed >= 1.0).reshape(-1)
    offset = points - goal
    distance = jnp.sqrt(jnp.sum(offset**2, axis=-1))

    # Nodes that see the goal through open space hold the exact distance: no smaller value is possible.
    samples = math.ceil(grid.spacing * math.dist(grid.shape, (0, 0, 0)) / (1.5 * grid.spacing))
    start, step = (goal - jnp.asarray(grid.origin, dtype=room.dtype)) / grid.spacing, offset / grid.spacing
    strides = jnp.asarray([grid.shape[1] * grid.shape[2], grid.shape[2], 1], dtype=jnp.int32)

    def look(k, seen):
        nearest = jnp.round(start + step * ((k + 1.0) / samples).astype(room.dtype)).astype(jnp.int32)
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


def _rim(grid: _Grid, stride: int) -> np.ndarray:
    """Flat indices of every stride-th node on the faces of a grid."""
    index = np.stack(np.meshgrid(*(np.arange(0, n, stride) for n in grid.shape), indexing="ij"), axis=-1)
    on_face = np.any((index == 0) | (index == np.array(grid.shape) - 1), axis=-1)
    return np.ravel_multi_index(tuple(index[on_face].T), grid.shape)


@jax.jit
def _least_sum(targets: Float[Array, "B K 3"], sources: Float[Array, "S 3"], phi: Float[Array, "P S"]) -> Array:
    """The least of phi(s) + |x - s| over the sources, (B, K, P), one block of targets at a time."""

    def block(x):
        square = sum((x[:, None, i] - sources[None, :, i]) ** 2 for i in range(3))
        distance = jnp.sqrt(square)
        return jnp.stack([jnp.min(distance + row, axis=1) for row in phi], axis=1)

    return jax.lax.map(block, targets)


def _hopf_lax(targets: np.ndarray, sources: np.ndarray, phi: np.ndarray) -> np.ndarray:
    blocks = -(-len(targets) // 256)
    padded = np.zeros((blocks * 256, 3), dtype=np.float32)
    padded[: len(targets)] = targets
    least = _least_sum(jnp.asarray(padded.reshape(blocks, 256, 3)), jnp.asarray(sources), jnp.asarray(phi))
    return np.asarray(least).reshape(blocks * 256, -1)[: len(targets)].T


def _trilinear(values: np.ndarray, grid: _Grid, points: np.ndarray) -> np.ndarray:
    """Interpolate node values (nx, ny, nz) at points (K, 3) inside a grid."""
    scaled = (points - np.array(grid.origin)) / grid.spacing
    cell = np.clip(scaled.astype(int), 0, np.array(grid.shape) - 2)
    fraction = scaled - cell
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, fraction, 1.0 - fraction), axis=-1)
        total += weight * values[tuple((cell + corner).T)]
    return total


def _solve_coarse(phi_fine: np.ndarray, goals: np.ndarray, fine: _Grid, coarse: _Grid) -> np.ndarray:
    """phi on the coarse grid, from phi on the fine grid's rim: (P, mx, my, mz)."""
    ratio = round(coarse.spacing / fine.spacing)
    points = coarse.points().astype(np.float64)
    lower = np.array(fine.origin)
    upper = lower + fine.spacing * (np.array(fine.shape) - 1)
    gap = np.linalg.norm(np.maximum(np.maximum(lower - points, points - upper), 0.0), axis=-1)
    phi = np.zeros((len(goals), *coarse.shape))
    rim_points, rim_phi = fine.points().reshape(-1, 3), phi_fine.reshape(len(goals), -1)
    near = 4.0 * coarse.spacing
    # Sampling the rim errs by (half a stride)^2 / gap: a closer look where the gap is small.
    for chosen, stride in (((gap > 1e-3) & (gap < near), max(ratio // 4, 1)), (gap >= near, max(ratio // 2, 1))):
        rim = _rim(fine, stride)
        phi[:, chosen] = _hopf_lax(points[chosen], rim_points[rim], rim_phi[:, rim])
    first = np.round((lower - np.array(coarse.origin)) / coarse.spacing).astype(int)
    core = tuple(slice(i, i + (n - 1) // ratio + 1) for i, n in zip(first, fine.shape))
    outside = gap > 1e-3
    for p, goal in enumerate(goals):
        # The straight way to the goal, through the very point where it enters the fine grid.
        ray = points[outside] - goal
        room = np.where(ray > 0.0, upper - goal, goal - lower)
        entry = goal + ray * np.min(room / np.maximum(np.abs(ray), 1e-9), axis=-1, keepdims=True)
        straight = _trilinear(phi_fine[p], fine, entry) + np.linalg.norm(points[outside] - entry, axis=-1)
        phi[p][outside] = np.minimum(phi[p][outside], straight)
        phi[p][core] = phi_fine[p][::ratio, ::ratio, ::ratio]
    return phi.astype(np.float32)


def _pack(phi_fine: np.ndarray, phi_coarse: np.ndarray, fine: _Grid, coarse: _Grid) -> np.ndarray:
    """Join phi of one port and its central differences into rows (M, 4)."""
    tables = []
    for phi, grid in ((phi_fine, fine), (phi_coarse, coarse)):
        gradient = np.gradient(phi, grid.spacing)
        tables.append(np.stack([phi, *gradient], axis=-1).astype(np.float32))
    ratio = round(coarse.spacing / fine.spacing)
    first = np.round((np.array(fine.origin) - np.array(coarse.origin)) / coarse.spacing).astype(int)
    core = tuple(slice(i, i + (n - 1) // ratio + 1) for i, n in zip(first, fine.shape))
    tables[1][core] = tables[0][::ratio, ::ratio, ::ratio]
    return np.concatenate([table.reshape(-1, 4) for table in tables])
