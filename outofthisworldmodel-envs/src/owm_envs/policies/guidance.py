"""The safe approach: a velocity at which a chaser may fly, since wherever its thrusters stop it drifts clear."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from astrojax.attitude import quat_rotate
from astrojax.orbits import mean_motion
from owm_envs.field import GeodesicField, clearance, cost_to_go
from owm_envs.field.drift import drift_matrices, drift_seen_turning, drift_shortfall
from owm_envs.policies.turning import Turning, goes_round_hard, velocity_apart, way_across, way_in
from owm_envs.task.events import safe_norm

DRIFT_TIMES = np.concatenate([np.arange(4.0, 80.0, 4.0), np.arange(80.0, 361.0, 14.0)])
"""s without thrust at which the clearance is looked up."""
NEAR = 8.5
"""m between bounding sphere and hull. Nearer, whoever closes in at all drifts into the hull: there the chaser is slow
enough for a small impulse to lead it away."""
_MARGIN = 3.0
"""m of clearance that a drift keeps; more, up to `_STRIDE`, for what it moves between two looks."""
_STRIDE = 3.0
_WEIGHT, _CAP = 4.0, 4.0
"""1/s, m: what a metre of shortfall costs, in m/s of progress, and from where on more of it costs no more."""
_STEADY = 0.1
"""s/m: what a change of velocity costs."""
_FIRST_PART = 0.15
"""Of the way to a new velocity, as far as it comes in a moment: the drift from there must be clear, too."""
_CORRIDOR = 5.0
"""m before the hold pose, where the last leg begins; its width is 0.6 m, and 0.4 m more a metre out."""
_CONTACT = 0.078
"""m/s: the closing speed at contact. The docking standard asks for 0.05 to 0.10 m/s."""
_CLOSING_TIME, _CENTRING_TIME = 13.0, 4.0
"""s, of the last leg, along and across the port's axis."""
_LEAVING = (0.2, 0.03, 1.0)
"""m/s at the hull, 1/s more a metre of clearance, and m/s at most: the speed of who leaves."""


def _fan(count: int, widest: float = 1.5) -> Float[np.ndarray, "K 3"]:
    """Unit vectors about +z: a Fibonacci spiral over the sphere out to z = 1 - `widest`, denser towards +z."""
    i = np.arange(count) + 0.5
    z, azimuth = 1 - widest * (i / count) ** 1.5, np.pi * (1 + np.sqrt(5)) * i
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1).astype(np.float32)


_DIRECTIONS = np.concatenate([[[0.0, 0.0, 1.0]], _fan(64)])
"""About the way down the cost-to-go."""


class Goal(NamedTuple):
    """Where to fly.

    Attributes:
        field: geodesic field and hull clearance.
        port: its row of the port, -1 where it has none.
        pose: hold pose: m, quaternion body to station.
        drift: for the safe approach, from `drift_beside`.
        pace: share of the usual speeds, for a vehicle that answers slowly.
        steady: m before the hold pose, from where on the closing speed is that at contact.
        gate: m before the hold pose, where to wait.
        away: whether to leave in place of docking.
        turning: of a target that turns, from `goal_of_turning`; None for one at rest.
    """

    field: GeodesicField
    port: Int[Array, ""]
    pose: Float[Array, "7"]
    drift: Float[Array, "T 3 6"] | None = None
    pace: Float[Array, ""] | float = 1.0
    steady: Float[Array, ""] | float = _CONTACT * _CLOSING_TIME
    gate: Float[Array, ""] | float = -10.0
    away: Bool[Array, ""] | bool = False
    turning: Turning | None = None


def drift_beside(semi_major_axis: float) -> Float[np.ndarray, "T 3 6"]:
    """Where free drifts lead, at `DRIFT_TIMES`, beside a station whose orbit has this semi-major axis [m]."""
    with jax.enable_x64(True):
        rate = float(mean_motion(jnp.asarray(semi_major_axis, jnp.float64)))
    return drift_matrices(rate, DRIFT_TIMES)


def goal_of_turning(goal: Goal, rate: Float[Array, "3"]) -> Goal:
    """The goal of a target that turns at `rate`, rad/s in its own axes."""
    drift = goal.drift
    if drift is not None:
        drift = drift_seen_turning(jnp.asarray(drift, rate.dtype), jnp.asarray(DRIFT_TIMES, rate.dtype), rate)
    return goal._replace(drift=drift, turning=Turning.about(rate, goal.pose))


def field_speed(
    geodesic_field: GeodesicField, row: Int[Array, ""], position: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3"], Float[Array, ""]]:
    """How fast to go, m/s, the direction in which the way to the port grows, and the clearance of the hull, m.

    The speed is NaN for a port that the field lacks (row -1).
    """
    dtype = position.dtype
    cost, gradient = cost_to_go(geodesic_field, jnp.maximum(row, 0), position)
    cost = jnp.where(row < 0, jnp.nan, cost)
    gap = clearance(geodesic_field, position)
    cost, gradient, gap = (jnp.asarray(x, dtype) for x in (cost, gradient, gap))
    speed = jnp.minimum(4.0, jnp.sqrt(0.08 * jnp.maximum(cost, 1e-9)))
    speed = jnp.minimum(speed, jnp.minimum(cost / 4.0, 0.4 + jnp.sqrt(0.08 * jnp.maximum(gap, 1e-9))))
    return speed, gradient, gap


def safe_velocity(goal: Goal, position: Float[Array, "3"], velocity: Float[Array, "3"]) -> Float[Array, "3"]:
    """The velocity to fly at, m/s, station frame; NaN for a port that the field lacks.

    Beyond `NEAR` it is, of 65 directions at two speeds, the one of most progress down the geodesic cost-to-go whose
    free drift of 360 s keeps clear of the hull: so it passes by, beside the port, and turns in late. Nearer it follows
    the cost-to-go, at no more than 0.25 m/s + 0.15 / s of clearance and 0.1 m/s + 1 m/s every 13 m of distance. The
    last 5 m lead straight down the port's axis, to a contact at 0.078 m/s; off the axis it holds back.

    To a target that turns the way from afar leads straight in, and all this comes on top of `velocity_apart`.
    Who leaves goes back up the cost-to-go, the faster the farther off the hull.

    Chosen on the nominal starts of `owm.scores.docking.trials(per_port=6, seed=501)`.
    """
    speed, gradient, gap = field_speed(goal.field, goal.port, position)
    lacking = jnp.isnan(speed)
    away = safe_norm(position - goal.pose[:3].astype(position.dtype))
    speed = goal.pace * jnp.minimum(speed, jnp.minimum(0.25 + 0.15 * jnp.maximum(gap, 0), 0.1 + away / 13.0))
    down = -gradient / jnp.maximum(safe_norm(gradient), 1e-6)
    passes = (gap > NEAR) & (jnp.asarray(goal.pace) >= 1)
    beside = None
    if goal.turning is not None:
        beside = velocity_apart(goal.turning, position)
        speed, down = way_in(goal.turning, position, speed, down)
        passes = passes & ~goes_round_hard(goal.turning, position)
    wanted = jnp.where(passes, _passing_by(goal, position, velocity, speed, down, beside), speed * down)
    if goal.turning is not None:
        aside, across = way_across(goal.turning, position, speed)
        wanted = jnp.where(aside, across, wanted)
    last, closing = _last_leg(goal, position)
    wanted = jnp.where(last, closing, wanted)
    leaving = jnp.clip(_LEAVING[0] + _LEAVING[1] * gap, _LEAVING[0], _LEAVING[2])
    wanted = jnp.where(goal.away, -leaving * down, wanted)
    return jnp.where(lacking, jnp.nan, wanted if beside is None else wanted + beside)


def _passing_by(
    goal: Goal,
    position: Float[Array, "3"],
    velocity: Float[Array, "3"],
    speed: Float[Array, ""],
    down: Float[Array, "3"],
    beside: Float[Array, "3"] | None,
) -> Float[Array, "3"]:
    """The velocity of most progress whose drift keeps clear; where none does, the one that falls least short.

    `beside` is a velocity that is flown anyway, and not part of what is returned.
    """
    dtype = position.dtype
    directions = jnp.asarray(_DIRECTIONS, dtype) @ _axes(down)
    velocities = jnp.concatenate([speed * directions, 0.5 * speed * directions])

    def score(wanted):
        whole = wanted if beside is None else wanted + beside
        change = whole - velocity
        soon = velocity + _FIRST_PART * change
        lost = jnp.minimum(drift_short(goal, position, whole) + drift_short(goal, position, soon), _CAP)
        return jnp.sum(wanted * down) - _WEIGHT * lost - _STEADY * jnp.sum(change * change)

    return velocities[jnp.argmax(jax.vmap(score)(velocities))]


def _axes(z: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rows: two unit vectors across a third, and that."""
    across = jnp.where(jnp.abs(z[0]) < 0.6, jnp.array([1.0, 0, 0], z.dtype), jnp.array([0, 1.0, 0], z.dtype))
    x = jnp.cross(across, z)
    x = x / jnp.maximum(safe_norm(x), 1e-6)
    return jnp.stack([x, jnp.cross(z, x), z])


def drift_short(goal: Goal, position: Float[Array, "3"], velocity: Float[Array, "3"]) -> Float[Array, ""]:
    """By how much a free drift of 360 s falls short of the clearance that it should keep, m."""
    dtype = position.dtype
    strides = jnp.asarray(np.diff(DRIFT_TIMES, prepend=0.0), dtype)
    margins = _MARGIN + jnp.minimum(0.5 * safe_norm(velocity) * strides, _STRIDE)
    return drift_shortfall(goal.field, jnp.asarray(goal.drift, dtype), margins, position, velocity)


def _last_leg(goal: Goal, at: Float[Array, "3"]) -> tuple[Array, Float[Array, "3"]]:
    """Whether the chaser is on the last leg, and the velocity there: along the axis, and back to it."""
    pose = goal.pose.astype(at.dtype)
    position, attitude = pose[:3], pose[3:]
    outwards = -quat_rotate(attitude, jnp.asarray([0.0, 0.0, 1.0], position.dtype))
    offset = at - position
    axial = jnp.sum(offset * outwards)
    aside = offset - axial * outwards
    lateral = safe_norm(aside)
    ahead = jnp.maximum(axial, 0)
    on_it = (safe_norm(offset) < _CORRIDOR) & (lateral < 0.6 + 0.4 * ahead)
    closing = jnp.clip(_CONTACT + goal.pace * (jnp.abs(axial) - goal.steady) / _CLOSING_TIME, _CONTACT, 0.6)
    slow = jnp.asarray(goal.pace) < 1
    aimed = -closing * offset / jnp.maximum(safe_norm(offset), 0.1)
    held_back = jnp.clip(1.5 - lateral / (0.15 + 0.12 * ahead), -0.3, 1.0)
    closing = closing * jnp.where(slow, jnp.maximum(held_back, 0.2), held_back)
    closing = jnp.where(axial < -0.05, -0.05, closing)
    closing = jnp.minimum(closing, jnp.maximum((axial - goal.gate) / _CLOSING_TIME, -0.05))
    time = jnp.where(slow, jnp.maximum(ahead / _CONTACT, _CLOSING_TIME), _CENTRING_TIME)
    back = jnp.minimum(lateral / time, 0.3)
    centred = -closing * outwards - back * aside / jnp.maximum(lateral, 1e-6)
    # Who answers slowly aims for the goal, so that no more has to be changed on the way.
    return on_it, jnp.where(slow & (jnp.asarray(goal.gate) < 0), aimed, centred)
