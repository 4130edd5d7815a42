"""How near moving spheres come to each other within a step, exactly."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from owm_envs.task.events import safe_norm


def swept_separation(
    start: Float[Array, "3"], end: Float[Array, "3"], other_start: Float[Array, "3"], other_end: Float[Array, "3"]
) -> Float[Array, ""]:
    """Least distance between two points that move uniformly and at once; m.

    One moves from `start` to `end` while the other moves from `other_start` to `other_end`: against each other they
    run along a segment, of which this is the distance to the origin.
    """
    first = other_start - start
    travel = other_end - end - first
    squared = jnp.sum(travel * travel)
    moving = squared > 0
    fraction = jnp.where(moving, -jnp.sum(first * travel) / jnp.where(moving, squared, 1), 0)
    return safe_norm(first + jnp.clip(fraction, 0, 1) * travel)
