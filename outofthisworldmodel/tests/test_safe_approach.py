"""Flights that an operator would accept: coasts that clear the hull, ways out, contact at the standard's rates."""

import numpy as np
import pytest

from owm.catalogue.policies import load_policy
from owm.report.safety import coast_figure, front_figure
from owm.scores.coasting import add_coasts, coasts_of, impulse_clears
from owm.scores.docking import evaluation_config, fly_episodes, trials
from owm.scores.flights import (
    Flights,
    avoidable_share,
    far_safe_share,
    safe_share,
    score,
    succeeded,
    within_contact_limits,
)
from owm.study.matrix import planner_of
from owm_envs.config import load_config
from owm_envs.field import load_field
from owm_envs.policies import VectorPolicy, make_policy

N = 1.127e-3  # rad/s


@pytest.fixture(scope="module")
def flown(quick_drifts) -> Flights:
    config = evaluation_config(fidelity="iss-hcw")
    seeds, ports = trials(per_port=1, seed=77)
    flights = fly_episodes(VectorPolicy(make_policy("dock-safe", config)), config, seeds, ports)
    return add_coasts(flights, load_field())


@pytest.mark.slow
def test_it_docks_at_the_standards_rates_at_every_port(flown):
    assert succeeded(flown, 0.1, full=True).all()
    assert within_contact_limits(flown).all()
    assert flown.time.max() < 300.0


@pytest.mark.slow
def test_beyond_ten_metres_a_coast_clears_the_hull_and_nearer_an_impulse_does(flown):
    assert flown.instants_far.sum() > 300
    assert far_safe_share(flown) > 0.98
    assert avoidable_share(flown) > 0.95
    assert 0.6 < safe_share(flown) < far_safe_share(flown), "who closes in near the hull does drift into it"
    assert score(flown)["far_safe_share"] == far_safe_share(flown)


@pytest.mark.slow
def test_a_model_flies_it_too():
    """With a quarter of the candidates. Twenty seconds: two whole flights, replanned every 2 s."""
    config = evaluation_config(fidelity="iss-hcw")
    seeds, ports = trials(["harmony_forward", "unity_nadir"], per_port=1, seed=77)
    planner = planner_of("safe").model_copy(update={"candidates": 32})
    policy = load_policy("pretrained", config, len(seeds), planner=planner)
    flown = add_coasts(fly_episodes(policy, config, seeds, ports), load_field())
    assert succeeded(flown, 0.1, full=True).all()
    assert flown.closest_closing.max() < 0.10
    assert far_safe_share(flown) > 0.97
    assert avoidable_share(flown) > 0.9
    assert flown.time.max() < 300.0


@pytest.mark.slow
def test_who_cannot_turn_leaves():
    """Without torque about the nose, two minutes of it: found out in the first, and from then on it goes away."""
    config = evaluation_config(fidelity="iss-hcw", horizon=120.0)
    flown_in = load_config(config, chaser={"fault": {"thrust_scale": (1, 1, 1, 1, 1, 0)}})
    seeds, ports = trials(["harmony_forward"], per_port=1, seed=77)
    planner = planner_of("safe").model_copy(update={"candidates": 32})
    policy = load_policy("guarded:pretrained", config, len(seeds), planner=planner)
    flown = fly_episodes(policy, flown_in, seeds, ports)
    away = np.linalg.norm(flown.trajectory[0, :, :3], axis=1)
    assert policy.verdict == ["leaves"] and policy.health.share[0, 5].max() < 0.45
    assert not flown.collided.any() and (np.diff(away[-160:]) > 0).all()


@pytest.mark.slow
def test_pictures_show_what_safety_costs(flown):
    coasts = coasts_of(flown, load_field())
    assert coasts.clear.sum() == flown.instants_safe.sum()
    assert not coasts.avoidable[coasts.far].any()
    shares, *views = coast_figure({"dock-safe": coasts}).axes
    assert [line.get_label() for line in shares.lines] == ["dock-safe"]
    near, *_, far = shares.lines[0].get_ydata()
    assert near < 20 and far == 100
    lost = len(coasts.states) - coasts.avoidable.sum() - (coasts.far & coasts.clear).sum()
    assert all(len(axes.collections[-1].get_offsets()) == lost for axes in views)
    row = {"far": 0.997, "contact": 1.0, "time": 150.0, "delta_v": 11.0}
    time, fuel = front_figure({"a": row, "b": row | {"contact": 0.0, "time": 100.0}}).axes
    assert [*time.collections[1].get_offsets()[0]] == [100.0, 99.7]
    assert fuel.get_legend() is not None


@pytest.mark.slow
def test_flights_of_before_have_no_such_shares(flown):
    values = {name: getattr(flown, name) for name in Flights.__dataclass_fields__}
    older = Flights(**values | dict.fromkeys(("instants_far", "instants_far_safe", "instants_avoidable")))
    assert far_safe_share(older) is avoidable_share(older) is None
    assert older.rows()[0]["instants_far"] == ""


def test_two_of_six_impulses_must_lead_away():
    below = [0.23, 0.17, -60.0]
    states = np.array(
        [
            [*below, 0, 0, 0.1],  # slow, far below: whatever is pushed aside clears
            [*below, 0, 0, 3.0],  # too fast for any impulse of 1 m/s
            [0.19, -24.5, -3.34, 0, 0.078, 0],  # at contact
        ],
        np.float32,
    )
    assert impulse_clears(load_field(), states, N).tolist() == [True, False, True]
