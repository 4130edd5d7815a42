"""The geodesic cost-to-go: how far it is to a docking port along the safest short way around the hull.

phi solves the eikonal equation |grad phi| = 1 / speed with phi = 0 at the goal. The speed is 1 in the open
and falls near the hull, so that -grad phi leads around the station with room to spare and down the corridor.
`owm_envs.field.eikonal` solves it; this module keeps the solution, on disk and in memory, and looks it up.
"""

import contextlib
import hashlib
import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import platformdirs
from jaxtyping import Array, Float, Int

from owm_envs.field.eikonal import (
    FieldConfig,
    Grid,
    close_seam,
    grid_clearance,
    grid_layout,
    shared_nodes,
    solve_coarse,
    solve_fine,
)
from owm_envs.files import remove, write_atomically
from owm_envs.flags import own_promotion
from owm_envs.shell import terminal
from owm_envs.station import PORT_NAMES, PORTS, goal_poses, hull_boxes, port_index
from owm_envs.station.ports import outward_normals

__all__ = ["FieldConfig", "GeodesicField", "clearance", "cost_to_go", "field_rows", "load_field", "solve_field"]

Progress = Callable[[str, int, int], None]
"""Called with a message, the ports done and the ports to do."""

_VERSION = 3  # of the algorithm: part of every cache key
_SEAL = hashlib.sha256().digest_size  # bytes before a cache file's numbers
_SPHERE_RADIUS = 2.25
_EXACT = jax.lax.Precision.HIGHEST  # accelerators would round the factors


class GeodesicField(NamedTuple):
    """Cost-to-go and hull clearance at the nodes of two nested grids: fine around the hull, coarse beyond.

    One flat table serves both grids, so that a look-up is eight short gathers whichever grid it falls in.
    """

    nodes: Float[Array, "P M 4"]
    """The detour, phi less the straight distance to the goal [m], and its gradient, station frame; fine nodes
    first, then coarse, each in C order. It is smooth, and zero wherever the goal is in open view."""
    clearances: Float[Array, "M"]
    """Distance of the sphere's surface to the hull [m], negative when it touches; same order."""
    origins: Float[Array, "2 3"]
    """First node of the fine and of the coarse grid [m], station frame."""
    spacings: Float[Array, "2"]
    shapes: Int[Array, "2 3"]
    goals: Float[Array, "P 3"]
    """Goal positions [m], station frame."""

    def __repr__(self) -> str:
        return f"GeodesicField({self.goals.shape[0]} ports, {self.nodes.shape[1]} nodes)"

    def _grid(self, values: Array, grid: int) -> Array:
        shape = tuple(int(n) for n in self.shapes[grid])
        split = math.prod(int(n) for n in self.shapes[0])
        part = values[..., :split] if grid == 0 else values[..., split:]
        return part.reshape(*values.shape[:-1], *shape)

    @own_promotion()
    def _phi(self, grid: int) -> Array:
        axes = [self.origins[grid, i] + self.spacings[grid] * jnp.arange(n, dtype=self.origins.dtype)
                for i, n in enumerate(self.shapes[grid].tolist())]  # fmt: skip
        points = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)
        straight = [jnp.linalg.norm(points - goal, axis=-1) for goal in self.goals]
        return jnp.stack(straight) + self._grid(self.nodes[..., 0], grid)

    @property
    def phi_fine(self) -> Float[Array, "P nx ny nz"]:
        """phi on the fine grid [m]; computed anew at each call."""
        return self._phi(0)

    @property
    def phi_coarse(self) -> Float[Array, "P mx my mz"]:
        """phi on the coarse grid [m]; computed anew at each call."""
        return self._phi(1)

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


def _norm_and_direction(vector: Float[Array, "3"]) -> tuple[Array, Array]:
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
    start = jnp.where(fine, 0, jnp.prod(field.shapes[0], dtype=field.shapes.dtype))
    scaled = (position - jnp.where(fine, field.origins[0], field.origins[1])) / jnp.where(
        fine, field.spacings[0], field.spacings[1]
    )
    cell = jnp.clip(scaled.astype(field.shapes.dtype), 0, shape - 2)
    upper_weight = scaled - cell.astype(scaled.dtype)
    offsets = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
    index = cell[None] + offsets.astype(np.int32)
    index = start + (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
    weights = jnp.prod(jnp.where(offsets == 1, upper_weight[None], 1.0 - upper_weight[None]), axis=-1)
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
        phi [m], continuous, and its (3,) gradient, interpolated between nodes: finite everywhere, zero at the
        goal, continuous elsewhere within each grid. Both in the position's dtype.
        Pass the field to compiled functions as an argument: closed over, its 150 MB become a constant.
    """
    position = jnp.asarray(position)
    where_to = position.astype(field.nodes.dtype)
    index, weights, excess = _corners(field, where_to)
    detour, *gradient = jnp.dot(weights, field.nodes[port_index, index], precision=_EXACT)
    # Beyond the coarse grid the detour stays what it is at the edge.
    gradient = jnp.where(excess == 0.0, jnp.stack(gradient), 0.0)
    distance, away = _norm_and_direction(where_to - field.goals[port_index])
    phi, gradient = distance + detour, away + gradient
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
    return jnp.dot(weights, field.clearances[index], precision=_EXACT).astype(position.dtype)


# ---------------------------------------------------------------- solve, keep


def _pack(fine_detour: np.ndarray, coarse_detour: np.ndarray, fine: Grid, coarse: Grid) -> np.ndarray:
    """Join the detour of one port and its central differences into rows (M, 4)."""
    tables = []
    for detour, grid in ((fine_detour, fine), (coarse_detour, coarse)):
        gradient = np.gradient(detour, grid.spacing)
        tables.append(np.stack([detour, *gradient], axis=-1).astype(np.float32))
    core, ratio = shared_nodes(fine, coarse)
    tables[1][core] = tables[0][::ratio, ::ratio, ::ratio]
    return np.concatenate([table.reshape(-1, 4) for table in tables])


def _field(detours: list, clearances: list, goals: np.ndarray, grids: tuple[Grid, Grid]) -> GeodesicField:
    return GeodesicField(
        nodes=jnp.asarray(np.stack([_pack(fine, coarse, *grids) for fine, coarse in detours])),
        clearances=jnp.asarray(np.concatenate([np.asarray(x, np.float32).reshape(-1) for x in clearances])),
        origins=jnp.asarray([grid.origin for grid in grids], dtype=jnp.float32),
        spacings=jnp.asarray([grid.spacing for grid in grids], dtype=jnp.float32),
        shapes=jnp.asarray([grid.shape for grid in grids], dtype=jnp.int32),
        goals=jnp.asarray(goals, dtype=jnp.float32),
    )


def _solve_port(
    fine_clearance: Array, goal: np.ndarray, normal: np.ndarray, grids: tuple[Grid, Grid], config: FieldConfig
) -> tuple[np.ndarray, np.ndarray]:
    """The detour of one port at the nodes of both grids."""
    fine, coarse = grids
    phi = solve_fine(fine_clearance, jnp.asarray(goal, jnp.float32), jnp.asarray(normal, jnp.float32), fine, config)
    phi = np.asarray(phi)
    straight = [np.linalg.norm(grid.points() - goal, axis=-1) for grid in grids]
    on_fine = (phi - straight[0]).astype(np.float32)
    on_coarse = (solve_coarse(phi, goal, fine, coarse) - straight[1]).astype(np.float32)
    return close_seam(on_fine, on_coarse, fine, coarse), on_coarse


def _checked(boxes, goals, normals, sphere_radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    boxes, goals, normals = (np.asarray(a, np.float64) for a in (boxes, goals, normals))
    if boxes.ndim != 3 or boxes.shape[1:] != (2, 3):
        raise ValueError(f"boxes must have shape (N, 2, 3); got {boxes.shape}")
    if not np.all(boxes[:, 1] >= boxes[:, 0]):
        raise ValueError("boxes must hold the lower corner first: an upper corner lies below its lower one")
    if goals.ndim != 2 or goals.shape[1] != 3 or len(goals) == 0 or normals.shape != goals.shape:
        raise ValueError(f"goals and normals must both have shape (P, 3), P > 0; got {goals.shape}, {normals.shape}")
    if not (all(np.isfinite(a).all() for a in (boxes, goals, normals)) and sphere_radius >= 0.0):
        raise ValueError("boxes, goals and normals must be finite and sphere_radius not negative")
    if not np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6):
        raise ValueError("normals must be unit vectors")
    return boxes, goals, normals


@own_promotion()
def solve_field(
    boxes: Float[np.ndarray, "N 2 3"],
    goals: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    sphere_radius: float = _SPHERE_RADIUS,
    config: FieldConfig | None = None,
) -> GeodesicField:
    """Solve the cost-to-go for some goals among some boxes; about a second a goal at the standard spacing.

    Args:
        boxes: (N, 2, 3) lower and upper corners [m], station frame; N may be 0.
        goals: (P, 3) goal positions [m], station frame.
        normals: (P, 3) outward unit normals of the ports.
        sphere_radius: radius of the chaser's bounding sphere [m].
        config: the field's numbers; the standard ones if not given.

    Raises:
        ValueError: wrong shapes, non-finite numbers, unordered corners or normals that are not unit vectors.
    """
    config = FieldConfig() if config is None else config
    boxes, goals, normals = _checked(boxes, goals, normals, sphere_radius)
    grids = grid_layout(boxes, goals, normals, sphere_radius, config)
    clearances = [grid_clearance(jnp.asarray(boxes, jnp.float32), sphere_radius, grid) for grid in grids]
    detours = [_solve_port(clearances[0], goal, normal, grids, config) for goal, normal in zip(goals, normals)]
    return _field(detours, clearances, goals, grids)


def _cache_dir() -> Path:
    override = os.environ.get("OWM_ENVS_CACHE")
    return Path(override) if override else Path(platformdirs.user_cache_dir("owm_envs", appauthor=False))


def _digest(*parts) -> str:
    """Hash arrays by dtype, shape and bytes, and anything else by its repr."""
    digest = hashlib.sha256()
    for part in (_VERSION, *parts):
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str}{part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()[:20]


def _seal(path: Path, data: bytes | memoryview) -> bytes:
    """The digest of a cache file's numbers and of its name, which tells what they depend on."""
    digest = hashlib.sha256(path.name.encode())
    digest.update(data)
    return digest.digest()


def _read(path: Path, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray] | None:
    """Read the values of a cache file, a grid after the other; None if it is missing, damaged or another's."""
    sizes = [math.prod(shape) for shape in shapes]
    try:
        if not path.is_file() or path.stat().st_size != _SEAL + 4 * sum(sizes):
            return None
        data = path.read_bytes()
    except OSError:
        return None
    if _seal(path, memoryview(data)[_SEAL:]) != data[:_SEAL]:
        return None
    values = np.split(np.frombuffer(data, "<f4", offset=_SEAL), np.cumsum(sizes)[:-1])
    return [part.reshape(shape) for part, shape in zip(values, shapes)]


def _write(path: Path, *values: np.ndarray) -> None:
    """Write a cache file in one step, so that no reader ever sees half of it; a read-only disk only warns."""
    data = b"".join(np.ascontiguousarray(part, "<f4").tobytes() for part in values)
    try:
        if not path.is_file():
            remove(path)  # a folder or link in its place
        write_atomically(path, lambda file: file.write(_seal(path, data) + data))
    except OSError as error:
        warnings.warn(f"the geodesic field could not be kept in {path.parent}: {error}", stacklevel=3)


@own_promotion()
def load_field(
    ports: Sequence[str] = PORT_NAMES,
    boxes: Float[np.ndarray, "N 2 3"] | None = None,
    progress: Progress | None = None,
    config: FieldConfig | None = None,
    *,
    poses: Float[np.ndarray, "8 7"] | None = None,
) -> GeodesicField:
    """Load the field of the station's ports from the cache, solving what is not there.

    The cache is the user's cache directory, or the directory named by OWM_ENVS_CACHE; it holds a file a port,
    named by a hash of everything the numbers depend on, and sealed with their digest. A file that does not match is
    solved anew.

    Args:
        ports: names from `PORT_NAMES`; row i of the field belongs to ports[i].
        boxes: (N, 2, 3) hull boxes [m], station frame; the station's own if not given.
        progress: called before each port that has to be solved and once at the end; a rich progress bar on
            the standard error stream if not given.
        config: the field's numbers; the standard ones if not given.
        poses: hold pose of each port: m, quaternion body to station; the station's own if not given.

    Raises:
        ValueError: no ports, an unknown port (naming the nearest), or bad boxes.
    """
    if isinstance(ports, str) or len(ports) == 0:
        raise ValueError(f"ports must be a non-empty sequence of port names; got {ports!r}")
    rows = [port_index(name) for name in ports]
    config = FieldConfig() if config is None else config
    boxes = hull_boxes() if boxes is None else boxes
    normals = np.array([port.normal for port in PORTS], np.float64)
    if poses is not None:
        normals = outward_normals(poses)
    boxes, goals, normals = _checked(boxes, (goal_poses() if poses is None else poses)[:, :3], normals, _SPHERE_RADIUS)
    # All eight ports place the grids, whichever are asked for: so each port's file serves every selection.
    grids = grid_layout(boxes, goals, normals, _SPHERE_RADIUS, config)
    shapes = tuple(grid.shape for grid in grids)
    folder, common = _cache_dir(), (config, grids, _SPHERE_RADIUS, boxes)

    path = folder / f"clearance-{_digest('clearance', *common)}.f32"
    clearances = _read(path, shapes)
    if clearances is None:
        clearances = [np.asarray(grid_clearance(jnp.asarray(boxes, jnp.float32), _SPHERE_RADIUS, g)) for g in grids]
        _write(path, *clearances)
    paths = {r: folder / f"{PORT_NAMES[r]}-{_digest(goals[r], normals[r], *common)}.f32" for r in rows}
    detours = {r: _read(path, shapes) for r, path in paths.items()}
    missing = [r for r, values in detours.items() if values is None]
    if missing:
        with _reporter(progress) as report:
            for done, r in enumerate(missing):
                report(f"solving the geodesic field of {PORT_NAMES[r]}", done, len(missing))
                detours[r] = _solve_port(jnp.asarray(clearances[0]), goals[r], normals[r], grids, config)
                _write(paths[r], *detours[r])
            report("geodesic field ready", len(missing), len(missing))
    return _field([detours[r] for r in rows], clearances, goals[rows], grids)


@contextlib.contextmanager
def _reporter(progress: Progress | None) -> Iterator[Progress]:
    if progress is not None:
        yield progress
        return
    from rich.progress import Progress as Bar

    with Bar(console=terminal(stderr=True), transient=True) as bar:
        task = bar.add_task("geodesic field")
        yield lambda message, done, total: bar.update(task, description=message, completed=done, total=total)


def field_rows(field: GeodesicField, poses: Float[np.ndarray, "8 7"] | None = None) -> Int[np.ndarray, "8"]:
    """The row of a field that belongs to each port, -1 where it has none; `poses` as for `load_field`."""
    poses = goal_poses() if poses is None else np.asarray(poses)
    gaps = np.linalg.norm(poses[:, None, :3] - np.asarray(field.goals)[None], axis=-1)
    return np.where(gaps.min(axis=1) < 1e-3, gaps.argmin(axis=1), -1)
