"""Model predictive path integral control over any world model, as one pure function of one episode.

Sample candidates (`sampler`), roll the model out under them, cost the views (`cost`), average (`update`).

Source: Williams, Aldrich and Theodorou (2017), Model predictive path integral control: from theory to
parallel computation, J. Guidance, Control, and Dynamics 40(2); candidates, horizon, temperature and chunked
execution as in the paper that this package follows.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, PyTree

from owm.interface import History, WorldModel, roll_out
from owm.planning import corrector
from owm.planning.approach import led_along, safe_approach
from owm.planning.config import Shape, Tuning
from owm.planning.cost import sequence_cost
from owm.planning.effect import Effect, authority, coasting_wrench, effect_of, no_effect
from owm.planning.sampler import sample_candidates
from owm.planning.update import average, candidate_weights, shifted
from owm_envs.field import clearance
from owm_envs.flags import own_promotion
from owm_envs.policies.guidance import Goal, goal_of_turning
from owm_envs.task.sensors import STATE, TARGET_RATE
from owm_envs.view import VIEW_SIZE, View


class Problem(NamedTuple):
    """What a replan is given that is no measurement; every leaf is traced.

    Attributes:
        params: of the model.
        tuning: the planner's numbers.
        goal: where to fly.
    """

    params: PyTree
    tuning: Tuning
    goal: Goal


class PlannerState(NamedTuple):
    """What one episode carries from replan to replan."""

    plan: Float[Array, "T 6"]
    """Warm start in fractions of the wrench limits, its first step the next to be executed."""
    expected: Float[Array, "13"]
    """The view predicted for the next replan (its quaternion an average, not of unit length)."""
    started: Bool[Array, ""]
    """Whether `expected` means anything: not before the first replan nor after a prediction gone astray."""
    corrector: corrector.Corrector
    effect: Effect
    """What actions do, as the last replan found."""


def init_planner(shape: Shape, dtype: str = "float32") -> PlannerState:
    """The state of an episode that has not been planned for."""
    return PlannerState(
        plan=jnp.zeros((shape.horizon, 6), dtype),
        expected=jnp.zeros(VIEW_SIZE, dtype),
        started=jnp.zeros((), bool),
        corrector=corrector.init_corrector(dtype),
        effect=no_effect(dtype),
    )


@own_promotion()
def plan(
    model: WorldModel,
    shape: Shape,
    problem: Problem,
    history: History,
    state: PlannerState,
    *,
    committed: Float[Array, "L 6"],
    key: Key[Array, ""],
) -> tuple[Float[Array, "C 6"], PlannerState]:
    """Replan one episode.

    Everything but the model itself is computed in the dtype of the plan.

    Args:
        model, shape: static.
        problem: parameters, tuning and goal.
        history: measurements up to now.
        state: of this episode.
        committed: wrenches [N, N m] of the next `shape.latency` steps, which can no longer be changed.
        key: of this replan.

    Returns:
        The wrenches [N, N m] to execute after those, `model.dt` each, and the next state.
    """
    params, tuning, goal = problem
    dtype = state.plan.dtype
    measured = history.observation[STATE][-1].astype(dtype)
    goal = goal._replace(pose=goal.pose.astype(dtype))
    if TARGET_RATE in history.observation:
        goal = goal_of_turning(goal, history.observation[TARGET_RATE][-1].astype(dtype))
    learned = _corrected(shape, model.dt, tuning, state, measured)

    position = View.of(measured).position
    distance = jnp.sqrt(jnp.sum((position - goal.pose[:3]) ** 2))
    nearness = jnp.minimum(1, tuning.sigma_near + (1 - tuning.sigma_near) * distance / tuning.sigma_distance)
    sigma, warm, reference = nearness * tuning.sigma, state.plan, jnp.zeros((shape.horizon, 6), dtype)
    if shape.objective == "safe":
        approach = safe_approach(shape, model.dt, tuning, goal, state.effect, measured)
        goal, tuning, reference = approach.goal, approach.tuning, approach.path[1:]
        led = approach.share * led_along(approach, state.effect, state.plan, model.dt)
        sigma, warm = approach.share * sigma, jnp.where(state.started, led, warm)
    candidates = sample_candidates(shape, sigma, warm, key=key)

    # The rollout is vmapped whole, not its step: what no action moves (the context, the station) is computed
    # once.
    start = model.encode(params, history)
    if shape.latency:
        start, _ = jax.lax.scan(lambda at, wrench: (model.step(params, None, wrench, at), None), start, committed)
    views = jax.vmap(lambda actions: roll_out(model, params, start, actions * tuning.limit).astype(dtype))(candidates)
    elapsed = model.dt * (shape.latency + jnp.arange(1, shape.horizon + 1, dtype=dtype))
    views = jax.vmap(jax.vmap(corrector.apply, (None, 0, 0)), (None, 0, None))(learned.correction, views, elapsed)

    few = max(shape.chunk, 2)
    effect = effect_of(candidates[:, 1:few], views[:, 0], views[:, few - 1], (few - 1) * model.dt)
    clear = clearance(goal.field, position) >= 0
    cost = partial(sequence_cost, shape.objective, tuning.weights, goal, clear=clear, deceleration=authority(effect))
    costs = jax.vmap(lambda *candidate: cost(*candidate, reference=reference))(views, candidates)
    weights = candidate_weights(costs, tuning.temperature)
    best = average(weights, candidates)
    # What the model expects of the executed wrenches: over one chunk the views are linear in the actions to
    # well below the sensors' noise, so they may be averaged like them, which saves another rollout and its
    # compilation.
    expected = jnp.einsum("k,ki->i", weights, views[:, shape.chunk - shape.latency - 1])
    following = shifted(best, shape.chunk, coasting_wrench(effect))
    following = PlannerState(following, expected, jnp.all(jnp.isfinite(expected)), learned, effect)
    return best[: shape.chunk] * tuning.limit, following


def _corrected(
    shape: Shape, dt: float, tuning: Tuning, state: PlannerState, measured: Float[Array, "13"]
) -> corrector.Corrector:
    """What the corrector has learned with this measurement; nothing new where nothing was expected."""
    learned = corrector.update(
        state.corrector, state.expected, measured, shape.chunk * dt, tuning.gain, tuning.drift_gain
    )
    return jax.tree.map(lambda new, old: jnp.where(state.started, new, old), learned, state.corrector)
