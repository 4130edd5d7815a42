"""Whether a sphere swept along a segment touches axis-aligned boxes, exactly, and how near it comes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from astrojax.compilation import summed
from owm_envs.task.selected import apply_where

_SHARPNESS = 0.95
"""The least clearance is known to this fraction of itself."""


class Clearance(NamedTuple):
    """The clearance of a moving sphere to the nearest box, now and so far; m."""

    now: Float[Array, ""]
    """At most the present clearance: what was last measured, less the way gone since."""
    least: Float[Array, ""]
    """The least clearance so far, at most a twentieth and half a step's way low; not positive only after contact."""
    seen: Float[Array, ""]
    """The least of those measured: what `now` falls to without a measurement must not lower the bar for the next."""


def clearance_at(point: Float[Array, "3"], radius: Float[Array, ""], boxes: Float[Array, "N 2 3"]) -> Clearance:
    """The clearance of a sphere at rest."""
    now = swept_clearance(point, point, radius, boxes)
    # Copies: a caller may donate the state, and no buffer can be given away twice.
    return Clearance(now, jnp.copy(now), jnp.copy(now))


def advance_clearance(
    known: Clearance,
    start: Float[Array, "3"],
    end: Float[Array, "3"],
    radius: Float[Array, ""],
    boxes: Float[Array, "N 2 3"],
) -> tuple[Clearance, Bool[Array, ""]]:
    """The clearance after a move from `start` to `end`, and whether the sphere touched a box on the way, exactly.

    Boxes are looked at only when the way gone might have used the clearance up, or made it the least so far by more
    than a twentieth: far from the hull once in many steps, in a batch for the few episodes that need it.
    """
    known, start, end, radius, boxes = jax.lax.stop_gradient((known, start, end, radius, boxes))
    left = known.now - jnp.sqrt(summed((end - start) ** 2))
    unsure = ~(left > _SHARPNESS * jnp.maximum(known.seen, 0))
    now = _measured_where(unsure, left, start, end, radius, boxes)
    seen = jnp.where(unsure, jnp.minimum(known.seen, now), known.seen)
    return Clearance(now, jnp.minimum(known.least, now), seen), now <= 0


@jax.custom_batching.custom_vmap
def _measured_where(unsure, left, start, end, radius, boxes):
    return jax.lax.cond(unsure, lambda: swept_clearance(start, end, radius, boxes), lambda: left)


@_measured_where.def_vmap
def _measured_in_batch(axis_size, in_batched, unsure, left, *sphere):
    def spread(x, batched):
        return x if batched else jnp.broadcast_to(x, (axis_size, *x.shape))

    unsure, left = spread(unsure, in_batched[0]), spread(left, in_batched[1])
    batched = [x for x, b in zip(sphere, in_batched[2:]) if b]
    if not batched:  # many histories of one move
        return jnp.where(unsure, swept_clearance(*sphere), left), True

    def measure(*own):
        own = iter(own)
        return swept_clearance(*(next(own) if b else x for x, b in zip(sphere, in_batched[2:])))

    return apply_where(unsure, measure, left, *batched), True


def swept_clearance(
    start: Float[Array, "3"], end: Float[Array, "3"], radius: Float[Array, ""], boxes: Float[Array, "N 2 3"]
) -> Float[Array, ""]:
    """Distance from a sphere moving from `start` to `end` to the nearest box; m, at or below zero on contact.

    Contact is exact: the value is at or below zero if and only if the sphere touches a box on the way. Above zero it
    is a lower bound, low by at most half the travel, and exact where the midpoint lies within half the travel
    and the radius of a box. Not differentiable in reverse: gradients stop here.

    Branch and bound: a box is no nearer to the segment than to its midpoint less half its length, so boxes are
    examined in that order until none of the rest can be nearer. In a batch the loop ends with the last episode that
    needs it, and does not start where all are clear.
    """
    start, end, radius, boxes = (jax.lax.stop_gradient(jnp.asarray(x)) for x in (start, end, radius, boxes))
    half = jnp.sqrt(jnp.sum((end - start) ** 2)) / 2
    middle = (start + end) / 2
    nearest = jnp.sqrt(jnp.min(_squared_distances(middle, boxes))) - half

    def open_question(carry):
        _, least, best = carry
        return (nearest < radius) & (least < best) & (best > 0)

    def examine(carry):
        seen, _, best = carry
        # Computed again rather than carried: where no episode is near the hull, nothing but the minimum is stored.
        squared = jnp.where(seen, jnp.inf, _squared_distances(middle, boxes))
        index = jnp.argmin(squared)
        best = jnp.minimum(best, swept_distance(start, end, boxes[index]))
        least = jnp.sqrt(jnp.min(squared.at[index].set(jnp.inf))) - half
        return seen.at[index].set(True), least, best

    unseen = jnp.zeros(boxes.shape[0], bool)
    *_, best = jax.lax.while_loop(open_question, examine, (unseen, nearest, jnp.full_like(nearest, jnp.inf)))
    return jnp.where(nearest < radius, best, nearest) - radius


def nearest_point(point: Float[Array, "3"], boxes: Float[Array, "N 2 3"]) -> Float[Array, "3"]:
    """The point of the nearest box that is nearest to a point; m. Itself where it is inside."""
    low, high = boxes[jnp.argmin(_squared_distances(point, boxes))]
    return jnp.clip(point, low, high)


def _squared_distances(point: Float[Array, "3"], boxes: Float[Array, "N 2 3"]) -> Float[Array, "N"]:
    squared = 0
    for axis in range(3):
        gap = jnp.maximum(boxes[:, 0, axis] - point[axis], point[axis] - boxes[:, 1, axis])
        squared = squared + jnp.maximum(gap, 0) ** 2
    return squared


def swept_distance(start: Float[Array, "3"], end: Float[Array, "3"], box: Float[Array, "2 3"]) -> Float[Array, ""]:
    """Exact least distance from the segment `start`-`end` to one box, zero inside; m.

    The squared distance along the segment is convex and piecewise quadratic with a kink wherever a coordinate
    crosses a face, so its slope is increasing and piecewise linear: the minimum lies on the linear piece between the
    last kink of negative and the first of positive slope.
    """
    travel = end - start
    moving = jnp.abs(travel) > 0
    divisor = jnp.where(moving, travel, 1)
    kinks = jnp.where(moving[None], jnp.clip((box - start[None]) / divisor[None], 0, 1), 0).reshape(6)
    times = jnp.sort(jnp.concatenate([kinks, jnp.asarray([0, 1], kinks.dtype)]))

    def outside(t):
        point = start + t * travel
        return jnp.minimum(point - box[0], 0) + jnp.maximum(point - box[1], 0)

    slope = jnp.sum(jax.vmap(outside)(times) * travel[None], axis=-1)
    before = jnp.clip(jnp.sum(slope <= 0) - 1, 0, 6)
    low, high = slope[before], slope[before + 1]
    rise = high - low
    fraction = jnp.clip(jnp.where(rise > 0, -low / jnp.where(rise > 0, rise, 1), 0), 0, 1)
    best = times[before] + fraction * (times[before + 1] - times[before])
    return jnp.sqrt(jnp.sum(outside(best) ** 2))
