"""The planner: its pure functions, and the policy around them flying a rigid body beside a box."""

from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_normalize, quat_rotate
from owm.model.interface import History
from owm.planning import corrector, mppi, objective
from owm.planning.config import PlannerConfig
from owm.planning.policy import PlannerPolicy, replan_slot
from owm_envs.config import load_config
from owm_envs.geodesic import FieldConfig, GeodesicField, solve_field
from owm_envs.station import PORTS, goal_poses

PORT = 0
GOAL = goal_poses()[PORT].astype(np.float32)
LIMIT = (1600.0,) * 3 + (2000.0,) * 3
ENV = load_config(fidelity="iss", precision="float32", steps_per_action=5)
NO_BIAS = np.zeros(6, np.float32)
NONE_COMMITTED = np.zeros((0, 6), np.float32)
BIAS = np.float32([0.012, -0.008, 0.01, 5e-4, 0, -5e-4])
BOX_CORNER = GOAL[:3] + np.float32([24.0, -12.0, -12.0])
CONFIG = PlannerConfig()
TUNING = CONFIG.tuning(LIMIT)
GAINS = TUNING.gain, TUNING.drift_gain


@dataclass(frozen=True)
class FreeBody:
    """Accelerated by its wrench over 12 t and 80 t m2 and by a bias, its only parameter (m/s2, rad/s2)."""

    history_length: int = 3
    dt: float = 0.25
    name: str = "free body"

    @property
    def params(self):
        return NO_BIAS

    def encode(self, params, history):
        return history.observation[-1]

    def step(self, params, key, action, state):
        dt = self.dt
        acceleration = quat_rotate(state[6:10], action[:3] / 12_000.0) + params[:3]
        rate = state[10:] + dt * (action[3:] / 80_000.0 + params[3:])
        velocity = state[3:6] + dt * acceleration
        position = state[:3] + dt * velocity
        attitude = quat_multiply(state[6:10], quat_from_rotation_vector(dt * rate))
        return jnp.concatenate([position, velocity, quat_normalize(attitude), rate])

    def observe(self, params, state, action, observation):
        return observation

    def decode(self, params, state):
        return {"state": state}


@cache
def small_field() -> GeodesicField:
    """A coarse field of one port with one box 24 m to its side."""
    box = np.stack([BOX_CORNER, BOX_CORNER + np.float32([8.0, 24.0, 24.0])])[None]
    config = FieldConfig(fine_spacing=4.0, coarse_spacing=8.0, extent=48.0, exact_radius=12.0)
    return jax.device_put(solve_field(box, GOAL[None, :3], np.asarray([PORTS[PORT].normal]), config=config))


def view_at(offset, attitude=None) -> np.ndarray:
    """A view at rest, `offset` metres from the goal."""
    attitude = GOAL[3:] if attitude is None else attitude
    return np.concatenate([GOAL[:3] + np.float32(offset), np.zeros(3), attitude, np.zeros(3)]).astype(np.float32)


def history_at(view, length: int = 3) -> History:
    """A history that saw nothing but one view."""
    return History(np.tile(view, (length, 1)), np.zeros((length - 1, 6), np.float32), np.arange(length) == length - 1)


def observe(layout, views) -> np.ndarray:
    """Observations (B, O) that hold views (B, 13) and nothing else."""
    observation = np.zeros((len(views), layout.size), np.float32)
    observation[:, layout.view] = views
    return observation


@jax.jit
def move(bias, views, actions):
    """Advance a batch of true views by one decision of a body with a bias."""
    return jax.vmap(lambda view, action: FreeBody().step(bias, None, action, view))(views, actions)


def test_smooth_noise_has_unit_deviation_and_the_first_candidate_none():
    shape = CONFIG.shape._replace(candidates=2001)
    sigma = np.float32([0.2, 0.2, 0.2, 0.05, 0.05, 0.05])
    warm = jnp.linspace(-0.1, 0.1, 64 * 6, dtype=jnp.float32).reshape(64, 6)
    candidates = np.asarray(mppi.sample_candidates(shape, sigma, warm, key=jax.random.key(3)))
    np.testing.assert_array_equal(candidates[0], warm)
    noise = (candidates[1:] - np.asarray(warm)) / sigma
    np.testing.assert_allclose(noise.std(axis=0), 1.0, atol=0.08)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.12)
    neighbours = np.mean(noise[:, 1:] * noise[:, :-1])
    assert neighbours > 0.95  # white noise would have none


def test_candidates_stay_within_the_limits():
    warm = jnp.full((64, 6), 0.95, jnp.float32)
    candidates = mppi.sample_candidates(CONFIG.shape, np.float32([0.5] * 6), warm, key=jax.random.key(0))
    assert float(jnp.max(jnp.abs(candidates))) == 1.0


step_cost = jax.jit(objective.step_cost, static_argnums=0)
sequence_cost = jax.jit(objective.sequence_cost, static_argnums=0)


def _cost(offset, velocity=(0, 0, 0), kind="geodesic"):
    view = view_at(offset)
    view[3:6] = velocity
    cost, gap = step_cost(kind, TUNING.weights, small_field(), np.int32(0), GOAL, view, np.zeros(6, np.float32))
    return float(cost), float(gap)


@pytest.mark.parametrize("kind", ["geodesic", "straight", "plain"])
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

    def cost(views, starts_clear=True):
        given = (TUNING.weights, small_field(), np.int32(0), GOAL, starts_clear, np.float32(np.inf))
        return float(sequence_cost("geodesic", *given, np.stack(views), np.zeros((4, 6), np.float32)))

    early, late, never = cost([inside] * 4), cost([clear] * 3 + [inside]), cost([clear] * 4)
    assert early == pytest.approx(2000.0)  # 1000 (1 + whole horizon), nothing else is counted
    assert late == pytest.approx(1250.0 + 0.75 * never, rel=1e-5)
    # Who starts in contact is led out instead: the same views without the charge.
    assert never < cost([inside] * 4, False) < 400.0


TRUTH = corrector.Correction(*(np.float32(x) for x in ([0.02, -0.01, 0], [1e-3, 0, -2e-3], [0, 0.1, 0])))


def corrections(truth, noise, replans, seed=0):
    """The corrections found at each replan from predictions that lack `truth` and measurements of some noise."""
    apply, update = jax.jit(corrector.apply), jax.jit(corrector.update)
    view, known, found = view_at((5, 5, 5)), corrector.init_corrector(), []
    for error in np.random.default_rng(seed).normal(size=(replans, 13)) * noise:
        measured = apply(truth, view, np.float32(2.0)) + np.float32(error)
        known = update(known, apply(known.correction, view, np.float32(2.0)), measured, 2.0, *GAINS)
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
    def cost(speed, able):
        view = view_at((0, -12, 0))
        view[4] = speed
        given = (TUNING.weights, small_field(), np.int32(0), GOAL, True, np.float32(able))
        return float(sequence_cost(kind, *given, view[None], np.zeros((1, 6), np.float32)))

    braked, unbraked = (cost(2.0, able) - cost(2.0, np.inf) for able in (0.2, 0.06))  # over 12 m: 2.19 and 1.2 m/s
    assert braked == 0.0
    assert unbraked == (0.0 if kind == "plain" else pytest.approx(10.0 * (2.0 - (2 * 0.06 * 12) ** 0.5) ** 2, rel=0.05))


def flown_candidates(late=0):
    """Candidates, and the views from which and to which a steadily biased vehicle flies their first chunk."""
    candidates = mppi.sample_candidates(
        CONFIG.shape, TUNING.sigma, jnp.zeros((64, 6), jnp.float32), key=jax.random.key(0)
    )
    view = before = jnp.broadcast_to(view_at((0, -15, 3)), (128, 13))
    for step in range(CONFIG.chunk):
        view = move(BIAS, view, candidates[:, max(step - late, 0)] * TUNING.limit)
    return candidates[:, : CONFIG.chunk], before, view, CONFIG.chunk * FreeBody.dt


def test_the_coasting_wrench_cancels_a_steady_acceleration():
    flown = flown_candidates()
    view = flown[1]
    wrench = TUNING.limit * mppi.coasting_wrench(mppi.effect_of(*flown))
    still = move(BIAS, view[:1], wrench[None])[0]
    np.testing.assert_allclose(still[3:6], view[0, 3:6], atol=2e-5)
    np.testing.assert_allclose(still[10:], view[0, 10:], atol=1e-7)
    unmoved = mppi.effect_of(flown[0], view, view, 2.0)
    np.testing.assert_array_equal(mppi.coasting_wrench(unmoved), 0.0)
    assert mppi.authority(unmoved) == np.inf


@pytest.mark.parametrize("late", [0, 1])
def test_the_authority_is_the_thrust_over_the_mass(late):
    """Also where thrusters answer a step late, of which a single step would show nothing."""
    able = float(mppi.authority(mppi.effect_of(*flown_candidates(late))))
    assert able == pytest.approx(1600.0 / 12_000.0, rel=0.01 if not late else 0.15)


def replan(view, seed=0, params=NO_BIAS):
    """Replan through the same compiled program as the policies below."""
    return replan_slot()(
        FreeBody(), CONFIG.shape, params, TUNING, small_field(), np.int32(0), GOAL, history_at(view), NONE_COMMITTED,
        jax.device_get(mppi.init_planner(CONFIG.shape)), np.uint32(seed), np.uint32(0), np.uint32(0),
    )  # fmt: skip


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
    predicted = mppi.rollout(FreeBody(), NO_BIAS, view, wrenches)[-1]
    error = np.abs(np.asarray(state.expected - predicted))
    # Averaged over candidates, not rolled out: apart by less than cooperative noise (0.05 m, 0.002 m/s).
    assert error[:3].max() < 5e-4 and error[3:6].max() < 5e-4 and error[10:].max() < 1e-6


def test_replan_does_not_compile_again_for_other_numbers():
    replan(view_at((0, -15, 3)))
    before = replan_slot()._cache_size()
    replan(view_at((1, -9, 2)), seed=9, params=np.full(6, 1e-3, np.float32))
    assert replan_slot()._cache_size() == before


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


STARTS = np.stack([view_at((3, -20, 4)), view_at((-8, -14, -6), np.float32([0.5, -0.866, 0, 0]))])


def make(slots=2, **values) -> PlannerPolicy:
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, PlannerConfig(**values), slots)
    policy.reset(ports=np.full(slots, PORT))
    return policy


def fly(policy, views, decisions, bias=NO_BIAS):
    """Fly a batch of bodies; return the last views and all actions."""
    actions = []
    for _ in range(decisions):
        action, _ = policy.predict(observe(policy.layout, views))
        views = np.asarray(move(bias, views, action))
        actions.append(action)
    return views, np.stack(actions)


def miss(views):
    """Distance to the goal m, speed m/s, angle to the goal attitude rad."""
    angle = 2 * np.arccos(np.minimum(1, np.abs(views[:, 6:10] @ GOAL[3:])))
    return np.linalg.norm(views[:, :3] - GOAL[:3], axis=1), np.linalg.norm(views[:, 3:6], axis=1), angle


@pytest.mark.parametrize(("bias", "latency"), [(NO_BIAS, 0), (BIAS, 0), (BIAS, 1)])
def test_reaches_the_goal_and_stays_there(bias, latency):
    """Bias or none, planned in no time or in a step: the corrector finds it and the warm start holds against it."""
    policy = make(latency=latency)
    views, actions = fly(policy, STARTS, 200, bias)
    assert (actions[:latency] == 0).all() and np.abs(actions[latency]).max() > 1.0
    assert actions.dtype == np.float32 and actions.shape == (200, 2, 6)
    misses = []
    for _ in range(5):
        misses.append(miss(views))
        views, _ = fly(policy, views, 8, bias)
    distance, speed, angle = np.mean(misses, axis=0)
    assert (distance < 0.1).all() and (speed < 0.05).all() and (angle < np.radians(2)).all()


def test_without_the_corrector_a_bias_keeps_it_away():
    assert (miss(fly(make(corrector=False), STARTS, 200, BIAS)[0])[0] > 0.5).all()


@dataclass(frozen=True)
class BiasLearner:
    """Takes half of each prediction error over as a bias."""

    def init(self, params):
        return params

    def learn(self, known, before, action, after):
        miss = after - FreeBody().step(known, None, action, before)
        return known + 0.5 * jnp.concatenate([miss[3:6], miss[10:]]) / FreeBody.dt

    def params(self, known):
        return known


def test_a_learner_gives_each_slot_the_parameters_it_finds():
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, PlannerConfig(corrector=False), 2, learner=BiasLearner())
    policy.reset(ports=[PORT] * 2)
    views = STARTS
    for _ in range(30):  # one slot under the bias, one without
        action, state = policy.predict(observe(policy.layout, views))
        flown = [move(bias, views, action) for bias in (BIAS, NO_BIAS)]
        views = np.stack([flown[0][0], flown[1][1]])
    np.testing.assert_allclose(state.known, [BIAS, NO_BIAS], atol=2e-5)
    policy.reset(mask=np.array([True, False]))
    _, state = policy.predict(observe(policy.layout, views))
    np.testing.assert_allclose(state.known, [NO_BIAS, NO_BIAS], atol=2e-5)


def test_a_reset_slot_starts_like_a_fresh_policy_and_leaves_the_others_alone():
    policy, undisturbed, fresh = make(), make(), make()
    half, _ = fly(policy, STARTS, 5)  # in the middle of a chunk
    fly(undisturbed, STARTS, 5)
    policy.reset(mask=np.array([False, True]))
    again = np.stack([half[0], STARTS[1]])
    _, actions = fly(policy, again, 21)
    _, continued = fly(undisturbed, np.stack([half[0], half[1]]), 21)
    _, first = fly(fresh, STARTS, 21)
    np.testing.assert_array_equal(actions[:, 1], first[:, 1])
    np.testing.assert_array_equal(actions[:, 0], continued[:, 0])
    assert np.abs(actions[:, 1] - continued[:, 1]).max() > 1.0  # N


def test_episode_start_is_a_reset():
    told, flagged = make(), make()
    half, _ = fly(told, STARTS, 5)
    fly(flagged, STARTS, 5)
    told.reset(mask=np.array([True, False]))
    observation = observe(told.layout, half)
    expected, _ = told.predict(observation)
    actual, _ = flagged.predict(observation, episode_start=np.array([True, False]))
    np.testing.assert_array_equal(actual, expected)


def test_slots_do_not_depend_on_their_number():
    _, alone = fly(make(1), STARTS[:1], 9)
    _, together = fly(make(2), STARTS, 9)
    np.testing.assert_array_equal(alone[:, 0], together[:, 0])


def test_a_returned_state_can_be_resumed():
    policy = make()
    views = STARTS
    observation = observe(policy.layout, views)
    _, state = policy.predict(observation)
    second, _ = policy.predict(observation, state)
    policy.predict(observation)
    repeated, _ = policy.predict(observation, state)
    np.testing.assert_array_equal(repeated, second)


def test_ended_slots_are_skipped_until_they_begin_again():
    policy = make()
    policy.active = np.array([True, False])
    actions, _ = policy.predict(observe(policy.layout, STARTS))
    assert len(policy.seconds) == 1
    assert (actions[1] == 0).all() and np.abs(actions[0]).max() > 1.0
    policy.reset(mask=np.array([False, True]))
    actions, _ = policy.predict(observe(policy.layout, STARTS))
    assert len(policy.seconds) == 2 and np.abs(actions[1]).max() > 1.0


def test_sees_only_the_measured_view():
    """Epoch and goal error are never read, and truth has no way in: no info is ever passed."""
    env = load_config(fidelity="iss-numerical", steps_per_action=5)
    seen, blind = (PlannerPolicy(FreeBody(), small_field(), env, num_slots=2) for _ in range(2))
    for policy in (seen, blind):
        policy.reset(ports=[PORT] * 2)
    observation = observe(seen.layout, STARTS)
    erased = np.full_like(observation, np.nan)
    erased[:, seen.layout.view] = STARTS
    np.testing.assert_array_equal(seen.predict(observation)[0], blind.predict(erased)[0])


def test_normalised_environments_get_the_same_commands():
    config = ENV.model_copy(update={"normalize": True})
    plain = make()
    scaled = PlannerPolicy(FreeBody(), small_field(), config, num_slots=2)
    scaled.reset(ports=[PORT] * 2)
    limit = np.float32(LIMIT)
    scale = np.float32([225.0] * 3 + [5.0] * 3 + [1.0] * 4 + [0.05] * 3)
    wrench, _ = plain.predict(observe(plain.layout, STARTS))
    action, _ = scaled.predict(observe(scaled.layout, STARTS / scale))
    np.testing.assert_allclose(action * limit, wrench, atol=0.02 * 1600)
    assert np.abs(action).max() <= 1


def test_wrong_decision_rate_is_refused():
    with pytest.raises(ValueError, match=r"every 0\.25 s.*steps_per_action=5"):
        PlannerPolicy(FreeBody(), small_field(), load_config(fidelity="iss"))


def test_ports_are_checked():
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, num_slots=2)
    with pytest.raises(ValueError, match="call reset"):
        policy.predict(np.zeros((2, policy.layout.size), np.float32))
    with pytest.raises(ValueError, match="ports must be given"):
        policy.reset()
    with pytest.raises(ValueError, match="indices from 0 to 7"):
        policy.reset(ports=[0, 8])
    with pytest.raises(ValueError, match="does not cover zvezda_aft"):
        policy.reset(ports=[0, 3])
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        policy.reset(ports=[0])


def test_observations_are_checked():
    policy = make()
    with pytest.raises(ValueError, match="must have shape"):
        policy.predict(np.zeros((2, 7), np.float32))
    broken = observe(policy.layout, STARTS)
    broken[1, policy.layout.view] = np.nan
    with pytest.raises(ValueError, match=r"not finite in slots \[1\]"):
        policy.predict(broken)
