"""Flights whose relative navigation goes quiet, or has outliers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_body import NO_BIAS, STARTS, make, move, observe

from owm.baselines.classical import GATE
from owm.baselines.ekf import ErrorStateEKF
from owm.catalogue.policies import load_policy
from owm.commands.run import fly
from owm.data.windows import from_episodes
from owm.motion.kinematics import view_error
from owm.scores.docking import evaluation_config, fly_episodes, trials
from owm.scores.flights import succeeded
from owm.study.conditions import CONDITIONS
from owm_envs import datasets
from owm_envs.config import load_config
from owm_envs.task.sensors import STATE, STATE_VALID


def test_a_planner_that_is_blind_goes_by_its_model():
    """The free body is predicted as it flies: whoever sees all of it plans the same."""
    blind, seeing = make(), make()
    views = STARTS
    for decision in range(24):
        shown = {STATE: observe(blind.layout, views), STATE_VALID: np.ones((2, 1), bool)}
        if decision % 8 in (5, 6, 7):
            shown = {STATE: np.zeros_like(shown[STATE]), STATE_VALID: np.zeros((2, 1), bool)}
        wrench = blind.predict(shown)[0]
        np.testing.assert_allclose(wrench, seeing.predict(observe(seeing.layout, views))[0], rtol=1e-3, atol=2.0)
        views = np.stack([move(NO_BIAS, view[None], push[None])[0] for view, push in zip(views, wrench, strict=True)])


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["dock-geodesic", "ekf-mpc-gated"])
def test_flights_with_outages_of_ten_seconds_and_outliers_dock(policy):
    told = evaluation_config(fidelity="iss-hcw")
    spoiled = CONDITIONS["outages of 10 s"].hidden["navigation"] | CONDITIONS["outliers"].hidden["navigation"]
    seeds, ports = trials(["zvezda_aft", "pirs_nadir"], per_port=1, seed=5)
    flown = fly_episodes(load_policy(policy, told, 2), load_config(told, navigation=spoiled), seeds, ports)
    assert succeeded(flown, 0.1, full=True).all() and not flown.collided.any()


@pytest.mark.slow
def test_a_flight_in_the_dark_is_recorded_as_it_was_seen(tmp_path):
    flown = fly("dock", "zvezda_aft", fidelity="iss-hcw", condition="outages of 10 s, half", out=tmp_path / "out")
    (episode,) = datasets.read(tmp_path / "out" / "episodes")
    valid = episode.observation[STATE_VALID][:, 0]
    assert len(valid) == len(episode) + 1 and flown.time[0] == pytest.approx(0.25 * len(episode))
    assert valid[0] and 0.2 < np.mean(~valid) < 0.8
    np.testing.assert_array_equal((np.diff(episode.observation[STATE], axis=0) == 0).all(axis=1), ~valid[1:])


@pytest.mark.parametrize("name", ["noncooperative", "near", "map shifted", "heavy, noncooperative"])
def test_a_condition_of_which_a_single_flight_would_heed_a_part_is_refused(name, tmp_path):
    with pytest.raises(ValueError, match="not for one flight"):
        fly("dock", "zvezda_aft", condition=name, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_conditions_say_how_long_and_how_often():
    quiet = {name: each.flown().navigation for name, each in CONDITIONS.items() if each.flown().structure.quiet}
    assert [(each.outage_duration, each.outage_share) for each in quiet.values()] == [
        *((seconds, 0.3) for seconds in (1, 5, 10, 30)), (10, 0.1), (10, 0.5)
    ]  # fmt: skip
    outliers = CONDITIONS["outliers"].flown()
    assert outliers.structure.heavy_tailed and not outliers.structure.quiet
    assert outliers.navigation.outlier_share == 0.05 and outliers.navigation.outlier_scale == 20


class Flight:
    def __init__(self, valid):
        rows = len(valid)
        self.observation = {STATE: np.zeros((rows, 13)), STATE_VALID: valid[:, None]}
        self.observation[STATE][:, 0], self.observation[STATE][:, 6] = np.arange(rows), 1
        self.action, self.stride = np.arange(6.0 * rows - 6).reshape(-1, 6), 1


def test_windows_to_learn_from_hold_no_number_twice():
    valid = np.ones(40, bool)
    valid[[5, 6, 7, 9, 39]] = False
    data = from_episodes([Flight(valid)])
    assert data.view[:, 0].tolist() == [*range(5), *range(10, 39)] and set(data.observation) == {STATE}
    assert np.bincount(data.track).tolist() == [5, 29]
    np.testing.assert_array_equal(data.action[7], Flight(valid).action[12])
    assert set(np.diff(np.asarray(data.windows(4).observation[STATE][:, :, 0]), axis=1).ravel()) == {1.0}


def test_a_gated_filter_bears_outliers():
    """A body at rest in the filter's own dynamics: the error under outliers, against those without and ungated."""
    config = load_config(noise="cooperative", fidelity="iss-hcw")
    rng, steps = np.random.default_rng(3), 400
    open_, gated = ErrorStateEKF(config), ErrorStateEKF(config, gate=GATE)
    params = open_.params
    size = np.repeat(np.array([params.noise.position, params.noise.velocity, params.noise.attitude]), 3) / np.sqrt(3)
    errors = rng.normal(size=(steps, 9)) * size
    outliers = np.where(rng.uniform(size=(steps, 1)) < 0.05, 20.0, 1.0)
    outliers[0] = 1.0

    @jax.jit
    def track(params, errors):
        start = jnp.zeros(13).at[0].set(80.0).at[6].set(1.0)

        def shown(truth, error):
            measured = truth.at[:6].add(error[:6])
            attitude = measured[6:10] + 0.5 * jnp.concatenate([jnp.zeros(1), error[6:]])  # small, and no turn yet
            return measured.at[6:10].set(attitude / jnp.linalg.norm(attitude))

        def advance(carry, error):
            belief, truth = carry
            truth = open_._propagate(params, truth, jnp.zeros(6))
            belief = open_.update(params, open_.predict(params, belief, jnp.zeros(6)), shown(truth, error))
            return (belief, truth), view_error(truth, belief.view)

        return jax.lax.scan(advance, (open_.init(params, shown(start, errors[0])), start), errors[1:])[1]

    def rms(params, errors):
        return np.sqrt(np.mean(np.square(track(params, np.float32(errors))[100:, :3])))

    sound = rms(params, errors)
    assert rms(gated.params, errors) == pytest.approx(sound, rel=0.05), "it leaves sound measurements alone"
    assert rms(gated.params, errors * outliers) < 1.5 * sound < 0.6 * rms(params, errors * outliers)
