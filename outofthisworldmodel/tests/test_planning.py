"""The planner's pure functions: candidates, costs, corrections, a replan."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_body import BIAS, GOAL, LIMIT, NO_BIAS, FreeBody, history_at, move, small_field, view_at

from astrojax.constants import GM_EARTH
from owm.interface import roll_out
from owm.planning import corrector, cost, effect, mppi, sampler, update
from owm.planning.config import PlannerConfig
from owm.planning.policy import replan_slot
from owm_envs.policies.guidance import Goal, drift_beside
from owm_envs.view import View

CONFIG = PlannerConfig()
TUNING = CONFIG.tuning(LIMIT)
GAINS = TUNING.gain, TUNING.drift_gain


def test_smooth_noise_has_unit_deviation_and_the_first_candidate_none():
    shape = CONFIG.shape._replace(candidates=2001)
    sigma = np.float32([0.2, 0.2, 0.2, 0.05, 0.05, 0.05])
    warm = jnp.linspace(-0.1, 0.1, 64 * 6, dtype=jnp.float32).reshape(64, 6)
    candidates = np.asarray(sampler.sample_candidates(shape, sigma, warm, key=jax.random.key(3)))
    np.testing.assert_array_equal(candidates[0], warm)
    noise = (candidates[1:] - np.asarray(warm)) / sigma
    np.testing.assert_allclose(noise.std(axis=0), 1.0, atol=0.08)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.12)
    neighbours = np.mean(noise[:, 1:] * noise[:, :-1])
    assert neighbours > 0.95  # white noise would have none


def test_candidates_stay_within_the_limits():
    warm = jnp.full((64, 6), 0.95, jnp.float32)
    candidates = sampler.sample_candidates(CONFIG.shape, np.float32([0.5] * 6), warm, key=jax.random.key(0))
    assert float(jnp.max(jnp.abs(candidates))) == 1.0


step_cost = jax.jit(cost.step_cost, static_argnums=0)
sequence_cost = jax.jit(cost.sequence_cost, static_argnums=0)


REST = np.concatenate([GOAL[:3], np.zeros(3)]).astype(np.float32)
"""A reference that stands at the goal."""


def goal():
    return Goal(small_field(), np.int32(0), GOAL, drift_beside((GM_EARTH / 1.13e-3**2) ** (1 / 3)))


def rests(steps):
    return np.tile(REST, (steps, 1))


def _cost(offset, velocity=(0, 0, 0), kind="geodesic"):
    view = view_at(offset)
    View.of(view).velocity[:] = velocity
    charged, gap = step_cost(kind, TUNING.weights, goal(), view, np.zeros(6, np.float32), REST)
    return float(charged), float(gap)


def some_steps():
    """Four views about the goal, the last inside the box, and efforts."""
    rng = np.random.default_rng(7)
    attitude = rng.normal(size=(4, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    position = GOAL[:3] + rng.uniform(-15, 15, (4, 3))
    views = np.concatenate([position, rng.normal(size=(4, 3)), attitude, 0.02 * rng.normal(size=(4, 3))], axis=1)
    views[3] = view_at((23, 0, 0))
    return views.astype(np.float32), rng.uniform(-1, 1, (4, 6)).astype(np.float32)


PINNED = {
    "geodesic": ([42.66195, 46.253338, 52.17837, 264.06995], [1285.2734, 101.290894, 47.03122]),
    "straight": ([42.054646, 48.625465, 52.178368, 173.04425], [1285.7146, 78.97568, 47.6195]),
    "plain": ([332.0245, 403.5985, 411.7334, 628.05404], [1536.8391, 443.8526, 382.45215]),
    "safe": ([543.25665, 651.00616, 651.99316, 945.45404], [1711.564, 697.9275, 615.4187]),
}
"""Costs of `some_steps` one by one, and together: from clear space, from within the hull, without the last."""
PINNED_PLANS = {
    ("geodesic", 0): [[-549.8662, 159.84917, 284.2796, -132.95317], [-625.6113, 137.06006, 351.5509, -129.14856]],
    ("straight", 0): [[-549.8651, 159.84859, 284.2789, -132.95335], [-625.6102, 137.05969, 351.55014, -129.14879]],
    ("plain", 1): [[-407.90234, 137.68942, 639.4648, -55.189304], [-478.32236, 138.16388, 783.6223, -45.816246]],
    ("safe", 1): [[-1442.5311, 687.5239, 1374.1567, -235.8373], [-1470.0311, 665.8823, 1352.8447, -236.9025]],
}
"""First wrenches of a second replan, which has a warm start and a correction."""


@pytest.mark.parametrize("kind", cost.OBJECTIVES)
def test_costs_keep_their_numbers(kind):
    views, efforts = some_steps()
    steps, sequences = PINNED[kind]
    given = partial(step_cost, kind, TUNING.weights, goal())
    np.testing.assert_allclose([given(*step, REST)[0] for step in zip(views, efforts)], steps, rtol=2e-6)
    given = partial(sequence_cost, kind, TUNING.weights, goal(), deceleration=np.float32(0.06))
    found = [given(views, efforts, clear=clear, reference=rests(4)) for clear in (True, False)]
    found.append(given(views[:3], efforts[:3], clear=True, reference=rests(3)))
    np.testing.assert_allclose(found, sequences, rtol=2e-6)


@pytest.mark.parametrize(("kind", "latency"), PINNED_PLANS)
def test_plans_keep_their_numbers(kind, latency):
    shape = PlannerConfig(objective=kind, latency=latency).shape
    view = view_at((2, -15, 3))
    View.of(view).velocity[:] = [0.3, 0.1, -0.2]
    state = jax.device_get(mppi.init_planner(shape))
    for count in range(2):
        wrenches, state = replan(view, 5, BIAS, shape=shape, state=state, slot=1, count=count)
        state = jax.device_get(state)
        view = state.expected + np.float32(0.01)
        attitude = View.of(view).attitude
        attitude /= np.linalg.norm(attitude)
    # A sum in another order moves a plan by far more than itself: its softmax is steep.
    np.testing.assert_allclose(wrenches[:2, :4], PINNED_PLANS[kind, latency], rtol=1e-4)


@pytest.mark.parametrize("kind", cost.OBJECTIVES)
def test_every_term_has_a_weight_and_is_charged_by_it(kind):
    """The step cost is linear in each weight, and each term stands in it once."""
    view, efforts = some_steps()[0][0], np.full(6, 0.5, np.float32)
    View.of(view).position[:] = View.of(view_at((21.5, 0, 0))).position  # so near the box that the margin counts
    weights = TUNING.weights
    whole, gap = step_cost(kind, weights, goal(), view, efforts, REST)
    assert gap < weights.margin
    names = [term.name for group in cost.OBJECTIVES[kind] for term in group]
    moving = ["tracking_position", "tracking_velocity"] if kind == "safe" else ["position", "velocity"]
    assert sorted(names) == sorted(["attitude", "clearance", "effort", "rate", *moving])
    shares = [
        float(whole - step_cost(kind, weights._replace(**{name: np.float32(0)}), goal(), view, efforts, REST)[0])
        for name in names
    ]
    assert min(shares) > 0
    assert sum(shares) == pytest.approx(float(whole), rel=1e-4)


@pytest.mark.parametrize("kind", cost.OBJECTIVES)
def test_step_cost_vanishes_at_the_goal_and_grows_away_from_it(kind):
    at_goal, near, far = (_cost((0, -d, 0), kind=kind)[0] for d in (0.0, 2.0, 12.0))
    assert at_goal == pytest.approx(0.0, abs=1e-3)
    assert 1.0 < near < far


@pytest.mark.parametrize("kind", ["geodesic", "straight"])
def test_the_profile_prefers_approaching_to_resting_to_leaving(kind):
    approach, rest, leave = (_cost((0, -12, 0), (0, v, 0), kind)[0] for v in (0.9, 0.0, -0.9))
    assert approach < rest < leave


def test_touching_costs_more_the_earlier_and_ends_the_candidate():
    inside, clear = view_at((23, 0, 0)), view_at((10, 0, 0))
    assert _cost((23, 0, 0))[1] < 0 < _cost((10, 0, 0))[1]

    def charged(views, starts_clear=True):
        given = (TUNING.weights, goal(), np.stack(views), np.zeros((4, 6), np.float32))
        able = {"clear": starts_clear, "deceleration": np.float32(np.inf)}
        return float(sequence_cost("geodesic", *given, **able, reference=rests(4)))

    early, late, never = charged([inside] * 4), charged([clear] * 3 + [inside]), charged([clear] * 4)
    assert early == pytest.approx(2000.0)  # 1000 (1 + whole horizon), nothing else is counted
    assert late == pytest.approx(1250.0 + 0.75 * never, rel=1e-5)
    # Who starts in contact is led out instead: the same views without the charge.
    assert never < charged([inside] * 4, False) < 400.0


TRUTH = corrector.Correction(*(np.float32(x) for x in ([0.02, -0.01, 0], [1e-3, 0, -2e-3], [0, 0.1, 0])))


def corrections(truth, noise, replans, seed=0):
    """The corrections found at each replan from predictions that lack `truth` and measurements of some noise."""
    apply, learn = jax.jit(corrector.apply), jax.jit(corrector.update)
    view, known, found = view_at((5, 5, 5)), corrector.init_corrector(), []
    for error in np.random.default_rng(seed).normal(size=(replans, 13)) * noise:
        measured = apply(truth, view, np.float32(2.0)) + np.float32(error)
        known = learn(known, apply(known.correction, view, np.float32(2.0)), measured, 2.0, *GAINS)
        found.append(known.correction)
    return jax.tree.map(lambda *rows: np.stack(rows), *found)


def test_corrector_finds_constant_biases():
    found = jax.tree.map(lambda rows: rows[-1], corrections(TRUTH, 0.0, 60))
    np.testing.assert_allclose(found.acceleration, TRUTH.acceleration, atol=1e-5)
    np.testing.assert_allclose(found.angular, TRUTH.angular, atol=1e-6)
    np.testing.assert_allclose(found.drift, TRUTH.drift, atol=1e-3)


def test_corrector_leaves_noise_alone_and_finds_what_stands_out_of_it():
    noise = np.repeat([0.25, 0.03, 0, 1e-5], [3, 3, 4, 3]) / 3**0.5  # m, m/s, -, rad/s
    nothing = corrections(corrector.no_correction(), noise, 400)
    # The mean alone would wander by half the noise of one residual, 9 mm/s2, and as many cm/s.
    assert np.sqrt(np.mean(nothing.acceleration[20:] ** 2)) < 1.5e-3
    assert np.sqrt(np.mean(nothing.drift[20:] ** 2)) < 1e-2
    loud = corrections(TRUTH._replace(acceleration=np.float32([0.06, -0.03, 0])), noise, 400)
    np.testing.assert_allclose(loud.acceleration[20:].mean(axis=0), [0.06, -0.03, 0], atol=6e-3)


@pytest.mark.parametrize("kind", ["geodesic", "straight", "plain"])
def test_a_speed_that_cannot_be_braked_is_charged(kind):
    def charged(speed, able):
        view = view_at((0, -12, 0))
        view[4] = speed
        given = (TUNING.weights, goal(), view[None], np.zeros((1, 6), np.float32))
        able = {"clear": True, "deceleration": np.float32(able)}
        return float(sequence_cost(kind, *given, **able, reference=rests(1)))

    # Over 12 m: 2.19 and 1.2 m/s.
    braked, unbraked = (charged(2.0, able) - charged(2.0, np.inf) for able in (0.2, 0.06))
    assert braked == 0.0
    assert unbraked == (0.0 if kind == "plain" else pytest.approx(10.0 * (2.0 - (2 * 0.06 * 12) ** 0.5) ** 2, rel=0.05))


def test_a_drift_towards_the_hull_is_charged():
    """The box stands 24 m off the goal: from 34 m off it a drift at 0.2 m/s ends in it, one away from it does not."""

    def charged(towards):
        view = view_at((-10, 0, 0))
        view[3] = towards
        given = (TUNING.weights._replace(tracking_velocity=np.float32(0)), goal(), np.tile(view, (16, 1)))
        able = {"clear": True, "deceleration": np.float32(1), "reference": rests(16)}
        return float(sequence_cost("safe", *given, np.zeros((16, 6), np.float32), **able))

    assert charged(0.2) - charged(-0.6) == pytest.approx(3.0 * 4.0, rel=1e-3)


def test_the_wrench_for_a_change_makes_it():
    flown = flown_candidates()
    found, view, chunk = effect.effect_of(*flown), flown[1][:1], flown[-1]
    change = np.float32([0.03, -0.02, 0.01, 1e-3, 0, -1e-3])
    wrench, after = TUNING.limit * effect.wrench_for(found, change), view
    for _ in range(CONFIG.chunk):
        after = move(BIAS, after, wrench[None])
    changed = np.asarray(after - view)[0, [3, 4, 5, 10, 11, 12]]
    assert float(found.elapsed) == chunk
    np.testing.assert_allclose(changed, change, atol=2e-4)


def flown_candidates(late=0):
    """Candidates, and the views from which and to which a steadily biased vehicle flies their first chunk."""
    candidates = sampler.sample_candidates(
        CONFIG.shape, TUNING.sigma, jnp.zeros((64, 6), jnp.float32), key=jax.random.key(0)
    )
    view = before = jnp.broadcast_to(view_at((0, -15, 3)), (128, 13))
    for step in range(CONFIG.chunk):
        view = move(BIAS, view, candidates[:, max(step - late, 0)] * TUNING.limit)
    return candidates[:, : CONFIG.chunk], before, view, CONFIG.chunk * FreeBody.dt


def test_the_coasting_wrench_cancels_a_steady_acceleration():
    flown = flown_candidates()
    view = flown[1]
    wrench = TUNING.limit * effect.coasting_wrench(effect.effect_of(*flown))
    still, before = View.of(move(BIAS, view[:1], wrench[None])[0]), View.of(view[0])
    np.testing.assert_allclose(still.velocity, before.velocity, atol=2e-5)
    np.testing.assert_allclose(still.rate, before.rate, atol=1e-7)
    unmoved = effect.effect_of(flown[0], view, view, 2.0)
    np.testing.assert_array_equal(effect.coasting_wrench(unmoved), 0.0)
    assert effect.authority(unmoved) == np.inf


@pytest.mark.parametrize("late", [0, 1])
def test_the_authority_is_the_thrust_over_the_mass(late):
    """Also where thrusters answer a step late, of which a single step would show nothing."""
    able = float(effect.authority(effect.effect_of(*flown_candidates(late))))
    assert able == pytest.approx(1600.0 / 12_000.0, rel=0.01 if not late else 0.15)


def replan(view, seed=0, params=NO_BIAS, shape=CONFIG.shape, state=None, slot=0, count=0):
    """Replan through the same compiled program as the policies below."""
    return replan_slot()(
        FreeBody(),
        shape,
        mppi.Problem(params, TUNING, goal()),
        history_at(view),
        jax.device_get(mppi.init_planner(shape)) if state is None else state,
        committed=np.full((shape.latency, 6), 100.0, np.float32),
        **{name: np.uint32(value) for name, value in (("seed", seed), ("slot", slot), ("count", count))},
    )


def test_replan_follows_from_its_key():
    view = view_at((0, -15, 3))
    first, again, other = replan(view, seed=1)[0], replan(view, seed=1)[0], replan(view, seed=2)[0]
    np.testing.assert_array_equal(first, again)
    assert np.abs(np.asarray(first - other)).max() > 1.0  # N
    assert first.shape == (8, 6)
    assert np.all(np.abs(np.asarray(first)) <= np.asarray(LIMIT))


def test_warm_start_is_the_rest_of_the_plan_and_the_expectation_is_the_models():
    view = view_at((2, -15, 3), attitude=np.float32([1, 0, 0, 0]))
    wrenches, state = replan(view)
    assert state.plan.shape == (64, 6)
    np.testing.assert_allclose(state.plan[-8:], 0.0, atol=1e-3)
    assert np.abs(np.asarray(state.plan[:-8])).max() > 0.01
    predicted = roll_out(FreeBody(), NO_BIAS, view, wrenches)[-1]
    error = View.of(np.abs(np.asarray(state.expected - predicted)))
    # Averaged over candidates, not rolled out: apart by less than cooperative noise (0.05 m, 0.002 m/s).
    assert error.position.max() < 5e-4 and error.velocity.max() < 5e-4 and error.rate.max() < 1e-6


def test_replan_does_not_compile_again_for_other_numbers():
    replan(view_at((0, -15, 3)))
    before = replan_slot()._cache_size()
    replan(view_at((1, -9, 2)), seed=9, params=np.full(6, 1e-3, np.float32))
    assert replan_slot()._cache_size() == before


def test_a_candidate_without_a_finite_cost_is_never_chosen():
    weights = update.candidate_weights(jnp.float32([2.0, jnp.nan, 1.0, jnp.inf]), 0.5)
    np.testing.assert_allclose(weights, np.array([np.exp(-2.0), 0, 1, 0]) / (1 + np.exp(-2.0)), rtol=1e-6)


def test_a_model_that_predicts_nan_yields_finite_actions():
    wrenches, _ = replan(view_at((0, -15, 3)), params=np.full(6, np.nan, np.float32))
    assert np.isfinite(np.asarray(wrenches)).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"objective": "geodetic"}, "did you mean 'geodesic'"),
        ({"chunk": 65}, "chunk must not exceed horizon=64, got 65"),
        ({"latency": 8}, "latency must be less than chunk=8, got 8"),
        ({"knots": 1}, "knots"),
        ({"temperature": 0.0}, "temperature"),
        ({"lambda_": 0.3}, "lambda_"),
    ],
)
def test_bad_configurations_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        PlannerConfig(**values)
