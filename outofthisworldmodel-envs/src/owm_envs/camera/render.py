"""From a scene to a picture, for one instant; the caller vmaps."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Shaped

from owm_envs.camera.lens import Camera, Pose, Rays, picture, placed, rays
from owm_envs.camera.scene import Scene, assembled
from owm_envs.camera.shade import Lights, developed, encoded, radiance
from owm_envs.camera.solids import Solids, crossing
from owm_envs.camera.surface import look
from owm_envs.camera.trace import LANES, between, bounds, columns_and_rows, sweep
from owm_envs.camera.vectors import Vector, components, dot, onto, plus, unit, where
from owm_envs.view import View

OUTPUTS = ("rgb", "depth", "part", "port", "normal")
BLOCKS = 16
_LIFT = 0.005  # a shadow's ray starts this far off its surface [m]


class Hits(NamedTuple):
    """What each ray meets first; numbers of a miss are finite and mean nothing."""

    found: Array
    part: Array
    """Row of the assembled parts."""
    distance: Array
    point: Vector
    normal: Vector
    """Station frame."""
    place: Vector
    inner_normal: Vector
    """In the part's own frame."""


def _nearest_first(solids: Solids, rays: Rays, pose: Pose, perspective: bool) -> tuple[Solids, Array, Array]:
    """The solids in order of the least distance at which a ray may meet them; that distance; the order."""
    offset = solids.centre - pose.position[None, :]
    along = jnp.sqrt((offset * offset).sum(axis=1)) if perspective else offset @ pose.axes[:, 2]
    closest = along - jnp.sqrt((solids.half * solids.half).sum(axis=1))
    order = jnp.argsort(closest)
    return jax.tree.map(lambda a: a[order], solids), closest[order], order


def _meet(solids: Solids, owner: Array, origin: Vector, way: Vector) -> Hits:
    """Meet each ray with the solid chosen for it, once more and for good: this can be differentiated."""
    found = owner >= 0
    chosen = jnp.maximum(owner, 0)
    pick = lambda table: table[chosen]
    centre = tuple(pick(solids.centre[:, j]) for j in range(3))
    axis = tuple(tuple(pick(solids.rotation[:, i, j]) for i in range(3)) for j in range(3))
    half = tuple(pick(solids.half[:, j]) for j in range(3))
    quadric = tuple(pick(solids.quadric[:, j]) for j in range(4))
    shift = tuple(o - c for o, c in zip(origin, centre))
    start, ray = tuple(dot(a, shift) for a in axis), tuple(dot(a, way) for a in axis)
    met = crossing(start, ray, half, quadric)
    distance = jnp.where(found, met.enter, 1.0)
    place = plus(start, distance, ray)
    k, m, l, _ = quadric
    bowed = (k * place[0], k * place[1], m * place[2] + 0.5 * l)
    slabs = met.slabs
    curved = met.bow >= jnp.maximum(jnp.maximum(slabs[0], slabs[1]), slabs[2])
    first = (slabs[0] >= slabs[1]) & (slabs[0] >= slabs[2])
    second = ~first & (slabs[1] >= slabs[2])
    flat = tuple(jnp.where(on, -jnp.sign(w), 0.0) for on, w in zip((first, second, ~first & ~second), ray))
    inner = where(curved, unit(bowed), flat)
    normal = tuple(axis[0][i] * inner[0] + axis[1][i] * inner[1] + axis[2][i] * inner[2] for i in range(3))
    point = plus(origin, distance, way)
    return Hits(found, chosen, distance, point, normal, place, inner)


def render(scene: Scene, view: View, camera: Camera, lights: Lights) -> dict[str, Shaped[Array, "H W ..."]]:
    """Draw what a camera sees.

    Returns:
        by name of the camera's `outputs`: rgb (H, W, 3) uint8 sRGB; depth (H, W) float32, along the optical axis [m],
        infinite where no part is; part (H, W) int32, the row of the station's table, then of the chaser's, then of each
        visitor's, -1 for none; normal (H, W, 3) float32, unit, station frame, zero for none.
    """
    pose = placed(camera, view)
    cast = rays(camera, pose)
    perspective = camera.projection == "perspective"
    parts, closest, order = _nearest_first(assembled(scene, view), cast, pose, perspective)
    owner = _owners(*jax.lax.stop_gradient((parts, closest, cast, pose)), perspective)
    tiles = owner.shape[0]
    spread = lambda v: tuple(jnp.broadcast_to(a, (tiles, LANES)) for a in v)
    origin, way = (v if v[0].shape[0] > 1 else None for v in (cast.origin, cast.way))
    one = lambda v: tuple(a[0] for a in v)
    chunk = max(4, tiles // BLOCKS)

    def meet(tile):
        owner, origin, way = tile
        origin, way = (one(cast.origin) if origin is None else origin), (one(cast.way) if way is None else way)
        return _meet(parts, owner, origin, way)

    hits = jax.lax.map(meet, (owner, origin, way), batch_size=chunk)
    lit = jax.lax.stop_gradient(_sunlit(parts, hits, lights, chunk))
    gain = jnp.exp2(camera.exposure)

    def shade(tile):
        hits, lit, way = tile
        way = one(cast.way) if way is None else way
        pick = lambda table: table[hits.part]
        half = tuple(pick(parts.half[:, j]) for j in range(3))
        width = hits.distance * cast.spread if perspective else cast.spread
        seen = look(scene.materials, pick(parts.material), hits.place, hits.inner_normal, half, width)
        light = radiance(lights, seen, hits.normal, tuple(-w for w in way), hits.distance, lit)
        return tuple(developed(gain * jnp.where(hits.found, channel, 0.0)) for channel in light)

    light = jax.lax.map(shade, (hits, lit, way), batch_size=chunk)
    if camera.samples == 1:
        light = jax.lax.map(lambda tile: tuple(jnp.round(encoded(a)).astype(jnp.uint8) for a in tile), light, batch_size=chunk)
    image = jnp.stack([picture(channel, camera) for channel in light], axis=-1)
    if camera.samples > 1:
        shape = (camera.height, camera.samples, camera.width, camera.samples, 3)
        image = image.reshape(shape).mean(axis=(1, 3))
        image = jnp.round(encoded(image)).astype(jnp.uint8)
    return {"rgb": image}


def _owners(parts: Solids, closest: Array, cast: Rays, pose: Pose, perspective: bool) -> Array:
    words = columns_and_rows(parts, pose.position, pose.axes, cast.across, cast.down, perspective)
    tiles = words.shape[0]
    return sweep(parts, closest, words, cast.origin, cast.way, jnp.ones((tiles, 64), bool), first=True)


def _sunlit(parts: Solids, hits: Hits, lights: Lights, chunk: int) -> Array:
    """Whether no other part stands between each point and the Sun."""
    sun = lights.sun
    towards = tuple(sun[j].reshape(1, 1) for j in range(3))
    active = hits.found & (dot(hits.normal, towards) > 0)
    points = plus(hits.point, _LIFT, hits.normal)
    helper = jnp.where(jnp.abs(sun[2]) < 0.9, jnp.asarray([0.0, 0.0, 1.0], sun.dtype), jnp.asarray([1.0, 0.0, 0.0], sun.dtype))
    first = jnp.cross(helper, sun)
    first = first / jnp.sqrt((first * first).sum())
    frame = jnp.stack([first, jnp.cross(sun, first), sun])
    words = between(parts, frame, points, active, chunk)
    blocker = sweep(parts, jnp.full(parts.present.shape, -1e30, jnp.float32), words, points, towards, active, first=False)
    return (active & (blocker < 0)).astype(jnp.float32)
