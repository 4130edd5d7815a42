"""From a scene to a picture of one instant; the caller vmaps.

The work is cut into stages that run tile by tile. So what one stage finds is stored before the next one reads it, several
times over; left to itself a compiler would find it anew for each reader.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from owm_envs.camera.lens import Camera, Pose, Rays, picture, placed, rays
from owm_envs.camera.scene import Scene, assembled
from owm_envs.camera.shade import developed, encoded, lights, radiance
from owm_envs.camera.solids import Solids, crossing
from owm_envs.camera.surface import look
from owm_envs.camera.trace import LANES, between, columns_and_rows, sweep
from owm_envs.camera.vectors import Vector, dot, plus, unit, where
from owm_envs.station.ports import PORTS
from owm_envs.view import View

OUTPUTS = ("rgb", "depth", "part", "port", "normal")
_CHUNKS = 16  # so many tiles go through a stage at a time that a picture takes this many steps
_LIFT = 0.005  # a ray to the Sun starts this far off its surface [m]
_PORT_RADIUS = 1.3  # what is this close to the middle of a mating plane belongs to the port [m]


class Hit(NamedTuple):
    """What a ray meets first; the numbers of a miss are finite and mean nothing."""

    found: Array
    part: Array
    """Row of the sorted parts."""
    distance: Array
    """m."""
    point: Vector
    normal: Vector
    """Station frame."""
    place: Vector
    face: Vector
    """Point and normal in the part's own frame."""


def render(scene: Scene, view: View, camera: Camera) -> dict[str, Shaped[Array, "H W ..."]]:
    """Draw what a camera sees.

    Args:
        scene: as `default_scene` makes it, under the heavens of the instant.
        view: where the chaser is.
        camera: as `camera` makes it.

    Returns:
        by name of the camera's `outputs`: `rgb` (H, W, 3) uint8, sRGB. `depth` (H, W) float32, along the optical axis
        [m], infinite where no part is. `part` (H, W) int32, row of the station's `PARTS`, further on of its `DETAILS`,
        of the chaser's parts, then of each visitor's; -1 where none is. `port` (H, W) int32, index of the docking port,
        -1 for none. `normal` (H, W, 3) float32, unit vectors in the station frame, zero where no part is.
    """
    pose = placed(camera, view)
    cast = rays(camera, pose)
    parts, closest, order = _nearest_first(assembled(scene, view), pose, camera)
    owner = _owners(*jax.lax.stop_gradient((parts, closest, cast, pose)), camera)
    hits = by_tile(lambda tile: _meet(parts, *tile), (owner, cast.origin, cast.way))
    outputs = {}
    if "rgb" in camera.outputs:
        outputs["rgb"] = _photograph(scene, parts, cast, hits, camera)
    middle = lambda values: picture(values, camera)[
        camera.samples // 2 :: camera.samples, camera.samples // 2 :: camera.samples
    ]
    if "depth" in camera.outputs:
        along = tuple(pose.axes[j, 2] for j in range(3))
        outputs["depth"] = middle(jnp.where(hits.found, hits.distance * dot(cast.way, along), jnp.inf))
    if "part" in camera.outputs:
        outputs["part"] = middle(jnp.where(hits.found, order[hits.part].astype(jnp.int32), -1))
    if "port" in camera.outputs:
        outputs["port"] = middle(_port(hits))
    if "normal" in camera.outputs:
        outputs["normal"] = jnp.stack([middle(jnp.where(hits.found, n, 0.0)) for n in hits.normal], axis=-1)
    return outputs


def by_tile(function: Callable[[Any], Any], arrays: Any) -> Any:
    """Call a function of one tile for every tile, some at a time.

    Args:
        function: of `arrays` without their leading axis.
        arrays: their leading axis is that of the tiles, or 1 for what all tiles share.
    """
    leaves, tree = jax.tree.flatten(arrays)
    tiles = max(leaf.shape[0] for leaf in leaves)
    own = [leaf.shape[0] == tiles for leaf in leaves]

    def one(rows):
        rows = iter(rows)
        return function(tree.unflatten([next(rows) if mine else leaf[0] for mine, leaf in zip(own, leaves)]))

    rows = [leaf for mine, leaf in zip(own, leaves) if mine]
    return jax.lax.map(one, rows, batch_size=max(4, tiles // _CHUNKS))


def _nearest_first(parts: Solids, pose: Pose, camera: Camera) -> tuple[Solids, Float[Array, "N"], Int[Array, "N"]]:
    """The parts in order of the least distance at which a ray may meet them; that distance; the order."""
    offset = parts.centre - pose.position[None, :]
    parallel = camera.projection == "orthographic"
    along = offset @ pose.axes[:, 2] if parallel else jnp.sqrt((offset * offset).sum(axis=1))
    closest = along - jnp.sqrt((parts.half * parts.half).sum(axis=1))
    order = jnp.argsort(closest)
    return jax.tree.map(lambda a: a[order], parts), closest[order], order


def _owners(parts: Solids, closest: Array, cast: Rays, pose: Pose, camera: Camera) -> Int[Array, "T 64"]:
    """Which part each ray meets first, or -1."""
    perspective = camera.projection == "perspective"
    words = columns_and_rows(parts, pose.position, pose.axes, cast.across, cast.down, perspective)
    everywhere = jnp.ones((words.shape[0], LANES), bool)
    return sweep(parts, closest, words, cast.origin, cast.way, everywhere, first=True)


def _meet(parts: Solids, owner: Int[Array, "64"], origin: Vector, way: Vector) -> Hit:
    """Meet each ray with the part chosen for it, once more and for good: this can be differentiated."""
    found = owner >= 0
    chosen = jnp.maximum(owner, 0)
    row = lambda table: tuple(table[chosen, j] for j in range(table.shape[1]))
    axes = tuple(row(parts.rotation[:, :, j]) for j in range(3))
    shift = tuple(o - c for o, c in zip(origin, row(parts.centre)))
    start, ray = tuple(dot(axis, shift) for axis in axes), tuple(dot(axis, way) for axis in axes)
    k, m, l, _ = quadric = row(parts.quadric)
    met = crossing(start, ray, row(parts.half), quadric)
    distance = jnp.where(found, met.enter, 1.0)
    place = plus(start, distance, ray)
    # The last constraint that the ray comes to fulfil is the face through which it enters.
    flat = jnp.maximum(jnp.maximum(met.slabs[0], met.slabs[1]), met.slabs[2])
    first = met.slabs[0] >= flat
    second = ~first & (met.slabs[1] >= flat)
    square = tuple(jnp.where(on, -jnp.sign(w), 0.0) for on, w in zip((first, second, ~first & ~second), ray))
    round_ = unit((k * place[0], k * place[1], m * place[2] + 0.5 * l))
    face = where(met.bow >= flat, round_, square)
    normal = tuple(axes[0][i] * face[0] + axes[1][i] * face[1] + axes[2][i] * face[2] for i in range(3))
    return Hit(found, chosen, distance, plus(origin, distance, way), normal, place, face)


def _photograph(scene: Scene, parts: Solids, cast: Rays, hits: Hit, camera: Camera) -> Shaped[Array, "H W 3"]:
    lit = _sunlit(*jax.lax.stop_gradient((parts, hits, scene.heavens.sun)))
    shining = lights(scene.light, scene.heavens)
    gain = jnp.exp2(camera.exposure)
    perspective = camera.projection == "perspective"

    def shade(tile):
        hits, lit, way = tile
        row = lambda table: tuple(table[hits.part, j] for j in range(table.shape[1]))
        width = hits.distance * cast.spread if perspective else cast.spread
        # What a pixel covers is longer on a surface seen at a slant.
        width = width / jnp.maximum(-dot(hits.normal, way), 0.1)
        seen = look(scene.materials, parts.material[hits.part], hits.place, hits.face, row(parts.half), width)
        light = radiance(shining, seen, hits.normal, tuple(-w for w in way), hits.distance, lit)
        return tuple(developed(gain * jnp.where(hits.found, channel, 0.0)) for channel in light)

    light = by_tile(shade, (hits, lit, cast.way))
    if camera.samples == 1:
        light = by_tile(lambda tile: tuple(map(encoded, tile)), light)
    image = jnp.stack([picture(channel, camera) for channel in light], axis=-1)
    if camera.samples > 1:
        grid = (camera.height, camera.samples, camera.width, camera.samples, 3)
        image = encoded(image.reshape(grid).mean(axis=(1, 3)))
    return image


def _sunlit(parts: Solids, hits: Hit, sun: Float[Array, "3"]) -> Float[Array, "T 64"]:
    """Whether no other part stands between each point and the Sun, 0 or 1."""
    towards = tuple(sun[j].reshape(1, 1) for j in range(3))
    active = hits.found & (dot(hits.normal, towards) > 0)
    points = plus(hits.point, _LIFT, hits.normal)
    helper = jnp.where(jnp.abs(sun[2]) < 0.9, jnp.asarray([0, 0, 1], sun.dtype), jnp.asarray([1, 0, 0], sun.dtype))
    first = jnp.cross(helper, sun)
    first = first / jnp.sqrt((first * first).sum())
    frame = jnp.stack([first, jnp.cross(sun, first), sun])
    words = by_tile(lambda tile: between(parts, frame, *tile), (points, active))
    anywhere = jnp.full(parts.present.shape, -jnp.inf, sun.dtype)
    blocker = sweep(parts, anywhere, words, points, towards, active, first=False)
    return (active & (blocker < 0)).astype(sun.dtype)


def _port(hits: Hit) -> Int[Array, "T 64"]:
    """The docking port that each point belongs to."""
    nearest, owner = jnp.full(hits.distance.shape, _PORT_RADIUS**2, hits.distance.dtype), jnp.full(hits.part.shape, -1)
    for index, port in enumerate(PORTS):
        offset = tuple(p - np.float32(c) for p, c in zip(hits.point, port.interface))
        square = dot(offset, offset)
        owner = jnp.where(square < nearest, index, owner)
        nearest = jnp.minimum(square, nearest)
    return jnp.where(hits.found, owner, -1).astype(jnp.int32)
