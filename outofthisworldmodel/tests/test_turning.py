"""World models and the planner before a target that turns."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm.baselines.exact import ExactDynamics
from owm.interface import History, roll_out
from owm.planning.policy import PlannerPolicy
from owm.planning.turning import BeforeTurning, transition_at_rest
from owm.study.conditions import condition
from owm.study.matrix import planner_of
from owm_envs.config import load_config
from owm_envs.dynamics.turning import seen_turning
from owm_envs.env import DockingEnv
from owm_envs.policies.geodesic import field_of
from owm_envs.task.sensors import STATE, TARGET_RATE
from owm_envs.view import View

SPINNING = {"target": {"rate_deg": (2.0, -3.0, 3.0)}, "randomization": {"target_rate_deg": (0.0, 0.0)}}


@pytest.fixture(scope="module")
def flown():
    """A flight of a free-flyer under held wrenches, as the target sees it: views, wrenches, rate."""
    env = DockingEnv(load_config(preset="tumbling", fidelity="iss", steps_per_action=5, **SPINNING))
    rng = np.random.default_rng(0)
    wrenches = rng.uniform(-1, 1, (40, 6)) * np.array([1600.0] * 3 + [500.0] * 3)
    with jax.enable_x64(True):
        params, step = env.default_params(), jax.jit(env.step)
        state, observation = jax.jit(env.reset)(params, key=jax.random.key(1))
        views = [np.asarray(state.view)]
        for wrench in wrenches:
            state, _ = step(params, state, jnp.asarray(wrench))
            views.append(np.asarray(state.view))
    return np.stack(views), wrenches.astype(np.float32), np.asarray(observation[TARGET_RATE])


def history(views, wrenches, rate, now, length=8):
    seen = {
        STATE: jnp.asarray(views[now - length + 1 : now + 1], jnp.float32),
        TARGET_RATE: jnp.tile(jnp.asarray(rate), (length, 1)),
    }
    return History(seen, jnp.asarray(wrenches[now - length + 1 : now]), jnp.ones(length, bool))


def test_a_model_of_a_target_at_rest_predicts_what_one_that_turns_sees(flown):
    views, wrenches, _ = flown
    model = BeforeTurning(ExactDynamics("iss"))
    state = model.encode(model.params, history(*flown, now=10))
    predicted = View.of(np.asarray(roll_out(model, model.params, state, jnp.asarray(wrenches[10:]))))
    true = View.of(views[11:])
    np.testing.assert_allclose(predicted.position, true.position, atol=2e-3)
    np.testing.assert_allclose(predicted.velocity, true.velocity, atol=5e-4)
    assert (np.abs(np.sum(predicted.attitude * true.attitude, axis=1)) > 1 - 1e-6).all()
    np.testing.assert_allclose(predicted.rate, true.rate, atol=2e-5)
    # Without it the prediction is that of a chaser which flies straight on: tens of metres off.
    plain = ExactDynamics("iss")
    start = plain.encode(plain.params, history(*flown, now=10))
    astray = roll_out(plain, plain.params, start, jnp.asarray(wrenches[10:]))
    assert np.linalg.norm(np.asarray(astray)[-1, :3] - true.position[-1]) > 5


def test_measurements_on_the_way_are_taken_in(flown):
    views, wrenches, _ = flown
    model = BeforeTurning(ExactDynamics("iss"))
    state = model.encode(model.params, history(*flown, now=10))
    for now in range(10, 20):
        seen = {STATE: jnp.asarray(views[now + 1], jnp.float32)}
        state = model.observe(model.params, state, jnp.asarray(wrenches[now]), seen)
    np.testing.assert_allclose(model.decode(model.params, state)[STATE], views[20], atol=1e-4)


def test_a_transition_is_one_of_a_target_at_rest():
    rng = np.random.default_rng(0)
    before = rng.normal(size=(3, 13)).astype(np.float32)
    before[:, 6:10] /= np.linalg.norm(before[:, 6:10], axis=1, keepdims=True)
    rate = rng.normal(size=(3, 3)).astype(np.float32) * 0.05
    then = jax.vmap(seen_turning, (0, 0, None))(before, rate, -0.25)
    now = jax.vmap(seen_turning)(before, rate)
    earlier, later = transition_at_rest(np.asarray(then), np.asarray(now), rate, 0.25)
    np.testing.assert_allclose(earlier, before, atol=1e-5)
    np.testing.assert_allclose(later, before, atol=1e-5)


@pytest.mark.slow
def test_the_planner_docks_with_a_target_that_turns():
    from owm.scores.docking import fly_episodes

    asked = condition("target turns at 5 deg/s")
    told = load_config(asked.told(), fidelity="iss-hcw", horizon=240.0)
    planner = planner_of("safe")
    policy = PlannerPolicy(ExactDynamics("iss-hcw", history_length=8), field_of(told), told, planner, num_slots=2)
    flights = fly_episodes(policy, told, np.array([11, 12]), np.array([0, 0]))
    assert (flights.outcome == "docked").all() and not flights.collided.any()
    assert np.degrees(flights.closest_attitude).max() < 2.0 and flights.closest_speed.max() < 0.12
