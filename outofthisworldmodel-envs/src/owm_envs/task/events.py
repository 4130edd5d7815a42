"""What can end an episode: docking, collision, escape, the horizon."""

from enum import IntEnum
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from astrojax.compilation import all_of, summed
from owm_envs.config.params import DockingParams


class Outcome(IntEnum):
    """What an episode has come to; all but `RUNNING` end it."""

    RUNNING = 0
    DOCKED = 1
    COLLIDED = 2
    ESCAPED = 3
    TIMEOUT = 4
    INVALID_ACTION = 5
    DIVERGED = 6
    """The equations of motion gave no usable number: the state before is kept."""


OUTCOME_NAMES: tuple[str, ...] = tuple(outcome.name.lower() for outcome in Outcome)
"""Of each outcome, in the order of their numbers."""


class Closest(NamedTuple):
    """Errors to the goal at the closest approach so far: m, m/s, rad, rad/s, and its time s."""

    distance: Float[Array, ""]
    speed: Float[Array, ""]
    attitude: Float[Array, ""]
    rate: Float[Array, ""]
    time: Float[Array, ""]


def error_norms(error: Float[Array, "12"]) -> Float[Array, "4"]:
    """Norms of a goal error's four parts: m, m/s, rad, rad/s."""
    return safe_norm(error.reshape(4, 3))


def safe_norm(vectors: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Euclidean norm over the last axis with a zero gradient at the origin."""
    return safe_root(summed(jnp.moveaxis(vectors * vectors, -1, 0)))


def safe_root(squared: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root with a zero gradient at zero."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)


def is_docked(norms: Float[Array, "4"], tolerances: DockingParams) -> Bool[Array, ""]:
    """Whether all four errors are below their tolerances."""
    return all_of(norms < jnp.stack(tolerances))
