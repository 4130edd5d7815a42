"""The time-correlated part of the sensor error; the white part is tested in test_task."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.config import load_config
from owm_envs.config.params import params_from_config
from owm_envs.env import DockingEnv
from owm_envs.task.navigation import advance_bias, measure, start_bias
from owm_envs.view import View

BIAS = {"position": 0.3, "velocity": 0.02, "attitude": 1e-3, "rate": 2e-4, "correlation_time": 20.0}
NOISE = {"position": 0.05, "velocity": 0.002, "attitude": 5e-5, "rate": 1e-5}


def histories(correlation_time, dt, steps, count=4000):
    """(steps + 1, count, 4, 3) time-correlated errors of unit variance."""

    def one(key):
        def step(bias, key):
            after = advance_bias(bias, jnp.asarray(correlation_time), jnp.asarray(dt), key=key)
            return after, after

        first = start_bias(jnp.float64, key=key)
        return jnp.concatenate([first[None], jax.lax.scan(step, first, jax.random.split(key, steps))[1]])

    return np.asarray(jax.jit(jax.vmap(one, out_axes=1))(jax.random.split(jax.random.key(4), count)))


@pytest.mark.parametrize(("dt", "steps"), [(1.0, 40), (10.0, 4)])
def test_the_error_is_stationary_and_its_correlation_depends_on_time_alone(x64, dt, steps):
    errors = histories(20.0, dt, steps)
    spread = errors.reshape(steps + 1, -1).std(1)
    np.testing.assert_allclose(spread, 1.0, atol=0.02)  # 48 000 draws: five standard errors
    for elapsed in (10.0, 20.0, 40.0):
        correlation = np.mean(errors[0] * errors[round(elapsed / dt)])
        assert correlation == pytest.approx(np.exp(-elapsed / 20.0), abs=0.025)


def test_an_infinite_correlation_time_is_a_constant_bias_and_a_tiny_one_is_white(x64):
    constant = histories(np.inf, 1.0, 5, count=10)
    np.testing.assert_array_equal(constant, np.broadcast_to(constant[0], constant.shape))
    white = histories(1e-3, 1.0, 1)
    assert abs(np.mean(white[0] * white[1])) < 0.025
    slope = jax.grad(lambda dt: jnp.sum(advance_bias(jnp.ones((4, 3)), jnp.inf, dt, key=jax.random.key(0))))(1.0)
    assert np.isfinite(slope)


def test_white_and_correlated_parts_add_with_their_stated_total_rms(x64):
    params = params_from_config(load_config(noise={**NOISE, "bias": BIAS}))
    view = jnp.asarray([60.0, -80.0, 0.0, 0, 0, 0, 0.5, -0.5, 0.5, 0.5, 0, 0, 0])
    keys = jax.random.split(jax.random.key(1), 20_000)

    def measured(noise, key):
        bias = start_bias(jnp.float64, key=jax.random.fold_in(key, 1))
        return measure(noise, View.of(view), bias, key=key), measure(noise, View.of(view), key=key)

    measured = jax.jit(jax.vmap(measured, (None, 0)))
    both, white = measured(params.noise, keys)
    plain = params_from_config(load_config(noise=NOISE)).noise
    np.testing.assert_array_equal(white, measured(plain, keys)[1])
    errors, biases = View.of(np.asarray(both - view)), View.of(np.asarray(both - white))
    for name in ("position", "velocity", "rate"):
        rms = np.sqrt(np.mean(np.sum(getattr(errors, name) ** 2, axis=1)))
        assert rms == pytest.approx(np.hypot(BIAS[name], NOISE[name]), rel=0.02)
        added = np.sqrt(np.mean(np.sum(getattr(biases, name) ** 2, axis=1)))
        assert added == pytest.approx(BIAS[name], rel=0.02)
    turn = 2 * np.linalg.norm(biases.attitude, axis=1)  # small angles
    assert np.sqrt(np.mean(turn**2)) == pytest.approx(BIAS["attitude"], rel=0.02)


def test_an_environment_s_bias_drifts_beside_the_same_white_noise(x64, docking):
    _, params, reset, step = docking(fidelity="iss")
    params = params._replace(noise=params_from_config(load_config(noise=NOISE)).noise)
    _, biased, reset_biased, step_biased = docking(fidelity="iss", noise={**NOISE, "bias": BIAS})
    key = jax.random.key(8)
    (state, first), (state_biased, first_biased) = reset(params, key=key), reset_biased(biased, key=key)
    assert 0.01 < np.linalg.norm(View.of(first_biased["state"] - first["state"]).position) < 2
    offsets = []
    for _ in range(4):
        state, _ = step(params, state, jnp.zeros(6))
        state_biased, _ = step_biased(biased, state_biased, jnp.zeros(6))
        np.testing.assert_allclose(state_biased.view, state.view, rtol=0, atol=1e-12)
        offsets.append(View.of(np.asarray(state_biased.measured["state"] - state.measured["state"])).position)
        size = np.asarray(state_biased.bias[0]) * BIAS["position"] / np.sqrt(3)
        np.testing.assert_allclose(offsets[-1], size, atol=1e-9)
    moved = np.linalg.norm(np.diff(offsets, axis=0), axis=1)
    assert np.all(moved > 0) and moved.max() < 8 * BIAS["position"] * np.sqrt(2 * 0.05 / 20)


def test_an_infinite_correlation_time_is_a_number_like_others(x64, docking):
    _, params, reset, step = docking(fidelity="iss", noise={**NOISE, "bias": BIAS})
    forever = params.noise.bias._replace(correlation_time=jnp.asarray(np.inf))
    params = params._replace(noise=params.noise._replace(bias=forever))
    state, _ = reset(params, key=jax.random.key(3))
    after, _ = step(params, state, jnp.zeros(6))
    np.testing.assert_array_equal(after.bias, state.bias)
    assert np.abs(state.bias).max() > 0


def test_an_ended_episode_s_measurement_stays(x64, docking):
    _, params, reset, step = docking(fidelity="iss", noise={**NOISE, "bias": BIAS})
    short = params._replace(horizon_steps=jnp.asarray(1, jnp.int32))
    ended, _ = step(short, reset(short, key=jax.random.key(0))[0], jnp.zeros(6))
    again, _ = step(short, ended, jnp.zeros(6))
    np.testing.assert_array_equal(again.measured["state"], ended.measured["state"])


def test_without_a_bias_nothing_is_carried(x64):
    env = DockingEnv(fidelity="iss", noise="cooperative")
    state = jax.eval_shape(lambda key: env.reset(env.default_params(), key=key)[0], jax.random.key(0))
    assert state.bias is None and state.drawn is None
