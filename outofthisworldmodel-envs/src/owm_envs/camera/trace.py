"""Which solid does each ray meet first? Rays go in tiles of 8 by 8 pixels, and a tile meets only what may cover it.

1. Solids are sorted by distance, nearest first. A tile's candidates are bits, one a solid: those whose bounding box
   lies on the far side of none of the tile's borders (`columns_and_rows`, `between`).
2. Tiles are sorted by how many candidates they have, and go through in strips of alike ones. Each pass of a strip meets
   the next candidate of every tile in it with all 64 rays (`sweep`), until none can be nearer than what is found.

Nothing here is differentiated: it only chooses. Source of the ideas: Fuchs et al., Pixel-Planes 5, SIGGRAPH 1989 (bins
of a screen); Garanzha and Loop, Fast Ray Sorting and Breadth-First Packet Traversal, Eurographics 2010 (packets).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from owm_envs.camera.solids import EXACT, FAR, Solids, crossing
from owm_envs.camera.vectors import Vector, onto

SIDE = 8
"""Pixels along the side of a tile."""
LANES = SIDE * SIDE
_PIECES = 4
_POOL = 64  # tiles that go through their candidates in step
_WORD = 32

Words = UInt32[Array, "T W"]
"""The candidates of each tile: bit i of word w stands for solid 32 w + i."""


class Bounds(NamedTuple):
    """Least and greatest of each solid's bounding box along some directions."""

    least: Float[Array, "D N"]
    most: Float[Array, "D N"]


def bounds(solids: Solids, directions: Float[Array, "D 3"]) -> Bounds:
    """Give how far each solid's box reaches along directions (of any length), from the frame's origin."""
    product = partial(jnp.matmul, precision=EXACT)
    middle = product(directions, solids.centre.T)
    axes = solids.rotation * solids.half[:, None, :]
    reach = sum(jnp.abs(product(directions, axes[:, :, j].T)) for j in range(3))
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
    reach: Bounds,
    present: Bool[Array, "N"],
    towards: Float[Array, "3 3"],
    slant: Float[Array, ""],
    points: Vector,
    active: Bool[Array, "T L"],
) -> Words:
    """Give what may stand between the points of each tile and a far light.

    Args:
        reach: of the solids along `towards`.
        present: which of them are there.
        towards: two directions across the light's and that of the light itself, as rows.
        slant: how far to the side, at distance 1, the edge of the light lies from its middle.
        points: (T, L) [m].
        active: which points count; a tile without any has no candidate.
    """
    least, most = reach
    across, up, along = (sum(axis[j] * points[j] for j in range(3)) for axis in towards)
    far = most[2][None, :] - jnp.where(active, along, FAR).min(axis=1)[:, None]
    mask = present[None, :] & active.any(axis=1)[:, None] & (far >= 0)
    aside = slant * far
    for axis, place in enumerate((across, up)):
        mask = mask & (most[axis][None, :] + aside >= jnp.where(active, place, FAR).min(axis=1)[:, None])
        mask = mask & (least[axis][None, :] - aside <= jnp.where(active, place, -FAR).max(axis=1)[:, None])
    return packed(mask)


def busiest_first(words: Words) -> Int[Array, "T"]:
    """Give the order of the tiles by how many candidates they have, most first."""
    return jnp.argsort(-jax.lax.population_count(words).astype(jnp.int32).sum(axis=1))


def in_strips(function: Callable[[Any], Any], arrays: Any, busy: Bool[Array, "T"], size: int, idle: int = 0) -> Any:
    """Call a function for some tiles at a time. What it returns is stored before anything reads it.

    Left to itself a compiler would rather find a number anew for each of its readers.

    Args:
        function: of some rows of `arrays`, to arrays of as many rows.
        arrays: a row a tile; or one row, which goes to all.
        busy: which tiles have something to do. A strip in which none has, in none of the examples of a batch, is left
            out.
        size: how many tiles go at a time.
        idle: what stands in place of what was left out.
    """
    leaves, tree = jax.tree.flatten(arrays)
    tiles = busy.shape[0]
    size = min(size, tiles)
    strips = -(-tiles // size)
    own = [leaf.shape[0] == tiles for leaf in leaves]

    def folded(leaf):
        padding = ((0, strips * size - tiles), *((0, 0),) * (leaf.ndim - 1))
        return jnp.pad(leaf, padding).reshape(strips, size, *leaf.shape[1:])

    def strip(rows):
        rows = iter(rows)
        here = tree.unflatten([next(rows) if mine else leaf for mine, leaf in zip(own, leaves)])
        blank = jax.tree.map(lambda part: jnp.full(part.shape, idle, part.dtype), jax.eval_shape(function, here))
        return jax.lax.cond(_anyone(next(rows).any()), function, lambda _: blank, here)

    function = jax.jit(function, inline=True)
    rows = [folded(leaf) for mine, leaf in zip(own, leaves) if mine]
    results = jax.lax.map(strip, [*rows, folded(busy)])
    return jax.tree.map(lambda a: a.reshape(strips * size, *a.shape[2:])[:tiles], results)


def stored(function: Callable[[Any], Any], arrays: Any, busy: Bool[Array, "T"], idle: int = 0) -> Any:
    """Call a function of tiles, some at a time, as `in_strips` does."""
    return in_strips(function, arrays, busy, max(1, busy.shape[0] // _PIECES), idle)


def settled(always: Bool[Array, ""], arrays: Any) -> Any:
    """Give arrays as they are, but stored before anything reads them.

    A compiler cannot look through a conditional, which is why `always` must be true, and known only when the program
    runs. (`astrojax.compilation.stored` says it in so many words, but XLA heeds it with options alone.)
    """
    blank = jax.tree.map(jnp.zeros_like, arrays)
    return jax.lax.cond(_anyone(always), lambda arrays: arrays, lambda _: blank, arrays)


@jax.custom_batching.custom_vmap
def _anyone(yes: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether any example of a batch says yes: one answer for all, so that a conditional on it stays one."""
    return yes


@_anyone.def_vmap
def _(size, batched, yes):
    return _anyone(yes.any(axis=0) if batched[0] else yes), False


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


class _March(NamedTuple):
    """A block of tiles on its way through its candidates.

    What a pass reads twice was stored by the pass before it, or a compiler would find it anew for each reader: so the
    next candidate is looked up one pass ahead, and who owns a ray is settled one pass behind.
    """

    n: Int[Array, ""]
    """How many candidates each tile has met."""
    next: Int[Array, "B"]
    last: Int[Array, "B"]
    """The candidates of this pass and of the one before."""
    best: Float[Array, "B L"]
    before: Float[Array, "B L"]
    """The nearest distance found so far, and before the last pass."""
    owner: Int[Array, "B L"]
    """Whose that one was."""
    more: Bool[Array, ""]


class Pool(NamedTuple):
    """Tiles that go through their candidates together, of one picture or of many."""

    table: Float[Array, "G N 20"]
    """Of each picture its solids: centre, rotation, half, quadric, and the distance before which no ray meets it."""
    group: Int[Array, "T"]
    """Which picture a tile is of."""
    words: Words
    origin: Vector
    way: Vector
    active: Bool[Array, "T L"]


def sweep(
    solids: Solids,
    closest: Float[Array, "N"],
    words: Words,
    origin: Vector,
    way: Vector,
    active: Bool[Array, "T L"],
    first: bool,
) -> tuple[Int[Array, "T L"], Float[Array, "T L"]]:
    """Give the solid that each ray meets; not to be differentiated.

    Args:
        closest: no ray meets the solid before this distance [m]; ascending.
        words: candidates of each tile.
        origin, way: of the rays, (T, L), or (1, 1) where all share it; `way` has unit length.
        active: which rays count.
        first: whether the nearest is asked for; else any will do, and it may also surround the origin.

    Returns:
        The row of the solid, -1 for none, and the distance to it [m].
    """
    table = jnp.concatenate(
        [solids.centre, solids.rotation.reshape(-1, 9), solids.half, solids.quadric, closest[:, None]], axis=1
    )
    tiles = words.shape[0]
    each = lambda v: tuple(jnp.broadcast_to(a, (tiles, a.shape[1])) for a in v)
    pool = Pool(table[None], jnp.zeros(tiles, jnp.int32), words, each(origin), each(way), active)
    return (_nearest if first else _any)(jax.lax.stop_gradient(pool))


def _pooled(first: bool):
    """The search of a pool. A batch of pools is one larger pool: the tiles of all its pictures go through sorted."""

    @jax.custom_batching.custom_vmap
    def search(pool: Pool):
        return _search(pool, first)

    @search.def_vmap
    def _(size, batched, pool):
        pool = jax.tree.map(lambda a, on: a if on else jnp.broadcast_to(a, (size, *a.shape)), pool, batched[0])
        groups = pool.table.shape[1]
        group = pool.group + groups * jnp.arange(size, dtype=jnp.int32)[:, None]
        flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), pool._replace(group=group))
        found = jax.tree.map(lambda a: a.reshape(size, -1, *a.shape[1:]), search(flat))
        return found, jax.tree.map(lambda _: True, found)

    @jax.custom_jvp
    def still(pool: Pool):
        return search(pool)

    @still.defjvp
    def _(primals, tangents):
        owner, near = still(*primals)
        return (owner, near), (np.zeros(owner.shape, jax.dtypes.float0), jnp.zeros_like(near))

    return still


_nearest, _any = _pooled(first=True), _pooled(first=False)


def _search(pool: Pool, first: bool) -> tuple[Int[Array, "T L"], Float[Array, "T L"]]:
    solids = pool.table.shape[1]
    table = pool.table.reshape(-1, pool.table.shape[-1])

    def through(strip):
        group, words, start, ray, live = strip
        counts = jnp.cumsum(jax.lax.population_count(words).astype(jnp.int32), axis=1)
        total = counts[:, -1]

        def candidate(n):
            which = _nth(words, counts, jnp.minimum(jnp.full_like(total, n), total - 1))
            return group * solids + jnp.minimum(which, solids - 1)

        def meet(state: _March) -> _March:
            row = table[state.next]
            column = lambda j: row[:, j, None]
            shift = tuple(s - column(j) for j, s in enumerate(start))
            axes = row[:, 3:12].reshape(-1, 1, 3, 3)
            half, quadric = tuple(column(12 + j) for j in range(3)), tuple(column(15 + j) for j in range(4))
            found = crossing(onto(axes, shift), onto(axes, ray), half, quadric)
            ahead = (found.enter > 0) & (found.enter < state.best) if first else (found.leave > 0) & (state.best > 0)
            hit = ahead & (found.enter <= found.leave) & (state.n < total)[:, None]
            best = jnp.where(hit, found.enter if first else -FAR, state.best)
            n = state.n + 1
            more = (n < total) & (row[:, 19] < best.max(axis=1))
            return _March(n, candidate(n), state.next, best, state.best, settled(state), more.any())

        def settled(state: _March) -> Int[Array, "B L"]:
            return jnp.where(state.best < state.before, state.last[:, None], state.owner)

        best = jnp.where(live, FAR, -FAR).astype(table.dtype)
        zero, nobody = jnp.zeros((), jnp.int32), jnp.full(best.shape, -1, jnp.int32)
        begun = _March(zero, candidate(zero), jnp.zeros_like(total), best, best, nobody, (total > 0).any())
        ended = jax.lax.while_loop(lambda state: state.more, meet, begun)
        owner = settled(ended)
        return jnp.where(owner < 0, owner, owner - group[:, None] * solids), ended.best

    order = busiest_first(pool.words)
    rows = jax.tree.map(lambda a: a[order], pool[1:])
    found = in_strips(through, rows, (rows[1] != 0).any(axis=1), _POOL, idle=-1)
    back = jnp.argsort(order)
    return jax.tree.map(lambda a: a[back], found)
