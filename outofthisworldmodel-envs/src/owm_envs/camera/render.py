"""From a scene to a picture of one instant; the caller vmaps.

A picture is drawn in strips of some tiles, and each strip in stages: which part a ray meets, where, whether the Sun
sees that place, and how it looks. What one stage finds is stored before the next one reads it (`stored`).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from owm_envs.camera.lens import Camera, Grid, Pose, Rays, arranged, grid, placed, project, rays
from owm_envs.camera.light import Heavens
from owm_envs.camera.scene import Scene, assembled
from owm_envs.camera.shade import Lights, developed, encoded, lights, radiance
from owm_envs.camera.sky import sky_radiance, splat_stars
from owm_envs.camera.solids import EXACT, Quadric, Solids, Standing, normal_at, standing
from owm_envs.camera.surface import look
from owm_envs.camera.trace import (
    LANES,
    SIDE,
    Bounds,
    Words,
    between,
    bounds,
    busiest_first,
    columns_and_rows,
    in_strips,
    stored,
    sweep,
)
from owm_envs.camera.vectors import Vector, dot, plus, unit, where
from owm_envs.station.ports import PORTS
from owm_envs.view import View

OUTPUTS = ("rgb", "depth", "part", "port", "normal")
_LIFT = 0.005  # a ray to the Sun starts this far off its surface [m]
_PORT_RADIUS = 1.3  # what is this close to the middle of a mating plane belongs to the port [m]


class Met(NamedTuple):
    """The part that each ray meets first; any part where it meets none."""

    part: Array
    """Row of the sorted parts."""
    centre: Vector
    axes: tuple[Vector, Vector, Vector]
    half: Vector
    quadric: Quadric
    material: Array
    """As of `Solids`."""


class Hit(NamedTuple):
    """Where each ray meets a part first; the numbers of a miss are finite and mean nothing."""

    found: Array
    met: Met
    at: Standing
    point: Vector
    """m, station frame."""
    normal: Vector
    """Station frame."""


def render(scene: Scene, view: View, camera: Camera) -> dict[str, Shaped[Array, "H W ..."]]:
    """Draw what a camera sees.

    Args:
        scene: as `default_scene` makes it, under the heavens of the instant.
        view: where the chaser is.
        camera: as `camera` makes it.

    Returns:
        by name of the camera's `outputs`: `rgb` (H, W, 3) uint8, sRGB. `depth` (H, W) float32, along the optical axis
        [m], infinite where no part is. `part` (H, W) int32, row of the station's `PARTS`, further on of its `DETAILS`,
        of the chaser's parts, then of each visitor's; -1 where none is. `port` (H, W) int32, index of the docking
        port, -1 for none. `normal` (H, W, 3) float32, unit vectors in the station frame, zero where no part is.
    """
    pose = placed(camera, view)
    parts, closest, order = _nearest_first(assembled(scene, view), pose, camera)
    cut = grid(camera)
    perspective = camera.projection == "perspective"
    words = columns_and_rows(
        *jax.lax.stop_gradient((parts, pose.position, pose.axes, cut.across, cut.down)), perspective
    )
    tiles = busiest_first(words)
    shadows = _shadows(parts, scene.heavens)
    shining = lights(scene.light, scene.heavens)
    stars = _stars(scene, pose, cut, camera) if "rgb" in camera.outputs else ()

    def strip(rows):
        tiles, words, *stars = rows
        cast = rays(camera, pose, cut, tiles)
        hits = _hits(parts, closest, words, cast)
        shown = {}
        if "rgb" in camera.outputs:
            lit = _sunlit(*jax.lax.stop_gradient((shadows, _disc(camera, cut, tiles), hits)))
            shown["rgb"] = _exposed(scene, shining, hits, lit, cast, stars, cut.step, camera)
        if "depth" in camera.outputs:
            along = tuple(pose.axes[j, 2] for j in range(3))
            shown["depth"] = jnp.where(hits.found, hits.at.distance * dot(cast.way, along), jnp.inf)
        if "part" in camera.outputs:
            shown["part"] = jnp.where(hits.found, order[hits.met.part].astype(jnp.int32), -1)
        if "port" in camera.outputs:
            shown["port"] = _port(hits)
        if "normal" in camera.outputs:
            shown["normal"] = tuple(jnp.where(hits.found, n, 0.0) for n in hits.normal)
        return shown

    everywhere = jnp.ones(tiles.shape, bool)
    shown = in_strips(
        strip, (tiles, words[tiles], *(channel[tiles] for channel in stars)), everywhere, max(16, tiles.shape[0] // 16)
    )
    back = jnp.argsort(tiles)
    samples = jax.tree.map(lambda a: arranged(a[back], camera), shown)
    return {name: _pixels(name, samples[name], camera) for name in samples}


def _pixels(name: str, values: Any, camera: Camera) -> Shaped[Array, "H W ..."]:
    """A picture of samples as one of pixels."""
    if name == "rgb":
        image = jnp.stack(values, axis=-1)
        if camera.samples == 1:
            return image
        fine = (camera.height, camera.samples, camera.width, camera.samples, 3)
        return encoded(image.reshape(fine).mean(axis=(1, 3)))
    middle = slice(camera.samples // 2, None, camera.samples)
    values = jax.tree.map(lambda a: a[middle, middle], values)
    return jnp.stack(values, axis=-1) if isinstance(values, tuple) else values


def _nearest_first(parts: Solids, pose: Pose, camera: Camera) -> tuple[Solids, Float[Array, "N"], Int[Array, "N"]]:
    """The parts in order of the least distance at which a ray may meet them; that distance; the order."""
    if camera.projection == "orthographic":
        closest = bounds(parts, pose.axes[:, 2:].T).least[0] - (pose.position * pose.axes[:, 2]).sum()
    else:
        offset = pose.position[None, :] - parts.centre
        place = jnp.einsum("ni,nij->nj", offset, parts.rotation, precision=EXACT)
        outside = jnp.maximum(jnp.abs(place) - parts.half, 0.0)
        closest = jnp.sqrt((outside * outside).sum(axis=1))
    order = jnp.argsort(closest)
    return jax.tree.map(lambda a: a[order], parts), closest[order], order


def _hits(parts: Solids, closest: Float[Array, "N"], words: Words, cast: Rays) -> Hit:
    """What each ray of some tiles meets first."""
    live = jnp.ones((words.shape[0], LANES), bool)
    owner, near = sweep(*jax.lax.stop_gradient((parts, closest, words, *cast)), live, first=True)
    found = owner >= 0
    busy = found.any(axis=1)
    chosen = jnp.maximum(owner, 0)
    met = stored(lambda chosen: _met(parts, chosen), chosen, busy)
    at = stored(lambda strip: _stand(*strip), (met, jnp.where(found, near, 1.0), *cast), busy)
    normal = stored(lambda strip: _turned_out(*strip), (met, at), busy)
    return Hit(found, met, at, plus(cast.origin, at.distance, cast.way), normal)


def _met(parts: Solids, chosen: Int[Array, "..."]) -> Met:
    row = lambda table: tuple(table[chosen, j] for j in range(table.shape[1]))
    axes = tuple(row(parts.rotation[:, :, j]) for j in range(3))
    return Met(chosen, row(parts.centre), axes, row(parts.half), row(parts.quadric), parts.material[chosen])


def _stand(met: Met, near: Array, origin: Vector, way: Vector) -> Standing:
    shift = plus(origin, -1.0, met.centre)
    start, ray = tuple(dot(axis, shift) for axis in met.axes), tuple(dot(axis, way) for axis in met.axes)
    return standing(near, start, ray, met.half, met.quadric)


def _turned_out(met: Met, at: Standing) -> Vector:
    """The outward unit normal, station frame."""
    inner = normal_at(at.face, at.place, met.quadric)
    return tuple(dot(inner, tuple(axis[i] for axis in met.axes)) for i in range(3))


def _exposed(
    scene: Scene,
    shining: Lights,
    hits: Hit,
    lit: Array,
    cast: Rays,
    stars: Sequence[Array],
    step: Array,
    camera: Camera,
) -> tuple[Array, Array, Array]:
    """Display light of the three colours, 0 to 1; encoded where no samples are to be averaged."""
    gain = jnp.exp2(camera.exposure)

    def shade(strip):
        hits, lit, way = strip
        met, at = hits.met, hits.at
        width = at.distance * step if camera.projection == "perspective" else step
        # What a pixel covers is longer on a surface seen at a slant.
        width = width / jnp.maximum(-dot(hits.normal, way), 0.1)
        inner = normal_at(at.face, at.place, met.quadric)
        seen = look(scene.materials, met.material, at.place, inner, met.half, width)
        light = radiance(shining, seen, hits.normal, tuple(-w for w in way), at.distance, lit)
        return tuple(jnp.where(hits.found, channel, 0.0) for channel in light)

    def develop(light):
        light = tuple(developed(gain * channel) for channel in light)
        return tuple(map(encoded, light)) if camera.samples == 1 else light

    busy = hits.found.any(axis=1)
    light = stored(shade, (hits, lit, cast.way), busy)
    if scene.sky is not None:
        way = tuple(jnp.broadcast_to(w, hits.found.shape) for w in cast.way)
        sky = stored(lambda way: _behind(scene, way, step), way, ~hits.found.all(axis=1))
        light = where(hits.found, light, plus(sky, 1.0, stars) if stars else sky)
        busy = jnp.ones_like(busy)
    return stored(develop, light, busy)


def _behind(scene: Scene, way: Vector, step: Array) -> Vector:
    """The sky along rays, but for its stars."""
    light = sky_radiance(scene.sky, scene.heavens, jnp.stack(way, axis=-1), step)
    return tuple(light[..., channel] for channel in range(3))


def _stars(scene: Scene, pose: Pose, cut: Grid, camera: Camera) -> Sequence[Array]:
    """What the stars add to each sample of each tile; nothing where rays run parallel."""
    if scene.sky is None or camera.projection == "orthographic":
        return ()
    rows, columns = cut.down.shape[0] - 1, cut.across.shape[0] - 1

    def place(towards):
        pixels, ahead = project(camera, pose._replace(position=jnp.zeros_like(pose.position)), towards)
        return pixels * camera.samples - 0.5, ahead > 1e-3

    light = splat_stars(scene.sky, scene.heavens, place, (rows * SIDE, columns * SIDE)) * camera.samples**2
    tiled = light.reshape(rows, SIDE, columns, SIDE, 3).swapaxes(1, 2).reshape(rows * columns, LANES, 3)
    return tuple(tiled[..., channel] for channel in range(3))


class _Shadows(NamedTuple):
    """What it takes to look for what stands between a point and the Sun."""

    parts: Solids
    towards: Float[Array, "3 3"]
    """Two directions across the Sun's and that of the Sun, as rows."""
    slant: Float[Array, ""]
    """How far to the side the edge of the Sun lies at distance 1."""
    reach: Bounds


def _shadows(parts: Solids, heavens: Heavens) -> _Shadows:
    sun = heavens.sun
    helper = jnp.where(jnp.abs(sun[2]) < 0.9, jnp.asarray([0, 0, 1], sun.dtype), jnp.asarray([1, 0, 0], sun.dtype))
    first = jnp.cross(helper, sun)
    first = first / jnp.sqrt((first * first).sum())
    towards = jnp.stack([first, jnp.cross(sun, first), sun])
    return _Shadows(parts, towards, jnp.tan(heavens.sun_radius), bounds(parts, towards))


def _disc(camera: Camera, cut: Grid, tiles: Int[Array, "T"]) -> tuple[Array, Array] | None:
    """Which place on the Sun's disc each sample looks to, in its radii: a pixel's samples share the disc out evenly.

    One sample a pixel looks to the middle, so that shadows have hard edges. Source: H. Vogel, A better way to construct
    the sunflower head, 1979.
    """
    if camera.samples == 1:
        return None
    count, columns = camera.samples**2, cut.across.shape[0] - 1
    inner = jnp.arange(LANES, dtype=tiles.dtype)[None, :]
    row = (tiles[:, None] // columns * SIDE + inner // SIDE) % camera.samples
    column = (tiles[:, None] % columns * SIDE + inner % SIDE) % camera.samples
    number = np.arange(count)
    radius, angle = np.sqrt((number + 0.5) / count), np.pi * (3.0 - np.sqrt(5.0)) * number
    place = row * camera.samples + column
    return tuple(jnp.asarray(radius * turn(angle), jnp.float32)[place] for turn in (np.cos, np.sin))


def _sunlit(shadows: _Shadows, disc: tuple[Array, Array] | None, hits: Hit) -> Float[Array, "T 64"]:
    """Whether no other part stands between each point and its place on the Sun, 0 or 1."""
    parts, towards, slant, reach = shadows
    across, up, sun = (tuple(axis[j].reshape(1, 1) for j in range(3)) for axis in towards)
    active = hits.found & (dot(hits.normal, sun) > 0)
    points = plus(hits.point, _LIFT, hits.normal)
    if disc is None:
        slant = jnp.zeros_like(slant)
    else:
        sun = unit(plus(plus(sun, slant * disc[0], across), slant * disc[1], up))
    look_up = lambda strip: between(reach, parts.present, towards, slant, *strip)
    words = stored(look_up, (points, active), active.any(axis=1))
    anywhere = jnp.full(parts.present.shape, -jnp.inf, towards.dtype)
    blocker, _ = sweep(parts, anywhere, words, points, sun, active, first=False)
    return (active & (blocker < 0)).astype(towards.dtype)


def _port(hits: Hit) -> Int[Array, "T 64"]:
    """The docking port that each point belongs to."""
    nearest, owner = jnp.full(hits.found.shape, _PORT_RADIUS**2, jnp.float32), jnp.full(hits.found.shape, -1)
    for index, port in enumerate(PORTS):
        offset = tuple(p - np.float32(c) for p, c in zip(hits.point, port.interface))
        square = dot(offset, offset)
        owner = jnp.where(square < nearest, index, owner)
        nearest = jnp.minimum(square, nearest)
    return jnp.where(hits.found, owner, -1).astype(jnp.int32)
