"""Policies beside the planner on a learned model: online least squares and the classical stack."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic

from owm.baselines.online import OnlineLeastSquares
from owm.model.linear import LinearMap

LIMIT = (1600.0,) * 3 + (2000.0,) * 3
NOMINAL = np.diag(0.25 / np.array([12_000.0] * 3 + [80_000.0, 80_000.0, 50_000.0]))


@pytest.fixture(scope="module")
def fit() -> LinearMap:
    """The nominal chaser's map, without orbital terms."""
    return LinearMap(
        *(jnp.asarray(x, jnp.float32) for x in (NOMINAL, np.zeros(6), np.zeros((3, 6)), np.zeros((3, 15))))
    )


def test_online_least_squares_finds_another_chaser_and_forgets_what_it_is_not_shown(fit):
    """A weak, skewed thruster and a bias under cooperative noise; the torques about y are never commanded."""
    learner = OnlineLeastSquares(LIMIT)
    truth = NOMINAL.copy()
    truth[0, 0] *= 0.7
    truth[0, 1] = 0.09 * NOMINAL[1, 1]
    bias = np.array([0, 0, 2e-3, 0, 0, 1e-4])
    rng = np.random.default_rng(0)
    held = np.repeat(rng.uniform(-0.3, 0.3, (60, 6)), 8, axis=0) * LIMIT
    held[:, 4] = 0.0
    views = [np.array([0, -30, 5, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0.0])]
    # In a frame that turns with the body, so that rates do not matter to what is learned of forces.
    step = jax.jit(lambda view, change: jnp.concatenate([view[:3], view[3:6] + change[:3], view[6:10], view[10:]]))
    measure = jax.jit(lambda key, view: synthetic.measure(key, view))
    learn, params = jax.jit(learner.learn), jax.jit(learner.params)
    known = learner.init(fit)
    np.testing.assert_allclose(params(known).action, fit.action, rtol=1e-4)
    keys = jax.random.split(jax.random.key(1), len(held) + 1)
    before = measure(keys[0], jnp.asarray(views[0], jnp.float32))
    view = jnp.asarray(views[0], jnp.float32)
    for key, wrench in zip(keys[1:], held):
        wrench = jnp.asarray(wrench, jnp.float32)
        change = jnp.asarray(truth @ np.asarray(wrench) + bias, jnp.float32)
        view = step(view, change)
        after = measure(key, view)
        known, before = learn(known, before, wrench, after), after
    found = params(known)
    error = np.abs(np.asarray(found.action)[:3, :3] - truth[:3, :3]) / NOMINAL[0, 0]
    assert error.max() < 0.03
    assert abs(float(found.bias[2]) - 2e-3) < 2e-4
    assert abs(float(found.action[4, 4]) / NOMINAL[4, 4] - 1) < 1e-3
