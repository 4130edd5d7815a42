"""Flights whose relative navigation goes quiet."""

import numpy as np
import pytest
from free_body import NO_BIAS, STARTS, make, move, observe

from owm.catalogue.policies import load_policy
from owm.commands.run import fly
from owm.scores.docking import evaluation_config, fly_episodes, trials
from owm.scores.flights import succeeded
from owm.scores.outages import Outages
from owm.study.conditions import CONDITIONS
from owm_envs.task.sensors import STATE, STATE_VALID


@pytest.mark.parametrize("duration", [1.0, 10.0, 30.0])
def test_outages_last_as_long_and_as_often_as_said(duration):
    outages = Outages(duration, share=0.3)
    seen = np.stack([outages.measured(seed, 14_400, 0.25) for seed in range(20)])
    assert seen[:, 0].all(), "the first measurement always comes"
    assert 1 - seen.mean() == pytest.approx(0.3, abs=0.06)
    edges = np.diff(seen[0].astype(int))
    begun, over = np.flatnonzero(edges == -1), np.flatnonzero(edges == 1)
    lengths = 0.25 * (over - begun[: len(over)])
    assert np.median(lengths) == pytest.approx(duration, abs=0.26) and lengths.min() > duration - 0.26
    np.testing.assert_array_equal(seen[3], outages.measured(3, 14_400, 0.25))
    assert (seen[3] != seen[4]).any()


@pytest.mark.parametrize("outages", [Outages(0.0), Outages(-1.0), Outages(1.0, 0.0), Outages(1.0, 1.0)])
def test_outages_without_end_or_length_are_refused(outages):
    with pytest.raises(ValueError, match="outages need a positive duration"):
        outages.measured(0, 10, 0.25)


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
@pytest.mark.parametrize("policy", ["dock-geodesic", "ekf-mpc"])
def test_flights_with_outages_of_ten_seconds_dock(policy):
    config = evaluation_config(fidelity="iss-hcw")
    seeds, ports = trials(["zvezda_aft", "pirs_nadir"], per_port=1, seed=5)
    flown = fly_episodes(load_policy(policy, config, 2), config, seeds, ports, outages=Outages(10.0))
    assert succeeded(flown, 0.1, full=True).all() and not flown.collided.any()


@pytest.mark.parametrize("name", ["noncooperative", "near", "map shifted", "heavy, noncooperative"])
def test_a_condition_of_which_a_single_flight_would_heed_a_part_is_refused(name, tmp_path):
    with pytest.raises(ValueError, match="not for one flight"):
        fly("dock", "zvezda_aft", condition=name, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_condition_tells_policies_of_outages_and_keeps_the_environment():
    quiet, nominal = CONDITIONS["outages of 10 s"], CONDITIONS["nominal"]
    assert quiet.outages == Outages(10.0) and nominal.outages is None
    assert quiet.flown() == nominal.flown()
