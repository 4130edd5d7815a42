"""What actions do to velocity and rate, read off the candidates that a model already flew."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_DAMPING = 1e-5
"""Squared share of the largest effect below which an action is taken for one that does nothing."""


OUT = 0.01
"""Of the largest squared acceleration: an axis that gives less is out."""


class Effect(NamedTuple):
    """What actions do over some steps, as candidates that already flew tell.

    Attributes:
        action: mean over candidates and steps, fractions of the limits.
        change: mean over candidates of the changes of velocity (m/s, station frame) and rate (rad/s).
        per_action: by how much each of these grows for each of the actions (changes, actions).
        slope: actions that make one of these larger by one (changes, actions); none in a direction that no action
            leads to.
        elapsed: s.
    """

    action: Float[Array, "6"]
    change: Float[Array, "6"]
    per_action: Float[Array, "6 6"]
    slope: Float[Array, "6 6"]
    elapsed: Float[Array, ""]


def effect_of(
    actions: Float[Array, "K T 6"], before: Float[Array, "K 13"], after: Float[Array, "K 13"], elapsed: float
) -> Effect:
    """Fit, by least squares, the changes over some steps to the actions of them.

    Over several steps it also finds what thrusters do that answer late.

    Args:
        actions: fractions of the limits, spread by the planner's noise.
        before, after: predicted views around those steps, `elapsed` seconds apart.
    """
    action = jnp.mean(actions, axis=1)
    changes = (after - before)[:, np.array([3, 4, 5, 10, 11, 12])]
    mean_change, mean_action = jnp.mean(changes, axis=0), jnp.mean(action, axis=0)
    spread = action - mean_action
    ridge = 1e-6 * len(actions) * jnp.eye(6, dtype=changes.dtype)
    per_action = jnp.linalg.solve(spread.T @ spread + ridge, spread.T @ (changes - mean_change)).T
    # m/s and rad/s differ by orders of magnitude.
    scale = jnp.repeat(jnp.max(jnp.abs(per_action).reshape(2, 18), axis=1), 3)
    scaled = per_action / scale[:, None]
    damped = scaled @ scaled.T + _DAMPING * jnp.eye(6, dtype=changes.dtype)
    slope = jnp.linalg.solve(damped, scaled) / scale[:, None]
    return Effect(mean_action, mean_change, per_action, slope, jnp.asarray(elapsed, changes.dtype))


def no_effect(dtype: str = "float32") -> Effect:
    """Nothing found out yet."""
    zero = jnp.zeros(6, dtype)
    return Effect(zero, zero, jnp.zeros((6, 6), dtype), jnp.zeros((6, 6), dtype), jnp.ones((), dtype))


def forces(effect: Effect) -> Float[Array, "3 3"]:
    """Return the acceleration, m/s2 in the station frame, that the whole of each force (columns) gives."""
    return effect.per_action[:3, :3] / effect.elapsed


def wrench_for(effect: Effect, change: Float[Array, "*T 6"]) -> Float[Array, "*T 6"]:
    """Return the wrench, in fractions of the limits, that changes velocity and rate so over `elapsed`."""
    return effect.action + (change - effect.change) @ effect.slope


def coasting_wrench(effect: Effect) -> Float[Array, "6"]:
    """Return the wrench, in fractions of the limits, under which velocity and rate stay as they are.

    In free space it is zero; under a steady acceleration, known to the model or found by the corrector, it is what
    cancels it. A warm start continued by zeros instead settles some 0.1 m off the goal for each 0.01 m/s2.
    """
    wrench = wrench_for(effect, jnp.zeros_like(effect.change))
    # A model that heeds no action has no such wrench.
    return jnp.clip(jnp.where(jnp.all(jnp.isfinite(wrench)), wrench, 0), -1, 1)


def authority(effect: Effect) -> Float[Array, ""]:
    """Return the acceleration, m/s2, that the limits allow in whatever direction; infinite if no action is heeded.

    A direction that is out does not count.
    """
    given = forces(effect)
    squares = jnp.linalg.eigvalsh(given @ given.T)
    able = jnp.sqrt(jnp.min(jnp.where(squares > OUT * squares[-1], squares, jnp.inf)))
    return jnp.where(jnp.isfinite(able), able, jnp.inf)
