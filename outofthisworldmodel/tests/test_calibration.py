"""Scores of sampled predictions against closed forms."""

import json
from math import erf, exp, pi, sqrt

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm.baselines.constant_velocity import ConstantVelocity
from owm.catalogue.predictors import write_predictions
from owm.motion.kinematics import displaced
from owm.report.tables import calibration_table, error_table
from owm.scores.calibration import LEVELS, calibration, central_coverage, crps, score_samples
from owm.scores.prediction import prediction_error
from owm_envs.view import VIEW_SIZE, VIEW_SLICES

NORMAL_QUANTILE = {0.5: 0.674490, 0.9: 1.644854, 0.99: 2.575829}


def gaussian_crps(z):
    """CRPS of a standard normal at z. Source: Gneiting et al. (2005), eq. 5."""
    return z * erf(z / sqrt(2)) + 2 * exp(-z * z / 2) / sqrt(2 * pi) - 1 / sqrt(pi)


@pytest.mark.parametrize("count", [2, 5, 40])
def test_crps_is_unbiased_however_few_the_samples(count):
    samples = np.random.default_rng(0).normal(size=(count, 400_000 // count, 3)).astype(np.float32)
    outcome = np.array([0.0, 0.7, -2.0], np.float32)
    score = np.asarray(crps(jnp.asarray(samples), jnp.asarray(outcome)), np.float64).mean(axis=0)
    np.testing.assert_allclose(score, [gaussian_crps(z) for z in outcome], atol=6e-3)


def test_crps_of_samples_without_spread_is_the_absolute_error():
    np.testing.assert_allclose(crps(jnp.full((7, 2), 1.5), jnp.array([0.0, 4.0])), [1.5, 2.5], rtol=1e-6)


@pytest.mark.parametrize(("count", "spread"), [(199, 1.0), (300, 1.0), (1000, 0.5)])
def test_coverage_is_nominal_for_the_right_spread_and_known_for_half_of_it(count, spread):
    rng = np.random.default_rng(1)
    samples = jnp.asarray(spread * rng.normal(size=(count, 4000)), jnp.float32)
    inside = central_coverage(samples, jnp.asarray(rng.normal(size=4000), jnp.float32))
    expected = [erf(spread * NORMAL_QUANTILE[level] / sqrt(2)) for level in LEVELS]
    np.testing.assert_allclose(np.asarray(inside).mean(axis=0), expected, atol=0.025)


def test_coverage_takes_enough_samples():
    samples = jnp.arange(19.0)
    assert central_coverage(samples, jnp.array(18.0), (0.9,)).tolist() == [True]  # nine tenths of 19: all of them
    assert central_coverage(samples, jnp.array(18.1), (0.9,)).tolist() == [False]
    with pytest.raises(ValueError, match=r"need at least 199 samples, got 198"):
        central_coverage(jnp.zeros(198), jnp.zeros(()))


def test_views_are_scored_by_their_errors_whatever_the_sign_of_q():
    sizes = np.repeat([0.5, 0.02, 0.01, 1e-4], 3)
    errors = jnp.asarray(np.random.default_rng(2).normal(size=(400, 199, 12)) * sizes, jnp.float32)
    outcome = jnp.array([20.0, -80.0, 5.0, 0.1, 0.2, 0.0, 0.6, 0.0, 0.8, 0.0, 1e-3, 0.0, 2e-3], jnp.float32)

    other_sign = jnp.ones(VIEW_SIZE, jnp.float32).at[VIEW_SLICES.attitude].set(-1.0)

    def samples(errors):
        return jax.vmap(displaced, (None, 0))(outcome, errors) * other_sign

    score = jax.jit(jax.vmap(lambda e: score_samples(samples(e), outcome)))(errors)
    # The outcome is the mean of the distribution.
    np.testing.assert_allclose(score.crps.mean(axis=0), sizes * gaussian_crps(0.0), rtol=0.03)
    np.testing.assert_allclose(np.sqrt(score.variance.mean(axis=0)), sizes, rtol=0.03)
    np.testing.assert_allclose(score.square_error.mean(axis=0), sizes**2 / 199, rtol=0.25)
    assert np.asarray(score.inside).all(axis=(0, 1)).all()


def test_a_model_without_spread_covers_nothing_and_is_scored_by_its_error(episodes):
    model = ConstantVelocity()
    windows = episodes.windows(model.history_length + 8, 20, seed=1)
    truth = calibration(model, windows, (1, 8), samples=19, levels=(0.5, 0.9))
    seen = calibration(model, windows, (1, 8), samples=19, levels=(0.5, 0.9), outcome="measurement")
    assert truth.coverage.shape == (2, 4, 2) and truth.coverage.max() == 0 and truth.spread.max() < 1e-3
    assert (truth.error[1] > truth.error[0]).all() and (truth.crps > 0).all()
    assert seen.error[0, 0] != truth.error[0, 0]
    assert set(truth.rows()[0]) >= {"horizon", "position_m_coverage_90", "attitude_deg_crps", "rate_degps_spread"}


def test_tables_and_pictures_take_every_group(episodes, tmp_path):
    model = ConstantVelocity()
    windows = episodes.windows(model.history_length + 16, 20, seed=1)
    errors = {"a": [prediction_error(model, windows, (4, 16))], "b": [prediction_error(model, windows, (4, 16))]}
    spreads = {"a": [calibration(model, windows, (4, 16), samples=3, levels=(0.5,))], "b": []}
    table = error_table(errors["a"], (1, 4))
    assert table.rows[0][0] == model.name and len(table.rows[0][2].split(" / ")) == 4
    rows = calibration_table(spreads["a"], (1, 4)).rows
    assert [row[:3] for row in rows[:2]] == [[f"{model.name} (truth)", "position", s] for s in ("1", "4")]
    files = write_predictions(errors, spreads, tmp_path)
    stored = json.loads(files[0].read_text())
    assert [(row["group"], row["horizon"]) for row in stored["error"]] == [("a", 4), ("a", 16), ("b", 4), ("b", 16)]
    assert stored["calibration"][0]["position_m_coverage_50"] == 0.0
    for picture in files[1:]:
        assert picture.read_bytes()[:4] == b"\x89PNG"
