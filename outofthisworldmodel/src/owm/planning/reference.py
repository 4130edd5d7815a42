"""The reference of the safe objective: where a chaser comes that tracks the safe velocity from here."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from owm_envs.policies.base import limit_norm
from owm_envs.policies.guidance import Goal, safe_velocity
from owm_envs.view import View

_TIME_CONSTANT = 2.0
"""s, of the velocity loop."""
_EVERY = 4
"""Steps from one look at the drifts to the next."""


def safe_reference(
    goal: Goal, view: Float[Array, "13"], steps: int, dt: float, able: Float[Array, ""]
) -> Float[Array, "T+1 6"]:
    """Where a chaser comes that flies at the safe velocity from now on: m and m/s, station frame, now and every step.

    Args:
        goal: with `drift`.
        view: now.
        steps: after now; dt: s.
        able: the most that it may accelerate, m/s2.
    """
    start = View.of(view)

    def look(at, _):
        wanted, rows = safe_velocity(goal, *at), []
        for _ in range(_EVERY):
            position, velocity = at
            change = dt * limit_norm((wanted - velocity) / _TIME_CONSTANT, able)
            at = position + dt * (velocity + 0.5 * change), velocity + change
            rows.append(jnp.concatenate(at))
        return at, jnp.stack(rows)

    looks = -(-steps // _EVERY)
    _, rows = jax.lax.scan(look, (start.position, start.velocity), length=looks)
    return jnp.concatenate([jnp.concatenate([start.position, start.velocity])[None], rows.reshape(-1, 6)[:steps]])
