"""The table of parts as a mesh, and any mesh as boxes. Needs `trimesh` (the extra `mesh`).

Files are glTF: y up, z forward. The station frame is zenith z and forward -y, so (x, y, z) is written as (x, z, -y).
"""

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from owm_envs.files import plain_file
from owm_envs.station.boxes import Boxes, distance_to, emptiness, grid_around, merge, outer_samples
from owm_envs.station.geometry import ROUND, rotation
from owm_envs.station.primitives import MATERIALS, Part
from owm_envs.words import install

if TYPE_CHECKING:
    import trimesh

_MODES = ("points", "lines", "a line loop", "a line strip", "triangles", "a triangle strip", "a triangle fan")
_SIDES = 32  # of a round part; their corners lie on the surface
_CELLS = 60_000_000  # most voxels of an import
_FARTHEST = 500.0  # m along an axis from the origin to a mesh; episodes end at 750 m

_TO_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
UP: dict[str, np.ndarray] = {
    "x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]).T,
    "y": _TO_GLTF.T,
    "z": np.eye(3),
}
"""Rotation from a file's axes to the station frame, by the file's axis that points to zenith."""


def _trimesh() -> Any:
    try:
        import trimesh
    except ImportError:
        raise ImportError(f"meshes need trimesh: {install('mesh')}") from None
    return trimesh


def part_mesh(part: Part) -> "trimesh.Trimesh":
    """Make the watertight mesh of one part, in the table's frame."""
    trimesh = _trimesh()
    size = np.asarray(part.dimensions, np.float64)
    if part.primitive == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.5 * size[0])
    elif part.primitive in ROUND:
        # Revolve the outline about local z; the points on the axis close the mesh.
        r0, r1, half = 0.5 * size
        outline = np.array([(0.0, -half), (r0, -half), (r1, half), (0.0, half)])
        mesh = trimesh.creation.revolve(outline, sections=_SIDES)
    else:
        mesh = trimesh.creation.box(extents=size)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(part), part.position
    mesh.apply_transform(pose)
    return mesh


def scene(parts: tuple[Part, ...]) -> "trimesh.Scene":
    """Make a scene of one named node a part, with its material; glTF axes.

    Args:
        parts: rows of a table.
    """
    trimesh = _trimesh()
    turn = np.eye(4)
    turn[:3, :3] = _TO_GLTF
    materials = {
        name: trimesh.visual.material.PBRMaterial(
            name=name,
            baseColorFactor=[*(round(255 * c) for c in m.colour), 255],
            metallicFactor=m.metallic,
            roughnessFactor=m.roughness,
        )
        for name, m in MATERIALS.items()
    }
    result = trimesh.Scene()
    for part in parts:
        mesh = part_mesh(part)
        mesh.apply_transform(turn)
        mesh.visual = trimesh.visual.TextureVisuals(material=materials[part.material])
        result.add_geometry(mesh, node_name=part.name, geom_name=part.name)
    return result


def export(path: Path | str, parts: tuple[Part, ...]) -> int:
    """Write a table of parts as binary glTF.

    Args:
        path: the file to write, .glb.
        parts: rows of a table.

    Returns:
        Its size in bytes.

    Raises:
        ValueError: a name that doesn't end in .glb.
    """
    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise ValueError(f"export writes binary glTF: the name must end in .glb; got {path.name}")
    data = scene(parts).export(file_type="glb")
    path.write_bytes(data)
    return len(data)


# ---------------------------------------------------------------- import


class _Lost(ValueError):
    """A part of a file that would be left out."""


def _declared(path: Path) -> int:
    """Count the triangles that a file declares; a polygon of a PLY file counts as one, an unknown format as none."""
    counted = {".glb": _in_gltf, ".gltf": _in_gltf, ".obj": _in_obj, ".stl": _in_stl, ".ply": _in_ply}
    return counted.get(path.suffix.lower(), lambda data: 0)(path.read_bytes())


def _in_obj(data: bytes) -> int:
    return sum(max(len(line.split()) - 3, 0) for line in data.splitlines() if line.lstrip().startswith(b"f "))


def _in_stl(data: bytes) -> int:
    text = data.lstrip().startswith(b"solid") and b"facet" in data[:1000]
    return data.count(b"endfacet") if text else int.from_bytes(data[80:84], "little")


def _in_ply(data: bytes) -> int:
    header = data[: data.find(b"end_header")].split()
    return int(header[header.index(b"face") + 1]) if b"face" in header else 0


def _in_gltf(data: bytes) -> int:
    """Count what the scene declares, a mesh once for each node that shows it.

    Raises:
        _Lost: a primitive of another mode, named with its node.
    """
    if data[:4] == b"glTF":
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    tree = json.loads(data)
    nodes, scenes = tree.get("nodes", []), tree.get("scenes", [])
    open_nodes = list(scenes[tree.get("scene", 0)].get("nodes", [])) if scenes else list(range(len(nodes)))
    count = 0
    while open_nodes:
        index = open_nodes.pop()
        node = nodes[index]
        open_nodes += node.get("children", []) if scenes else []
        for number, primitive in enumerate(tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []):
            mode = primitive.get("mode", 4)
            if mode != 4:
                name = node.get("name", f"number {index}")
                kind = _MODES[mode] if mode in range(len(_MODES)) else f"of unknown mode {mode}"
                raise _Lost(f"node {name!r}, primitive {number}, is {kind}, not triangles; convert or delete it")
            accessor = primitive.get("indices", primitive["attributes"]["POSITION"])
            count += tree["accessors"][accessor]["count"] // 3
    return count


def _areas(triangles: Float[np.ndarray, "T 3 3"]) -> Float[np.ndarray, "T"]:
    return 0.5 * np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )  # fmt: skip


def load_triangles(path: Path | str, scale: float = 1.0, up: str | None = None) -> Float[np.ndarray, "T 3 3"]:
    """Read a mesh of any kind that trimesh reads, in the station frame.

    Args:
        path: the file; all its meshes are taken together.
        scale: metres per unit of the file.
        up: the file's axis that points to zenith, "x", "y" or "z"; by default y for glTF and z for other files.

    Returns:
        (T, 3, 3) corners of the triangles [m], those without area left out, with a warning that counts them.

    Raises:
        ValueError: the file is missing, not a mesh, without triangles or not finite; a part of it isn't triangles or
            was lost in reading; its size can't be in metres, or it lies far from the station.
    """
    trimesh = _trimesh()
    path = Path(path)
    up = ("y" if path.suffix.lower() in (".glb", ".gltf") else "z") if up is None else up
    if up not in UP:
        raise ValueError(f"up must be one of {', '.join(UP)}; got {up!r}")
    if not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f"scale must be a positive number of metres per unit; got {scale}")
    try:
        plain_file(path, 2**32)
    except OSError:
        raise ValueError(f"no such mesh: {path}") from None
    try:
        declared = _declared(path)
        # Unprocessed: trimesh's cleaning drops triangles, those with NaN among them, without a word.
        loaded = trimesh.load_scene(path, process=False)
        geometry = loaded.dump()
    except _Lost as error:
        raise ValueError(f"{path}: {error}") from None
    except Exception as error:  # trimesh's readers raise whatever their format's parser raises
        raise ValueError(f"{path} cannot be read as a mesh: {error}") from None
    for part in geometry:
        if not isinstance(part, trimesh.Trimesh):
            name = part.metadata.get("name", "a part without a name")
            raise ValueError(f"{path}: {name} is a {type(part).__name__}, not triangles; delete or convert it")
    triangles = np.concatenate([np.zeros((0, 3, 3)), *(np.asarray(mesh.triangles, np.float64) for mesh in geometry)])
    if len(triangles) < declared:
        raise ValueError(f"{path} declares {declared} triangles, of which {len(triangles)} were read")
    if len(triangles) == 0:
        raise ValueError(f"{path} holds no triangles")
    if not np.isfinite(triangles).all():
        raise ValueError(f"{path} holds vertices that are not finite")
    triangles = triangles @ UP[up].T * scale
    solid = _areas(triangles) > 0.0
    if not solid.any():
        raise ValueError(f"{path} holds no triangles with an area")
    if not solid.all():
        warnings.warn(f"{path}: left out {(~solid).sum()} of {len(solid)} triangles, which have no area", stacklevel=2)
    triangles = triangles[solid]
    extent = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    if not 1.0 < extent < 1000.0:
        raise ValueError(
            f"{path} is {extent:,.6g} m across, which no station is; scale gives the metres per unit "
            f"(0.001 for millimetres, 0.0254 for inches; now {scale:g})"
        )
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    if (np.maximum(low, -high) > _FARTHEST).any():
        raise ValueError(
            f"{path} lies from {low.round(1).tolist()} to {high.round(1).tolist()} m, over {_FARTHEST:g} m from the "
            "station's origin; move it there first"
        )
    return triangles


def _small_pieces(triangles: np.ndarray, longest: float) -> np.ndarray:
    """Halve the longest edges until none is longer; the pieces cover the triangles exactly."""
    done = []
    while len(triangles):
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        small = edges.max(axis=1) <= longest
        done.append(triangles[small])
        triangles, edges = triangles[~small], edges[~small]
        if len(triangles):
            first = edges.argmax(axis=1)
            a, b, c = (triangles[np.arange(len(first)), (first + k) % 3] for k in range(3))
            middle = 0.5 * (a + b)
            triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


class Voxels(NamedTuple):
    """The cells that a surface passes through, each with the smallest box around what lies in it."""

    index: np.ndarray
    """(M, 3) cell numbers."""
    bounds: Boxes


def voxelise(triangles: Float[np.ndarray, "T 3 3"], origin: np.ndarray, spacing: float) -> Voxels:
    """Find every cell that a surface touches; no point of it is missed.

    Triangles are cut into pieces no longer than a cell, and each piece marks the cells its bounds touch.
    """
    shape = np.ceil((triangles.reshape(-1, 3).max(axis=0) - origin) / spacing).astype(np.int64) + 1
    found = np.zeros(0, np.int64)
    limits = np.zeros((0, 6))  # lower corner and negative upper corner, so that one minimum serves both
    for start in range(0, len(triangles), 20_000):
        pieces = _small_pieces(triangles[start : start + 20_000], spacing)
        low, high = pieces.min(axis=1), pieces.max(axis=1)
        first = np.floor((low - origin) / spacing).astype(np.int64)
        last = np.maximum(np.ceil((high - origin) / spacing).astype(np.int64) - 1, first)
        for offset in np.ndindex(2, 2, 2):
            touched = np.flatnonzero(np.all(first + offset <= last, axis=1))
            cell = first[touched] + offset
            corner = origin + cell * spacing
            inside = [np.maximum(low[touched], corner), -np.minimum(high[touched], corner + spacing)]
            keys = np.concatenate([found, (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]])
            order = np.argsort(keys, kind="stable")
            keys = keys[order]
            starts = np.flatnonzero(np.diff(keys, prepend=-1))
            both = np.concatenate([limits, np.concatenate(inside, axis=1)])[order]
            found, limits = keys[starts], np.minimum.reduceat(both, starts)
    index = np.stack(np.unravel_index(found, shape), axis=1)
    return Voxels(index, np.stack([limits[:, :3], -limits[:, 3:]], axis=1))


def _blocks(voxels: Voxels, most: int) -> Boxes:
    """Split the set of voxels in two, again and again where that saves most volume, into at most `most` boxes."""
    import heapq

    def extent(members: np.ndarray) -> np.ndarray:
        return np.stack([voxels.bounds[members, 0].min(axis=0), voxels.bounds[members, 1].max(axis=0)])

    def volume(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        size = upper - lower
        return size[..., 0] * size[..., 1] * size[..., 2]

    def best_cut(members: np.ndarray) -> tuple[float, np.ndarray, np.ndarray] | None:
        """The plane between two layers of cells that saves most."""
        whole, best = float(volume(*extent(members))), None
        for axis in range(3):
            order = members[np.argsort(voxels.index[members, axis], kind="stable")]
            layer = voxels.index[order, axis]
            cuts = np.flatnonzero(np.diff(layer)) + 1
            if len(cuts) == 0:
                continue
            low, high = voxels.bounds[order, 0], voxels.bounds[order, 1]
            before = np.minimum.accumulate(low)[cuts - 1], np.maximum.accumulate(high)[cuts - 1]
            after = np.minimum.accumulate(low[::-1])[::-1][cuts], np.maximum.accumulate(high[::-1])[::-1][cuts]
            saved = whole - volume(*before) - volume(*after)
            k = int(np.argmax(saved))
            if best is None or saved[k] > best[0]:
                best = float(saved[k]), order[: cuts[k]], order[cuts[k] :]
        return best

    leaves, heap, ticket = {}, [], 0

    def add(members: np.ndarray) -> None:
        nonlocal ticket
        leaves[ticket] = members
        cut = best_cut(members)
        if cut is not None:
            heapq.heappush(heap, (-cut[0], ticket, cut[1], cut[2]))
        ticket += 1

    add(np.arange(len(voxels.index)))
    while heap and len(leaves) < most:
        _, number, left, right = heapq.heappop(heap)
        del leaves[number]
        add(left)
        add(right)
    return np.stack([extent(members) for members in leaves.values()])


class ImportReport(NamedTuple):
    """What became of a mesh; lengths in metres."""

    triangles: int
    voxels: int
    boxes: Boxes
    covered: float
    """Share of surface samples inside the boxes; 1 but for rounding."""
    excess_mean: float
    """Distance of samples of the boxes' outer surface to the mesh's voxels, mean over the area."""
    excess_p99: float
    reach: float
    """Farthest corner from the origin."""


def boxes_from_mesh(
    triangles: Float[np.ndarray, "T 3 3"],
    count: int = 313,
    voxel: float = 0.5,
    reach: float = 2.25,
    samples: int = 20_000,
    progress: Callable[[str], None] = lambda text: None,
) -> ImportReport:
    """Turn a surface into axis-aligned boxes that cover it.

    Voxels first; then the set of voxels is split into several times as many boxes as asked for, and these are merged
    where the least empty space is taken in. What the surface encloses counts as solid.

    Args:
        triangles: (T, 3, 3) corners [m], station frame.
        count: number of boxes.
        voxel: edge of a voxel [m].
        reach: radius of the chaser's bounding sphere [m]: what it can't enter costs nothing to fill.
        samples: surface samples of the report.
        progress: called with what is being done.

    Raises:
        ValueError: a count below 1, a voxel that isn't positive, or one so small that the grid gets too large.
    """
    from scipy.ndimage import binary_fill_holes
    from scipy.spatial import cKDTree

    triangles = np.asarray(triangles, np.float64)
    if count < 1:
        raise ValueError(f"boxes must be at least 1; got {count}")
    if not (np.isfinite(voxel) and voxel > 0.0):
        raise ValueError(f"voxel must be a positive length in metres; got {voxel}")
    corners = triangles.reshape(-1, 3)
    whole = np.stack([corners.min(axis=0), corners.max(axis=0)])
    cells = float(np.prod((whole[1] - whole[0] + 2.0 * reach) / voxel + 3.0))
    if cells > _CELLS:
        least = voxel * (cells / _CELLS) ** (1.0 / 3.0)
        raise ValueError(
            f"voxel {voxel} m makes {cells:.2g} cells; at least {least:.2f} m keeps them under {_CELLS:.0g}"
        )
    progress("voxelising")
    grid = grid_around(whole[None], voxel, reach)
    voxels = voxelise(triangles, grid.origin, voxel)
    filled = np.zeros(grid.shape, bool)
    filled[tuple(voxels.index.T)] = True
    filled = binary_fill_holes(filled)
    progress("splitting")
    blocks = _blocks(voxels, max(6 * count, 64))
    progress("merging")
    boxes = merge(blocks, count, emptiness(filled.astype(np.float64), grid))
    size = boxes[:, 1] - boxes[:, 0]
    flat = size < 1e-3  # a box needs a thickness
    boxes = np.stack([boxes[:, 0] - 0.5e-3 * flat, boxes[:, 1] + 0.5e-3 * flat], axis=1)

    progress("measuring")
    rng = np.random.default_rng(0)
    area = _areas(triangles)
    chosen = triangles[rng.choice(len(triangles), samples, p=area / area.sum())]
    u, v = np.sqrt(rng.random((samples, 1))), rng.random((samples, 1))
    surface = (1.0 - u) * chosen[:, 0] + u * (1.0 - v) * chosen[:, 1] + u * v * chosen[:, 2]
    outer = outer_samples(boxes, samples, rng)
    near = cKDTree(voxels.bounds.mean(axis=1)).query(outer, k=min(8, len(voxels.index)))[1].reshape(len(outer), -1)
    gap = np.maximum(
        np.maximum(voxels.bounds[near, 0] - outer[:, None], outer[:, None] - voxels.bounds[near, 1]), 0.0
    )  # fmt: skip
    excess = np.linalg.norm(gap, axis=-1).min(axis=1)
    return ImportReport(
        len(triangles),
        len(voxels.index),
        boxes,
        float(np.mean(distance_to(boxes, surface) < 1e-6)),
        float(excess.mean()),
        float(np.quantile(excess, 0.99)),
        float(np.linalg.norm(np.abs(boxes).max(axis=1), axis=-1).max()),
    )
