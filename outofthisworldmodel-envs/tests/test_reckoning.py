"""Dead reckoning of scripted policies while relative navigation is quiet."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.env import DockingEnv
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.policies.base import Vehicle
from owm_envs.policies.reckoning import coast, reckoning
from owm_envs.task.sensors import STATE, STATE_VALID
from owm_envs.view import View

VEHICLE = Vehicle(12_000.0, (80_000.0, 80_000.0, 50_000.0), 1600.0, 2000.0, 0.25)
WRENCHES = np.float32([[400, -300, 800, 150, -80, 60], [-200, 0, 100, 0, 90, -50]])


@pytest.fixture(scope="module")
def env():
    return DockingEnv(fidelity="iss", precision="float32", steps_per_action=5)


@pytest.fixture(scope="module")
def policy(env):
    return make_policy("dock", env)


def seen(env, view, valid=None):
    """A batch of one observation."""
    state = np.zeros((1, env.layout.size), np.float32)
    state[:, env.layout.view] = view
    return {STATE: state} | ({} if valid is None else {STATE_VALID: np.array([[valid]])})


VIEW = np.float32([3, -80, 4, 0.2, 0.5, -0.1, 1, 0, 0, 0, 0.002, -0.001, 0.003])


def test_it_coasts_as_a_free_body_does():
    """Held wrenches over 10 s against small steps of the equations of motion."""
    view, fine = VIEW, VIEW.astype(np.float64)
    small = VEHICLE._replace(decision_dt=0.25 / 50)
    step, finely = jax.jit(lambda x, w: coast(VEHICLE, x, w)), jax.jit(lambda x, w: coast(small, x, w))
    for wrench in np.repeat(WRENCHES, 20, axis=0):
        view = step(view, wrench)
        for _ in range(50):
            fine = finely(fine, wrench)
    apart = View.of(np.asarray(view - fine))
    assert np.linalg.norm(apart.position) < 0.02 and np.linalg.norm(apart.velocity) < 2e-3
    assert np.linalg.norm(apart.attitude) < 1e-3 and np.linalg.norm(apart.rate) < 1e-6
    no_push = coast(VEHICLE, jnp.asarray(VIEW), jnp.zeros(6))
    np.testing.assert_allclose(no_push[:3], VIEW[:3] + 0.25 * VIEW[3:6], rtol=1e-6)


def test_while_it_sees_it_changes_nothing(env, policy):
    plain, reckoned, told = VectorPolicy(policy), VectorPolicy(reckoning(policy)), VectorPolicy(reckoning(policy))
    for each in (plain, reckoned, told):
        each.reset(ports=[0])
    assert reckoned.name == plain.name
    for by in range(3):
        view = VIEW + np.float32(0.1 * by)
        expected = plain.predict(seen(env, view))[0]
        np.testing.assert_array_equal(reckoned.predict(seen(env, view))[0], expected)
        np.testing.assert_allclose(told.predict(seen(env, view, True))[0], expected, rtol=1e-6)


def test_while_it_is_blind_it_goes_by_its_own_commands(env, policy):
    reckoned, shown = VectorPolicy(reckoning(policy)), VectorPolicy(policy)
    for each in (reckoned, shown):
        each.reset(ports=[0])
    view = VIEW
    action = reckoned.predict(seen(env, view, True))[0]
    for _ in range(8):
        view = np.asarray(coast(VEHICLE, jnp.asarray(view), jnp.asarray(env.layout.wrench(action[0]))))
        action = reckoned.predict(seen(env, np.full(13, np.nan), False))[0]
        np.testing.assert_allclose(action, shown.predict(seen(env, view))[0], rtol=1e-4, atol=1e-3)
    assert np.linalg.norm(view[:3] - VIEW[:3]) > 0.5
