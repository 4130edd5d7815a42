"""What the safe objective tracks: where a chaser comes that flies at the safe velocity from here, and how it turns."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_multiply, quat_to_rotation_vector
from owm.planning.config import Weights
from owm.planning.cost import wanted_rate
from owm_envs.dynamics.turning import apparent
from owm_envs.policies.base import limit_norm
from owm_envs.policies.guidance import Goal, safe_velocity
from owm_envs.policies.turning import push
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
            accel = (wanted - velocity) / _TIME_CONSTANT
            if goal.turning is None:
                change = dt * limit_norm(accel, able)
            else:
                thrust = limit_norm(accel + push(goal.turning, position, velocity), able)
                change = dt * (thrust + apparent(goal.turning.rate, position, velocity))
            at = position + dt * (velocity + 0.5 * change), velocity + change
            rows.append(jnp.concatenate(at))
        return at, jnp.stack(rows)

    looks = -(-steps // _EVERY)
    _, rows = jax.lax.scan(look, (start.position, start.velocity), length=looks)
    return jnp.concatenate([jnp.concatenate([start.position, start.velocity])[None], rows.reshape(-1, 6)[:steps]])


def turning_reference(
    weights: Weights, pose: Float[Array, "7"], view: Float[Array, "13"], steps: int, dt: float
) -> Float[Array, "T+1 3"]:
    """The body rates, rad/s, of who turns to the attitude of a pose as the rate profile asks: now and every step."""
    start = View.of(view)

    def advance(at, _):
        attitude, rate = at
        turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(attitude), pose[3:]))
        after = rate + dt * (wanted_rate(weights, turn) - rate) / _TIME_CONSTANT
        attitude = quat_multiply(attitude, quat_from_rotation_vector(0.5 * dt * (rate + after)))
        return (attitude, after), after

    _, rates = jax.lax.scan(advance, (start.attitude, start.rate), length=steps)
    return jnp.concatenate([start.rate[None], rates])
