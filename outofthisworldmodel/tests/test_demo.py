from dataclasses import replace

import numpy as np
import pytest

from owm.commands.demo import SCALES, check
from owm.commands.demo_report import Results, _marks, _summary, write_demo_report
from owm.scores.flights import Flights
from owm.scores.prediction import PredictionError

HORIZONS = tuple(range(1, 65))


def prediction(name, scale):
    error = np.linspace(0.1, 3.0, 64)[None, :, None] * scale * np.ones((5, 1, 4))
    error[:, :3] = 0.05  # below a second noise hides the difference
    return PredictionError(name, HORIZONS, 0.25, error)


def flights(policy, missed=()):
    count, zeros = 8, np.zeros(8)
    distance = np.where(np.isin(np.arange(count), missed), 30.0, 0.09)
    track = np.full((count, 21, 13), np.nan)
    track[:, :11] = np.linspace(120, 20, 11)[None, :, None]
    return Flights(
        policy=policy,
        port=np.arange(count, dtype=np.int32),
        seed=np.arange(count) + 7,
        digest=np.array([str(i) for i in range(count)]),
        outcome=np.where(distance < 1, "docked", "timeout"),
        collided=np.arange(count) == 3,
        closest_distance=distance,
        closest_speed=zeros + 0.1,
        closest_attitude=zeros,
        closest_rate=zeros,
        closest_time=zeros,
        closest_axial=distance,
        closest_lateral=zeros,
        closest_closing=zeros + 0.1,
        closest_lateral_speed=zeros,
        clearance=zeros + 1,
        time=zeros + 100.0,
        delta_v=zeros + 2,
        angular_impulse=zeros,
        decision_seconds=0.01,
        decision_dt=0.25,
        bounds=(0.5, 0.1, 0.01),
        trajectory=track,
    )


def results(folder, rows):
    predictions = {"held-out": [prediction("world model", 0.5), prediction("constant velocity", 1.0)]}
    counts = {"transitions": 1000, "episodes": 3, "policies": {"dock": 3}, "outcomes": {"docked": 3}}
    return Results(
        scale="ci",
        folder=folder,
        seed=3,
        size=SCALES["ci"],
        corpus={"train": counts},
        training={"parameters": 12, "best_step": 0, "steps": 9, "episodes": 3, "val_episodes": 2},
        metrics=[
            {"step": 0, "score": 2.0, "behaviour/position_m": 1.0, "behaviour/attitude_deg": 1.0},
            {"step": 50, "rollout": 16, "flow_loss": 0.5, "decode_loss": 0.1},
            {
                "step": 100,
                "rollout": 32,
                "flow_loss": 0.4,
                "decode_loss": 0.1,
                "score": 1,
                "behaviour/position_m": 1,
                "behaviour/attitude_deg": 1,
            },
        ],
        predictions=predictions,
        flights=rows,
        starts=rows[0].starts_digest,
        checks=check(predictions, rows[0]),
        seconds={"corpus": 12.0, "training": 30.0},
        resumed=["corpus"],
        peak_memory=1.5e9,
    )


@pytest.mark.parametrize(
    "scale, missed, expected",
    [
        (0.5, (), [True, True]),
        (1.0, (), [False, True]),
        (0.5, (0, 1, 2, 4), [True, False]),
        (0.5, (0, 1, 2), [True, True]),
    ],
)
def test_the_promises_are_checked(scale, missed, expected):
    groups = {
        "a": [prediction("world model", 0.1), prediction("constant velocity", 1.0)],
        "b": [prediction("world model", scale), prediction("constant velocity", 1.0)],
    }
    assert list(check(groups, flights("world model", missed)).values()) == expected


@pytest.mark.parametrize("quantity", range(4))
def test_one_quantity_predicted_worse_at_one_horizon_breaks_the_promise(quantity):
    model, floor = prediction("world model", 0.1), prediction("constant velocity", 1.0)
    model.error[:, 40, quantity] = 10.0
    assert list(check({"a": [model, floor]}, flights("world model")).values()) == [False, True]


def test_the_claim_for_the_network_is_made_where_it_earns_it(tmp_path):
    rows = [flights("world model"), flights("least-squares"), flights("dock-geodesic", (5,))]
    assert "the map of the hull, not the network" not in _summary(results(tmp_path, rows))[0]


def test_steps_at_which_training_becomes_harder_are_marked(tmp_path):
    marks = _marks(results(tmp_path, [flights("world model")]))
    assert marks == {"rollouts of 32 steps": 100, "teacher forcing ends": 100.0}


def test_the_report_leads_to_the_replay(tmp_path):
    told = replace(results(tmp_path, [flights("world model"), flights("dock")]), replay=tmp_path / "replay.html")
    markdown, page = (path.read_text(encoding="utf-8") for path in write_demo_report(told))
    assert "[See one of them](replay.html)" in markdown and '<a href="replay.html">' in page


@pytest.mark.slow
def test_the_report_tells_what_was_given_what_failed_and_how_it_was_run(tmp_path):
    rows = [flights("world model", (5,)), flights("least-squares"), flights("dock", range(8))]
    rows.append(flights("dock-geodesic"))
    markdown, page = (path.read_text(encoding="utf-8") for path in write_demo_report(results(tmp_path, rows)))
    assert "**6 of 8 flights**" in markdown and "the map of the hull, not the network" in markdown
    failed = [line for line in markdown.splitlines() if line.startswith("| world model | ")]
    assert any("zvezda_aft | 10 | docked, after a collision" in line for line in failed)
    assert any("pirs_nadir | 12 | timeout | 30.00" in line for line in failed)
    assert "No trained weights scored better" in markdown and "Not a promise at this scale" in markdown
    for told in ("hull map", "geodesic field", "53 %", "H100", "1.50 GB", "earlier run", "owm train"):
        assert told in markdown, told
    assert "--out RUN --preset ci --seed 3" in markdown and "--seed 4 --out DATA2" in markdown
    assert "safe coasts" not in markdown and "Safe coasts" not in markdown, "nobody looked"
    assert "bias corrector" in markdown and "Held out from training only" in markdown
    pictures = len(list((tmp_path / "figures").glob("*.png")))
    assert pictures == 3 + len(rows) and page.count("data:image/png") == pictures
