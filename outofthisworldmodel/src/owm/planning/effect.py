"""What actions do to velocity and rate, read off the candidates that a model already flew."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Effect(NamedTuple):
    """What actions do over some steps, as candidates that already flew tell.

    Attributes:
        action: mean over candidates and steps, fractions of the limits.
        change: mean over candidates of the changes of velocity (m/s, station frame) and rate (rad/s).
        slope: actions that make one of these larger by one.
        elapsed: s.
    """

    action: Float[Array, "6"]
    change: Float[Array, "6"]
    slope: Float[Array, "6 6"]
    elapsed: Float[Array, ""]


def effect_of(
    actions: Float[Array, "K T 6"], before: Float[Array, "K 13"], after: Float[Array, "K 13"], elapsed: float
) -> Effect:
    """Fit, by least squares, the actions of some steps to the changes over them.

    Over several steps it also finds what thrusters do that answer late.

    Args:
        actions: fractions of the limits, spread by the planner's noise.
        before, after: predicted views around those steps, `elapsed` seconds apart.
    """
    action = jnp.mean(actions, axis=1)
    changes = (after - before)[:, np.array([3, 4, 5, 10, 11, 12])]
    mean_change, mean_action = jnp.mean(changes, axis=0), jnp.mean(action, axis=0)
    scale = jnp.std(changes, axis=0)  # m/s and rad/s differ by orders of magnitude
    spread = (changes - mean_change) / scale
    ridge = 1e-6 * len(actions) * jnp.eye(6, dtype=changes.dtype)
    slope = jnp.linalg.solve(spread.T @ spread + ridge, spread.T @ (action - mean_action))
    return Effect(mean_action, mean_change, slope / scale[:, None], jnp.asarray(elapsed, changes.dtype))


def no_effect(dtype: str = "float32") -> Effect:
    """Nothing found out yet."""
    zero = jnp.zeros(6, dtype)
    return Effect(zero, zero, jnp.zeros((6, 6), dtype), jnp.ones((), dtype))


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
    """Return the acceleration, m/s2, that the limits allow in whatever direction; infinite if no action is heeded."""
    largest = jnp.max(jnp.sum(effect.slope[:3] ** 2, axis=0))
    able = 1.0 / (effect.elapsed * jnp.sqrt(largest))
    return jnp.where(jnp.isfinite(able), able, jnp.inf)
