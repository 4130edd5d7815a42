"""What a predicted view costs: distance, velocity and rate profiles, attitude, effort, hull clearance."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from astrojax.attitude import quat_conjugate, quat_multiply, quat_to_rotation_vector
from owm.planning.config import Weights
from owm_envs.field import GeodesicField, clearance, cost_to_go
from owm_envs.flags import own_promotion


def _safe_norm(vector: Float[Array, "3"]) -> Float[Array, ""]:
    square = jnp.sum(vector * vector)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _way(
    objective: str, field: GeodesicField, port: Int[Array, ""], goal: Float[Array, "7"], position: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Return how far it is to go, m, and the direction in which that grows."""
    if objective == "geodesic":
        return cost_to_go(field, port, position)
    offset = position - goal[:3]
    return _safe_norm(offset), offset


@own_promotion()
def step_cost(
    objective: str,
    weights: Weights,
    field: GeodesicField,
    port: Int[Array, ""],
    goal: Float[Array, "7"],
    view: Float[Array, "13"],
    effort: Float[Array, "6"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Cost of one predicted step and its hull clearance; a collision is not charged here.

    Args:
        objective: "geodesic", "straight" or "plain", static; see `PlannerConfig.objective`.
        field: geodesic field; "straight" and "plain" read its hull clearance only.
        port: row of the field.
        goal: hold pose: m, quaternion body to station.
        view: predicted relative view, station frame.
        effort: wrench in fractions of the limits.

    Returns:
        Cost, and m between bounding sphere and hull.
    """
    w = weights
    position, velocity, rate = view[:3], view[3:6], view[10:]
    gap = clearance(field, position)
    turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(view[6:10]), goal[3:]))
    shared = w.effort * jnp.sum(effort * effort) + w.clearance * jnp.maximum(w.margin - gap, 0) ** 2
    if objective == "plain":
        offset = position - goal[:3]
        errors = w.position * jnp.sum(offset * offset) + w.velocity * jnp.sum(velocity * velocity)
        turning = w.attitude * jnp.sum(turn * turn) + w.rate * jnp.sum(rate * rate)
        return errors + turning + shared, gap

    to_go, uphill = _way(objective, field, port, goal, position)
    speed = jnp.minimum(w.top_speed, jnp.sqrt(w.braking * jnp.maximum(to_go, 1e-9)))
    speed = jnp.minimum(speed, to_go / w.closing_time)
    speed = jnp.minimum(speed, w.crawl + w.crawl_per_clearance * jnp.maximum(gap, 0))
    wanted = -speed * uphill / jnp.maximum(_safe_norm(uphill), 1e-6)
    angle = _safe_norm(turn)
    spin = jnp.minimum(w.top_rate, jnp.sqrt(w.rate_braking * jnp.maximum(angle, 1e-9)))
    spin = jnp.minimum(spin, angle / w.turning_time)
    wanted_rate = spin * turn / jnp.maximum(angle, 1e-9)
    cost = (
        w.position * (jnp.sqrt(to_go * to_go + w.position_knee * w.position_knee) - w.position_knee)
        + w.velocity * jnp.sum((velocity - wanted) ** 2)
        + w.attitude * angle
        + w.rate * jnp.sum((rate - wanted_rate) ** 2)
    )
    return cost + shared, gap


@own_promotion()
def sequence_cost(
    objective: str,
    weights: Weights,
    field: GeodesicField,
    port: Int[Array, ""],
    goal: Float[Array, "7"],
    clear: Bool[Array, ""],
    able: Float[Array, ""],
    views: Float[Array, "T 13"],
    efforts: Float[Array, "T 6"],
) -> Float[Array, ""]:
    """Cost of one candidate: the mean over its steps, until it touches the hull, and a charge at its end.

    That is for touching, or for a speed that cannot be braked over the way that is left: braking from the top speed
    takes longer than a horizon, so that no step would tell before it is too late.

    Args:
        clear: whether it starts clear of the hull; one that does not is never charged for touching, so that
            the clearance term can lead it out.
        able: acceleration to brake with, m/s2.

    Other arguments as for `step_cost`, one row a step.
    """
    costs, gaps = jax.vmap(lambda view, effort: step_cost(objective, weights, field, port, goal, view, effort))(
        views, efforts
    )
    steps = costs.shape[0]
    touches = (gaps < 0) & clear
    touched = jnp.any(touches)
    first = jnp.where(touched, jnp.argmax(touches), steps)
    before = jnp.arange(steps, dtype=first.dtype) < first
    remaining = (steps - first).astype(costs.dtype) / steps
    touching = weights.collision * (1 + remaining)
    if objective == "plain":
        unbraked = jnp.zeros_like(touching)
    else:
        to_go, _ = _way(objective, field, port, goal, views[-1, :3])
        unbraked = jnp.maximum(_safe_norm(views[-1, 3:6]) - jnp.sqrt(2 * able * jnp.maximum(to_go, 1e-9)), 0)
    charge = jnp.where(touched, touching, weights.stopping * unbraked**2)
    return jnp.sum(jnp.where(before, costs, 0)) / steps + charge
