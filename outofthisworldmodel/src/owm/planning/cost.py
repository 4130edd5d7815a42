"""What a predicted flight costs: a list of terms at every step, and one charge for where it ends.

A term is a function with the name of its weight. To add one: a weight in `PlannerConfig` and `Weights`, a function
here, a line in `OBJECTIVES`.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from astrojax.attitude import quat_conjugate, quat_multiply, quat_to_rotation_vector
from astrojax.compilation import summed
from owm.planning.config import Weights
from owm_envs.field import clearance, cost_to_go
from owm_envs.flags import own_promotion
from owm_envs.policies.guidance import NEAR, Goal, drift_short
from owm_envs.task.events import safe_root
from owm_envs.view import View


class Step(NamedTuple):
    """One predicted step as the terms read it.

    Attributes:
        offset: from the hold position, m, station frame.
        velocity: m/s, station frame.
        turn: rotation vector to the goal attitude, rad, body axes.
        rate: rad/s, body axes.
        effort: wrench in fractions of the limits.
        clearance: between bounding sphere and hull, m.
        to_go: way to the goal, m, along the field or straight.
        uphill: direction, of whatever length, in which that grows.
        astray: from the reference's position and velocity, m and m/s.
    """

    offset: Float[Array, "3"]
    velocity: Float[Array, "3"]
    turn: Float[Array, "3"]
    rate: Float[Array, "3"]
    effort: Float[Array, "6"]
    clearance: Float[Array, ""]
    to_go: Float[Array, ""]
    uphill: Float[Array, "3"]
    astray: Float[Array, "6"]


def _norm(vector: Float[Array, "3"]) -> Float[Array, ""]:
    # Not `safe_norm`, whose written-out sum is fused otherwise: plans would round differently.
    return safe_root(jnp.sum(vector * vector))


def _way(objective: str, goal: Goal, position: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Return how far it is to go, m, and the direction in which that grows."""
    if objective == "geodesic":
        return cost_to_go(goal.field, goal.port, position)
    offset = position - goal.pose[:3]
    return _norm(offset), offset


def _read(
    objective: str, goal: Goal, view: Float[Array, "13"], effort: Float[Array, "6"], reference: Float[Array, "6"]
) -> Step:
    position, velocity, attitude, rate = View.of(view)
    return Step(
        position - goal.pose[:3],
        velocity,
        quat_to_rotation_vector(quat_multiply(quat_conjugate(attitude), goal.pose[3:])),
        rate,
        effort,
        clearance(goal.field, position),
        *_way(objective, goal, position),
        jnp.concatenate([position, velocity]) - reference,
    )


# ---------------------------------------------------------------- terms


def distance(w: Weights, step: Step) -> Float[Array, ""]:
    """The way to go, quadratic below the knee."""
    return jnp.sqrt(step.to_go * step.to_go + w.position_knee * w.position_knee) - w.position_knee


def speed_profile(w: Weights, step: Step) -> Float[Array, ""]:
    """Squared error to a velocity down the way: no faster than can be braked, and slow beside the hull."""
    speed = jnp.minimum(w.top_speed, jnp.sqrt(w.braking * jnp.maximum(step.to_go, 1e-9)))
    speed = jnp.minimum(speed, step.to_go / w.closing_time)
    speed = jnp.minimum(speed, w.crawl + w.crawl_per_clearance * jnp.maximum(step.clearance, 0))
    wanted = -speed * step.uphill / jnp.maximum(_norm(step.uphill), 1e-6)
    return jnp.sum((step.velocity - wanted) ** 2)


def angle(w: Weights, step: Step) -> Float[Array, ""]:
    """The angle to the goal attitude."""
    return _norm(step.turn)


def rate_profile(w: Weights, step: Step) -> Float[Array, ""]:
    """Squared error to a rate towards the goal attitude, no faster than can be braked."""
    return jnp.sum((step.rate - wanted_rate(w, step.turn)) ** 2)


def wanted_rate(w: Weights, turn: Float[Array, "3"]) -> Float[Array, "3"]:
    """The rate to turn at, rad/s, with a rotation vector yet to go."""
    angle = _norm(turn)
    spin = jnp.minimum(w.top_rate, jnp.sqrt(w.rate_braking * jnp.maximum(angle, 1e-9)))
    spin = jnp.minimum(spin, angle / w.turning_time)
    return spin * turn / jnp.maximum(angle, 1e-9)


def effort(w: Weights, step: Step) -> Float[Array, ""]:
    """The squared wrench."""
    return jnp.sum(step.effort * step.effort)


def shortfall(w: Weights, step: Step) -> Float[Array, ""]:
    """The squared shortfall of hull clearance below the margin."""
    return jnp.maximum(w.margin - step.clearance, 0) ** 2


def tracking_velocity(w: Weights, step: Step) -> Float[Array, ""]:
    """Squared error to the reference's velocity."""
    return jnp.sum(step.astray[3:] ** 2)


def tracking_position(w: Weights, step: Step) -> Float[Array, ""]:
    """Squared distance from the reference."""
    return jnp.sum(step.astray[:3] ** 2)


class Term(NamedTuple):
    """A cost term: the name of its weight in `Weights`, and the function that is weighted."""

    name: str
    cost: Callable[[Weights, Step], Float[Array, ""]]


_SHARED = (Term("effort", effort), Term("clearance", shortfall))
_PROFILE = (
    Term("position", distance),
    Term("velocity", speed_profile),
    Term("attitude", angle),
    Term("rate", rate_profile),
)
_PLAIN = (
    (
        Term("position", lambda w, step: jnp.sum(step.offset * step.offset)),
        Term("velocity", lambda w, step: jnp.sum(step.velocity * step.velocity)),
    ),
    (
        Term("attitude", lambda w, step: jnp.sum(step.turn * step.turn)),
        Term("rate", lambda w, step: jnp.sum(step.rate * step.rate)),
    ),
)
_TRACKING = (
    Term("tracking_velocity", tracking_velocity),
    Term("tracking_position", tracking_position),
    Term("attitude", angle),
    Term("rate", rate_profile),
)
OBJECTIVES: dict[str, tuple[tuple[Term, ...], ...]] = {
    "geodesic": (_PROFILE, _SHARED),
    "straight": (_PROFILE, _SHARED),
    "plain": (*_PLAIN, _SHARED),
    "safe": (_TRACKING, _SHARED),
}
"""The terms of each `PlannerConfig.objective`. They are summed group by group: another order rounds differently."""


# ---------------------------------------------------------------- costs

_LOOKS = np.array([3, 7, 15])
"""Steps from which the safe objective lets a candidate drift: the last of the chunk, one before and one after."""
_MOST_SHORT = 4.0
"""m."""


def step_cost(
    objective: str,
    weights: Weights,
    goal: Goal,
    view: Float[Array, "13"],
    effort: Float[Array, "6"],
    reference: Float[Array, "6"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Cost of one predicted step and its hull clearance; a collision is not charged here.

    Args:
        objective: one of `OBJECTIVES`, static; see `PlannerConfig.objective`.
        goal: only "geodesic" reads more than hull clearance from its field, only "safe" reads `drift`.
        view: predicted relative view, station frame.
        effort: wrench in fractions of the limits.
        reference: position m and velocity m/s that "safe" asks for then.

    Returns:
        Cost, and m between bounding sphere and hull.
    """
    step = _read(objective, goal, view, effort, reference)
    groups = [[getattr(weights, term.name) * term.cost(weights, step) for term in g] for g in OBJECTIVES[objective]]
    return summed([summed(group) for group in groups]), step.clearance


@own_promotion()
def sequence_cost(
    objective: str,
    weights: Weights,
    goal: Goal,
    views: Float[Array, "T 13"],
    efforts: Float[Array, "T 6"],
    *,
    clear: Bool[Array, ""],
    deceleration: Float[Array, ""],
    reference: Float[Array, "T 6"],
) -> Float[Array, ""]:
    """Cost of one candidate: the mean over its steps, until it touches the hull, and a charge at its end.

    That is for touching, or for a speed that cannot be braked over the way that is left: braking from the top speed
    takes longer than a horizon, so that no step would tell before it is too late. When safe it is for free drifts that
    come too close instead.

    Args:
        clear: whether it starts clear of the hull; one that does not is never charged for touching, so that
            the clearance term can lead it out.
        deceleration: to brake with, m/s2.
        reference: see `step_cost`.

    Other arguments as for `step_cost`, one row a step.
    """
    costs, gaps = jax.vmap(partial(step_cost, objective, weights, goal))(views, efforts, reference)
    steps = costs.shape[0]
    touches = (gaps < 0) & clear
    touched = jnp.any(touches)
    first = jnp.where(touched, jnp.argmax(touches), steps)
    before = jnp.arange(steps, dtype=first.dtype) < first
    remaining = (steps - first).astype(costs.dtype) / steps
    touching = weights.collision * (1 + remaining)
    end = _charge(objective, weights, goal, views, deceleration)
    return jnp.sum(jnp.where(before, costs, 0)) / steps + jnp.where(touched, touching, end)


def _charge(
    objective: str, weights: Weights, goal: Goal, views: Float[Array, "T 13"], deceleration: Float[Array, ""]
) -> Float[Array, ""]:
    """What a candidate that touches nothing is charged for where it leads."""
    if objective == "plain":
        return jnp.zeros((), views.dtype)
    if objective == "safe":
        looks = np.unique(np.minimum(_LOOKS, len(views) - 1))
        return weights.drift * jnp.mean(jax.vmap(partial(_unsafe, goal))(views[looks]))
    return weights.stopping * _unbraked(objective, goal, views[-1], deceleration) ** 2


def _unsafe(goal: Goal, view: Float[Array, "13"]) -> Float[Array, ""]:
    """By how much a free drift falls short of its clearance, m, at most `_MOST_SHORT`; near the hull all do."""
    position, velocity, _, _ = View.of(view)
    short = jnp.minimum(drift_short(goal, position, velocity), _MOST_SHORT)
    return jnp.where(clearance(goal.field, position) > NEAR, short, 0)


def _unbraked(objective: str, goal: Goal, view: Float[Array, "13"], deceleration: Float[Array, ""]) -> Float[Array, ""]:
    """The speed, m/s, beyond what can be braked to rest over the way that is left."""
    position, velocity, _, _ = View.of(view)
    to_go, _ = _way(objective, goal, position)
    return jnp.maximum(_norm(velocity) - jnp.sqrt(2 * deceleration * jnp.maximum(to_go, 1e-9)), 0)
