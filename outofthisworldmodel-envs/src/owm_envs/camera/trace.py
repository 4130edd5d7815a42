"""Which solid does each ray meet first? Rays go in tiles of 8 by 8 pixels, and a tile meets only what may cover it.

1. Solids are sorted by distance, nearest first. A tile's candidates are bits, one a solid: the bounding box of a solid is
   on neither far side of the tile (`columns_and_rows`, `between`).
2. Tiles are sorted by how many candidates they have, and go through in blocks of alike ones: each pass of a block meets
   the next candidate of every tile in it with all 64 rays (`sweep`), until none can be nearer than what is found.

Nothing here is differentiated: it only chooses. Source of the idea: Fuchs et al., Pixel-Planes 5, SIGGRAPH 1989 (bins of a
screen); Garanzha and Loop, Fast Ray Sorting and Breadth-First Packet Traversal, Eurographics 2010 (packets).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from owm_envs.camera.solids import FAR, Solids, crossing
from owm_envs.camera.vectors import Vector, onto

SIDE = 8
"""Pixels along the side of a tile."""
LANES = SIDE * SIDE
_WORD = 32

Words = UInt32[Array, "T W"]
"""The candidates of each tile: bit i of word w stands for solid 32 w + i."""


class Bounds(NamedTuple):
    """Least and greatest of each solid's bounding box along some directions."""

    least: Float[Array, "D N"]
    most: Float[Array, "D N"]


def bounds(solids: Solids, directions: Float[Array, "D 3"]) -> Bounds:
    """Give how far each solid's box reaches along directions (of any length), from the frame's origin."""
    middle = directions @ solids.centre.T
    axes = solids.rotation * solids.half[:, None, :]
    reach = jnp.abs(jnp.einsum("di,nij->dnj", directions, axes)).sum(axis=-1)
    return Bounds(middle - reach, middle + reach)


def packed(mask: Bool[Array, "T N"]) -> Words:
    """Give booleans as bits."""
    tiles, count = mask.shape
    words = -(-count // _WORD)
    mask = jnp.pad(mask, ((0, 0), (0, words * _WORD - count))).reshape(tiles, words, _WORD)
    powers = jnp.left_shift(jnp.uint32(1), jnp.arange(_WORD, dtype=jnp.uint32))
    return jnp.where(mask, powers[None, None, :], jnp.uint32(0)).sum(axis=-1, dtype=jnp.uint32)


def columns_and_rows(
    solids: Solids,
    origin: Float[Array, "3"],
    axes: Float[Array, "3 3"],
    across: Float[Array, "C"],
    down: Float[Array, "R"],
    perspective: bool,
) -> Words:
    """Give the candidates of every tile of a picture, row by row.

    A tile lies between four planes that it shares with its column and its row. So a solid is tested against each plane
    of a column and of a row once, not against each tile.

    Args:
        origin: of the camera [m].
        axes: its right, up and forward in columns.
        across, down: where the borders of columns and rows lie on the plane at distance 1, or in metres if parallel.
        perspective: whether rays part from the origin; else they run parallel.
    """
    right, up, forward = axes.T
    lean = forward if perspective else jnp.zeros_like(forward)
    offset = solids._replace(centre=solids.centre - origin[None, :])

    def beyond(axis, places):
        least, most = bounds(offset, axis[None, :] - places[:, None] * lean[None, :])
        shift = 0.0 if perspective else places[:, None]
        return least - shift > 0, most - shift < 0

    more, less = beyond(right, across)
    column = ~(less[:-1] | more[1:])
    more, less = beyond(up, down)  # falling from the top
    row = ~(more[:-1] | less[1:])
    ahead = bounds(offset, forward[None, :]).most[0] > 0
    column = column & (ahead & solids.present)[None, :]
    both = packed(row)[:, None, :] & packed(column)[None, :, :]
    return both.reshape(-1, both.shape[-1])


def between(
    solids: Solids, towards: Float[Array, "3 3"], points: Vector, active: Bool[Array, "L"]
) -> UInt32[Array, "W"]:
    """Give what may stand between the points of one tile and a far light.

    Args:
        towards: two directions across the light's and that of the light itself, as rows.
        points: (L,) [m].
        active: (L,) which points count; without any there is no candidate.
    """
    least, most = bounds(solids, towards)
    mask = solids.present & active.any()
    for axis in range(3):
        place = sum(towards[axis, j] * points[j] for j in range(3))
        mask = mask & (most[axis] >= jnp.where(active, place, FAR).min())
        if axis < 2:
            mask = mask & (least[axis] <= jnp.where(active, place, -FAR).max())
    return packed(mask[None, :])[0]


def _nth(words: UInt32[Array, "B W"], upto: Int[Array, "B W"], n: Int[Array, "B"]) -> Int[Array, "B"]:
    """The place of bit number n that is set; `upto` counts those up to the end of each word."""
    passed = upto <= n[:, None]
    word = jnp.minimum(passed.sum(axis=1, dtype=jnp.int32), words.shape[1] - 1)
    left = n - jnp.where(passed, upto, 0).max(axis=1)
    bits = jnp.take_along_axis(words, word[:, None], axis=1)[:, 0]
    place = jnp.zeros_like(n)
    for half in (16, 8, 4, 2, 1):
        low = bits & jnp.uint32((1 << half) - 1)
        inside = jax.lax.population_count(low).astype(jnp.int32)
        higher = left >= inside
        left = jnp.where(higher, left - inside, left)
        bits = jnp.where(higher, bits >> jnp.uint32(half), low)
        place = jnp.where(higher, place + half, place)
    return word * _WORD + place


def sweep(
    solids: Solids,
    closest: Float[Array, "N"],
    words: Words,
    origin: Vector,
    way: Vector,
    active: Bool[Array, "T L"],
    first: bool,
) -> Int[Array, "T L"]:
    """Give the solid that each ray meets, or -1.

    Args:
        closest: no ray meets the solid before this distance [m]; ascending.
        words: candidates of each tile.
        origin, way: of the rays, (T, L), (T, 1) or (1, 1); `way` has unit length.
        active: (T, L) which rays count.
        first: whether the nearest is asked for; else any will do, and it may also surround the origin.
    """
    tiles = words.shape[0]
    block = max(4, round(tiles**0.5))
    blocks = -(-tiles // block)
    words = jnp.pad(words, ((0, blocks * block - tiles), (0, 0)))
    upto = jnp.cumsum(jax.lax.population_count(words).astype(jnp.int32), axis=1)
    order = jnp.argsort(-upto[:, -1])
    last = solids.present.shape[0] - 1
    table = jnp.concatenate(
        [solids.centre, solids.rotation.reshape(-1, 9), solids.half, solids.quadric, closest[:, None]], axis=1
    )

    def through(number: Int[Array, ""]) -> Int[Array, "B L"]:
        chosen = jax.lax.dynamic_slice(order, (number * block,), (block,))
        own = lambda a: a if a.shape[0] == 1 else a[jnp.minimum(chosen, tiles - 1)]
        bits, counts = words[chosen], upto[chosen]
        total = counts[:, -1]
        start, ray, live = tuple(map(own, origin)), tuple(map(own, way)), own(active)

        def meet(state):
            n, best, owner, _ = state
            which = jnp.minimum(_nth(bits, counts, jnp.minimum(jnp.full_like(total, n), total - 1)), last)
            row = table[which]
            column = lambda j: row[:, j, None]
            shift = tuple(s - column(j) for j, s in enumerate(start))
            axes = row[:, 3:12].reshape(-1, 1, 3, 3)
            half, quadric = tuple(column(12 + j) for j in range(3)), tuple(column(15 + j) for j in range(4))
            found = crossing(onto(axes, shift), onto(axes, ray), half, quadric)
            ahead = (found.enter > 0) & (found.enter < best) if first else (found.leave > 0) & (best > 0)
            hit = ahead & (found.enter <= found.leave) & (n < total)[:, None]
            best = jnp.where(hit, found.enter if first else -FAR, best)
            owner = jnp.where(hit, which[:, None], owner)
            more = (n + 1 < total) & (row[:, 19] < best.max(axis=1))
            return n + 1, best, owner, more.any()

        best = jnp.where(live, FAR, -FAR).astype(table.dtype)
        state = (jnp.zeros((), jnp.int32), best, jnp.full(best.shape, -1, jnp.int32), (total > 0).any())
        return jax.lax.while_loop(lambda state: state[3], meet, state)[2]

    found = jax.lax.map(through, jnp.arange(blocks)).reshape(-1, active.shape[1])
    return found[jnp.argsort(order)][:tiles]
