"""What the safe objective tracks in one replan, and around what it samples; a crippled vehicle flies by other numbers.

A crippled vehicle has lost an axis of force. It flies slowly, turns so that what is left pushes where it matters
(`owm.planning.facing`), hardly pushes while it turns, and aims straight for the goal in the end. One that has
too little left leaves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from owm.planning.config import Shape, Tuning
from owm.planning.effect import Effect, authority, wrench_for
from owm.planning.facing import facing, facing_out, is_crippled, is_turned, missing_forces
from owm.planning.reference import safe_reference, turning_reference
from owm_envs.field import clearance
from owm_envs.policies.guidance import Goal
from owm_envs.view import View

_SHARE = 0.9
"""Of what the thrusters can do: what the safe approach is to ask of them."""
_CRIPPLED = {"pace": 0.16, "steady": 6.0}
"""Of the goal of a crippled vehicle, every other push of which waits for a turn."""
_GATE = 1.2
"""m before the hold pose, where a crippled vehicle that can brake waits until it has the port's attitude."""
_TURNING_RATE = 0.1
"""rad/s, of its turns."""
_TURNED, _WHILE_TURNING = 0.99, 0.05
"""Cosine of half the angle (16 deg) from which on it turns, and the share of its pushes meanwhile: they go astray."""
_COAST = np.arange(5.0, 31.0, 5.0)
"""s: what a turn takes, about."""


class Approach(NamedTuple):
    """How to fly now.

    Attributes:
        goal: with the attitude to hold.
        tuning: with the rate to turn at.
        path: to track, m and m/s in the station frame, now and every step.
        share: of each axis's noise and warm start.
        rates: rad/s to turn at, now and every step.
        led: whether torques are led along those: beside a target that turns, and while a crippled vehicle turns.
    """

    goal: Goal
    tuning: Tuning
    path: Float[Array, "T+1 6"]
    share: Float[Array, "6"]
    rates: Float[Array, "T+1 3"]
    led: Bool[Array, ""]


def safe_approach(
    shape: Shape, dt: float, tuning: Tuning, goal: Goal, effect: Effect, view: Float[Array, "13"]
) -> Approach:
    """Return how to fly from a view by what actions do."""
    attitude = View.of(view).attitude
    missing = missing_forces(effect, attitude)
    crippled = is_crippled(missing)
    waits = crippled & (missing[2, 2] < 0.5) & ~is_turned(view, goal.pose)
    changed = {name: jnp.where(crippled, value, getattr(goal, name)) for name, value in _CRIPPLED.items()}
    goal = goal._replace(**changed, gate=jnp.where(waits, _GATE, goal.gate))
    able = _SHARE * authority(effect)
    steps = shape.latency + shape.horizon
    path = safe_reference(goal, view, steps, dt, able)[shape.latency :]
    held = facing(missing, view, goal.pose, path)
    held = jnp.where(goal.away, facing_out(missing, attitude, path[-1, 3:] - path[0, 3:]), held)
    turning = crippled & (jnp.abs(jnp.sum(held * attitude)) < _TURNED)
    eases = turning & ~_leads_into_the_hull(goal, view)
    rate = jnp.where(crippled, _TURNING_RATE, tuning.weights.top_rate)
    goal = goal._replace(pose=goal.pose.at[3:].set(held))
    weights = tuning.weights._replace(top_rate=rate)
    return Approach(
        goal=goal,
        tuning=tuning._replace(weights=weights),
        path=path,
        share=jnp.where(eases & (np.arange(6) < 3), _WHILE_TURNING, 1).astype(view.dtype),
        rates=turning_reference(weights, goal.pose, view, steps, dt)[shape.latency :],
        led=turning if goal.turning is None else jnp.asarray(True),
    )


def led_along(approach: Approach, effect: Effect, plan: Float[Array, "T 6"], dt: float) -> Float[Array, "T 6"]:
    """Return a plan with those forces, and torques where they are led, that by what actions do lead along a path.

    Averaging candidates alone follows a reference late, or with all their noise.
    """
    change = jnp.diff(approach.path[:, 3:], axis=0) * (effect.elapsed / dt)
    turning = jnp.diff(approach.rates, axis=0) * (effect.elapsed / dt)
    turning = jnp.where(approach.led, turning, effect.change[3:])
    led = jnp.clip(wrench_for(effect, jnp.concatenate([change, turning], axis=1)), -1, 1)
    led = led.at[:, 3:].set(jnp.where(approach.led, led[:, 3:], plan[:, 3:]))
    return jnp.where(jnp.all(jnp.isfinite(led)), led, plan)


def _leads_into_the_hull(goal: Goal, view: Float[Array, "13"]) -> Bool[Array, ""]:
    """Whether half a minute straight on comes close to the hull."""
    position, velocity, _, _ = View.of(view)
    ahead = position + jnp.asarray(_COAST, position.dtype)[:, None] * velocity
    gaps = jax.vmap(lambda at: clearance(goal.field, at))(ahead)
    return jnp.min(gaps) < jnp.minimum(0.5, clearance(goal.field, position) - 0.1)
