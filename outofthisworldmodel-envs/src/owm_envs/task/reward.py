"""The paper's reward; its weights are configuration."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from astrojax.compilation import summed
from owm_envs.config.params import Params
from owm_envs.task.events import safe_norm


def pseudo_huber(
    error: Float[Array, "..."], delta: Float[Array, "..."], sigma: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Quadratic below `delta`, then of slope 1 / `sigma`. Source: paper, equation of the pseudo-Huber loss."""
    return (jnp.sqrt(error * error + delta * delta) - delta) / sigma


def reward(
    params: Params,
    norms: Float[Array, "4"],
    previous_distance: Float[Array, ""],
    wrench: Float[Array, "6"],
    collided: Bool[Array, ""],
    docked: Bool[Array, ""],
    escaped: Bool[Array, ""],
) -> Float[Array, ""]:
    """Reward of one decision from its final true state.

    Args:
        norms: errors to the goal after the decision: m, m/s, rad, rad/s.
        previous_distance: distance to the goal before it, m.
        wrench: the command after clipping, N and N m.
        collided, docked, escaped: whether that happened during the decision.

    Source: paper, equation of the RL reward.
    """
    w = params.reward
    distance, speed, angle, rate = norms
    gate = w["gate_far"] + (1 - w["gate_far"]) / (1 + (distance / w["gate_distance"]) ** 2)
    effort = safe_norm(wrench.reshape(2, 3)) / params.chaser.wrench_limit[jnp.asarray([0, 3])]
    near = jnp.exp(-distance / w["sigma_proximity"])
    return (
        w["position"] * pseudo_huber(distance, w["delta_position"], w["sigma_position"])
        + w["velocity"] * pseudo_huber(speed, w["delta_velocity"], w["sigma_velocity"])
        + gate * w["attitude"] * pseudo_huber(angle, w["delta_attitude"], w["sigma_attitude"])
        + gate * w["rate"] * pseudo_huber(rate, w["delta_rate"], w["sigma_rate"])
        + w["progress"] * (distance - previous_distance) / w["sigma_position"]
        + near * (w["proximity"] + w["alignment"] * jnp.exp(-angle / w["sigma_alignment"]))
        + w["effort"] * summed(effort)
        + w["collision"] * collided.astype(distance.dtype)
        + w["dock"] * docked.astype(distance.dtype)
        + w["escape"] * escaped.astype(distance.dtype)
    )
