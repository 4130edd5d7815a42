"""The error-state filter: consistent, better than its measurements, and right about how sure it is ahead."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm.baselines.ekf import ErrorStateEKF
from owm.interface import History
from owm.motion.kinematics import displaced, view_error
from owm.scores.calibration import sample_views
from owm_envs.task.navigation import measure
from owm_envs.view import View

RUNS, STEPS = 64, 40
PROCESS_NOISE = (2e-3, 2e-4, 2e-5, 5e-6)
VIEW = np.array([60.0, -90.0, 40.0, 0.4, -0.2, 0.3, 0.5, -0.5, 0.1, 0.7, 0.01, -0.02, 0.015], np.float32)
ALL = np.ones(8, bool)


@pytest.fixture(scope="module")
def ekf():
    return ErrorStateEKF(process_noise=PROCESS_NOISE)


@pytest.fixture(scope="module")
def flown(ekf):
    """Truths that move as the filter takes them to, and the filter on their measurements: `RUNS` times `STEPS`."""
    spread = np.repeat(np.array([30.0, 0.5, 1.0, 0.02], np.float32), 3)
    added = np.repeat(np.array(PROCESS_NOISE, np.float32), 3)
    limit = np.array([1600.0] * 3 + [2000.0] * 3, np.float32)

    def normalized(error, covariance):
        return error @ jnp.linalg.solve(covariance, error)

    def run(key):
        k_start, k_action, k_added, k_noise = jax.random.split(key, 4)
        start = displaced(ekf.init(ekf.params, VIEW).view, spread * jax.random.normal(k_start, (12,), jnp.float32))
        actions = limit * jax.random.uniform(k_action, (STEPS, 6), jnp.float32, -1.0, 1.0)
        errors = added * jax.random.normal(k_added, (STEPS, 12), jnp.float32)
        keys = jax.random.split(k_noise, STEPS + 1)

        def advance(carry, step):
            state, belief = carry
            action, error, key = step
            state = ekf.process.step(ekf.params.process, None, action, state)
            truth = displaced(ekf.process.decode(ekf.params.process, state)["state"], error)
            seen = measure(ekf.params.noise, View.of(truth), key=key)
            ahead = ekf.predict(ekf.params, belief, action)
            surprise = normalized(*ekf.innovation(ekf.params, ahead, seen))
            belief = ekf.update(ekf.params, ahead, seen)
            off = view_error(truth, belief.view)
            scores = normalized(off, belief.covariance), surprise, off, view_error(seen, truth)
            return (ekf.process.start(ekf.params.process, state.epoch, truth), belief), (seen, belief, scores)

        first = measure(ekf.params.noise, View.of(start), key=keys[-1])
        carry = ekf.process.start(ekf.params.process, jnp.zeros(2, jnp.float32), start), ekf.init(ekf.params, first)
        seen, beliefs, scores = jax.lax.scan(advance, carry, (actions, errors, keys[:-1]))[1]
        return jnp.concatenate([first[None], seen]), actions, beliefs, scores

    keys = jax.random.split(jax.random.key(3), RUNS)
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(keys))


@pytest.mark.slow
def test_errors_and_innovations_are_as_large_as_the_filter_says(flown):
    """The normalised squares have mean 12. Source: Bar-Shalom, Li and Kirubarajan (2001), sec. 5.4."""
    square, surprise, error, measured = flown[3]
    assert abs(square.mean() - 12.0) < 0.7
    assert abs(surprise.mean() - 12.0) < 0.4
    sizes = [np.sqrt(np.mean(np.square(e[:, 20:].reshape(RUNS, -1, 4, 3)), axis=(0, 1, 3))) for e in (error, measured)]
    assert (sizes[0] < sizes[1] * [0.35, 0.8, 0.9, 0.9]).all()


@pytest.mark.slow
def test_a_history_is_filtered_from_its_first_real_measurement(ekf, flown):
    seen, actions, beliefs, _ = jax.tree.map(lambda x: x[0], flown)
    encode = jax.jit(ekf.encode)
    whole = encode(ekf.params, History({"state": seen[:8]}, actions[:7], ALL))
    np.testing.assert_allclose(whole.view, beliefs.view[6], atol=1e-4)
    np.testing.assert_allclose(whole.covariance, beliefs.covariance[6], rtol=0.02, atol=1e-7)
    late = np.arange(8) >= 4
    views = np.concatenate([np.broadcast_to(seen[4], (4, 13)), seen[4:8]])
    half = encode(ekf.params, History({"state": views}, actions[:7], late))
    wild = np.where(late[:-1, None], actions[:7], 1e3).astype(np.float32)
    other = encode(ekf.params, History({"state": views}, wild, late))
    np.testing.assert_array_equal(half.view, other.view)
    ratio = np.diag(half.covariance) / np.diag(whole.covariance)
    assert 1.4 < ratio[0] < 2.0  # four measurements for eight


@pytest.mark.slow
def test_samples_spread_as_coasting_does(ekf):
    """Position takes over the errors of velocity: its variance grows as the square of time, noise added apart."""
    steps, dt = 16, ekf.dt
    history = History({"state": np.tile(VIEW, (8, 1))}, np.zeros((7, 6), np.float32), np.arange(8) == 7)
    draw = jax.jit(lambda key: sample_views(ekf, ekf.params, key, history, jnp.zeros((steps, 6), jnp.float32), 1500))
    drawn = np.asarray(draw(jax.random.key(0)))
    position, velocity, _, _ = np.array([0.05, 0.002, 0.0, 0.0]) / 3**0.5
    left = dt * np.arange(steps)
    grown = (position**2 + (steps * dt * velocity) ** 2) + np.sum(
        PROCESS_NOISE[0] ** 2 + (left * PROCESS_NOISE[1]) ** 2
    )
    np.testing.assert_allclose(drawn[:, -1, :3].std(axis=0), grown**0.5, rtol=0.08)
    np.testing.assert_allclose(
        drawn[:, -1, 3:6].std(axis=0), (velocity**2 + steps * PROCESS_NOISE[1] ** 2) ** 0.5, rtol=0.08
    )


def test_noise_grows_with_range_and_float64_is_asked_for():
    ekf = ErrorStateEKF({"noise": "noncooperative"})
    views = np.stack([VIEW, VIEW * np.where(np.arange(13) < 3, 2.0, 1.0).astype(np.float32)])
    beliefs = jax.jit(jax.vmap(lambda view: ekf.init(ekf.params, view)))(views)
    near, far = np.sqrt(np.diagonal(beliefs.covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(near[0], 0.01 * np.linalg.norm(View.of(VIEW).position) / 3**0.5, rtol=1e-5)
    np.testing.assert_allclose(far / near, [2.0] * 3 + [1.0] * 9, rtol=1e-5)
    numerical = ErrorStateEKF(fidelity="iss-numerical")
    with pytest.raises(RuntimeError, match="64-bit"):
        numerical.init(numerical.params, VIEW)
