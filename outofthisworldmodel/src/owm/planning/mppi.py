"""Model predictive path integral control over any world model, as one pure function of one episode.

Source: Williams, Aldrich and Theodorou (2017), Model predictive path integral control: from theory to
parallel computation, J. Guidance, Control, and Dynamics 40(2); candidates, horizon, temperature and chunked
execution as in the paper that this package follows.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from owm.interface import History, WorldModel
from owm.planning.config import Shape, Tuning
from owm.planning.corrector import Corrector, apply, init_corrector, update
from owm.planning.objective import sequence_cost
from owm_envs.field import GeodesicField, clearance
from owm_envs.flags import own_promotion


class PlannerState(NamedTuple):
    """What one episode carries from replan to replan."""

    plan: Float[Array, "T 6"]
    """Warm start in fractions of the wrench limits, its first step the next to be executed."""
    expected: Float[Array, "13"]
    """The view predicted for the next replan (its quaternion an average, not of unit length)."""
    started: Bool[Array, ""]
    """Whether `expected` means anything: not before the first replan nor after a prediction gone astray."""
    corrector: Corrector


def init_planner(shape: Shape, dtype: str = "float32") -> PlannerState:
    """The state of an episode that has not been planned for."""
    return PlannerState(
        plan=jnp.zeros((shape.horizon, 6), dtype),
        expected=jnp.zeros(13, dtype),
        started=jnp.zeros((), bool),
        corrector=init_corrector(dtype),
    )


def interpolation(horizon: int, knots: int) -> Float[np.ndarray, "T N"]:
    """Linear interpolation from knots to steps, rows of unit norm: unit noise at knots stays unit noise."""
    place = np.linspace(0.0, knots - 1.0, horizon)[:, None]
    hat = np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots)))
    return hat / np.linalg.norm(hat, axis=1, keepdims=True)


@own_promotion()
def sample_candidates(
    shape: Shape, sigma: Float[Array, "6"], plan: Float[Array, "T 6"], *, key: Key[Array, ""]
) -> Float[Array, "K T 6"]:
    """Draw candidates around a plan: smooth noise of deviation `sigma`, clipped; the first has none."""
    dtype = plan.dtype
    draws = jax.random.normal(key, (shape.candidates - 1, shape.knots, 6), dtype)
    weights = jnp.asarray(interpolation(shape.horizon, shape.knots), dtype)
    noise = sigma * jnp.einsum("tn,kni->kti", weights, draws)
    return jnp.clip(jnp.concatenate([plan[None], plan + noise]), -1, 1)


def rollout(model: WorldModel, params: PyTree, state: Any, wrenches: Float[Array, "T 6"]) -> Float[Array, "T 13"]:
    """Decode the views that a model predicts after each of a sequence of held wrenches [N, N m]."""

    def advance(state, wrench):
        state = model.step(params, None, wrench, state)
        return state, model.decode(params, state)["state"].astype(wrench.dtype)

    return jax.lax.scan(advance, state, wrenches)[1]


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
    elapsed: float


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
    return Effect(mean_action, mean_change, slope / scale[:, None], elapsed)


def coasting_wrench(effect: Effect) -> Float[Array, "6"]:
    """Return the wrench, in fractions of the limits, under which velocity and rate stay as they are.

    In free space it is zero; under a steady acceleration, known to the model or found by the corrector, it is what
    cancels it. A warm start continued by zeros instead settles some 0.1 m off the goal for each 0.01 m/s2.
    """
    wrench = effect.action - effect.change @ effect.slope
    # A model that heeds no action has no such wrench.
    return jnp.clip(jnp.where(jnp.all(jnp.isfinite(wrench)), wrench, 0), -1, 1)


def authority(effect: Effect) -> Float[Array, ""]:
    """Return the acceleration, m/s2, that the limits allow in whatever direction; infinite if no action is heeded."""
    largest = jnp.max(jnp.sum(effect.slope[:3] ** 2, axis=0))
    able = 1.0 / (effect.elapsed * jnp.sqrt(largest))
    return jnp.where(jnp.isfinite(able), able, jnp.inf)


@own_promotion()
def plan(
    model: WorldModel,
    shape: Shape,
    params: PyTree,
    tuning: Tuning,
    field: GeodesicField,
    port: Int[Array, ""],
    goal: Float[Array, "7"],
    history: History,
    committed: Float[Array, "L 6"],
    state: PlannerState,
    key: Key[Array, ""],
) -> tuple[Float[Array, "C 6"], PlannerState]:
    """Replan one episode.

    Everything but the model itself is computed in the dtype of the plan.

    Args:
        model, shape: static.
        params: of the model.
        tuning: the planner's traced numbers.
        field: geodesic field and hull clearance; port: its row.
        goal: hold pose: m, quaternion body to station.
        history: measurements up to now.
        committed: wrenches [N, N m] of the next `shape.latency` steps, which can no longer be changed.
        state: of this episode.
        key: of this replan.

    Returns:
        The wrenches [N, N m] to execute after those, `model.dt` each, and the next state.
    """
    dtype = state.plan.dtype
    measured = history.observation[-1].astype(dtype)
    goal = goal.astype(dtype)
    duration = shape.chunk * model.dt
    learned = update(state.corrector, state.expected, measured, duration, tuning.gain, tuning.drift_gain)
    corrector = jax.tree.map(lambda new, old: jnp.where(state.started, new, old), learned, state.corrector)

    distance = jnp.sqrt(jnp.sum((measured[:3] - goal[:3]) ** 2))
    nearness = jnp.minimum(1, tuning.sigma_near + (1 - tuning.sigma_near) * distance / tuning.sigma_distance)
    candidates = sample_candidates(shape, nearness * tuning.sigma, state.plan, key=key)

    # The rollout is vmapped whole, not its step: what no action moves (the context, the station) is computed
    # once.
    start = model.encode(params, history)
    if shape.latency:
        start, _ = jax.lax.scan(lambda at, wrench: (model.step(params, None, wrench, at), None), start, committed)
    views = jax.vmap(lambda actions: rollout(model, params, start, actions * tuning.limit))(candidates)
    elapsed = model.dt * (shape.latency + jnp.arange(1, shape.horizon + 1, dtype=dtype))
    views = jax.vmap(jax.vmap(apply, (None, 0, 0)), (None, 0, None))(corrector.correction, views, elapsed)
    clear = clearance(field, measured[:3]) >= 0
    few = max(shape.chunk, 2)
    effect = effect_of(candidates[:, 1:few], views[:, 0], views[:, few - 1], (few - 1) * model.dt)
    cost = partial(sequence_cost, shape.objective, tuning.weights, field, port, goal, clear, authority(effect))
    costs = jax.vmap(cost)(views, candidates)
    # A candidate whose prediction is not finite can never be chosen.
    costs = jnp.where(jnp.isfinite(costs), costs, jnp.finfo(dtype).max)
    weights = jax.nn.softmax((jnp.min(costs) - costs) / tuning.temperature)
    best = jnp.einsum("k,kti->ti", weights, candidates)

    wrenches = best[: shape.chunk] * tuning.limit
    coast = coasting_wrench(effect)
    following = jnp.concatenate([best[shape.chunk :], jnp.broadcast_to(coast, (shape.chunk, 6))])
    # What the model expects of the executed wrenches: over one chunk the views are linear in the actions to
    # well below the sensors' noise, so they may be averaged like them, which saves another rollout and its
    # compilation.
    expected = jnp.einsum("k,ki->i", weights, views[:, shape.chunk - shape.latency - 1])
    return wrenches, PlannerState(following, expected, jnp.all(jnp.isfinite(expected)), corrector)
