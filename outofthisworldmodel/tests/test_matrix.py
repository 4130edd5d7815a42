import json
import shutil
from dataclasses import replace
from pathlib import Path

import mortal
import numpy as np
import pytest

from owm.report.plots import hull_distance
from owm.report.tables import docking_table, pairs_table
from owm.scores.coasting import COAST, coasts_clear, transitions
from owm.scores.statistics import Pairs
from owm.study import workers as matrix_workers
from owm.study.conditions import CONDITIONS, Condition, condition
from owm.study.matrix import Matrix, Study, read_matrix, row_name, rows_of
from owm.study.report import given_of, rows_flown, write_matrix_report
from owm.study.run import Pace, Store, run_matrix
from owm_envs.claims import Claim
from owm_envs.field import load_field
from owm_envs.files import FolderTaken
from owm_envs.station import hull_boxes

TABLE = """
flights = 20
ports = ["zvezda_aft"]
[policies]
exact = "oracle-mppi"
PD = "dock"
[[studies]]
title = "first"
policies = ["exact", "PD"]
planners = ["geodesic", "plain, no corrector"]
fewer = { "exact, plain, no corrector" = 4 }
against = ["PD"]
[[studies]]
title = "off-nominal"
policies = ["PD"]
conditions = ["nominal", "heavy"]
flights = 5
"""


@pytest.fixture
def table(tmp_path):
    (tmp_path / "table.toml").write_text(TABLE)
    return read_matrix(tmp_path / "table.toml")


def test_rows_are_policies_times_planners_times_conditions_each_once(table):
    rows = {row_name(*row.key): row.flights for row in rows_of(table)}
    assert rows == {"exact": 20, "exact, plain, no corrector": 4, "PD": 20, "PD, heavy": 5}
    assert len({row.folder for row in rows_of(table)}) == 4
    seeds = table.model_copy(update={"policies": {"exact": ("oracle-mppi", "oracle-mppi"), "PD": "dock"}})
    assert [row.copy for row in rows_of(seeds)] == [0, 1, 0, 1, 0, 0]
    studies = tuple(study.model_copy(update={"seeds": 1}) for study in seeds.studies)
    assert [row.copy for row in rows_of(seeds.model_copy(update={"studies": studies}))] == [0, 0, 0, 0]


def test_what_a_row_was_given_leaves_out_what_its_planner_does(table):
    assert "field" in given_of(table, ("exact", "geodesic", "nominal")).hull
    plain = given_of(table, ("exact", "plain, no corrector", "nominal"))
    assert plain.hull == "clearance only, no field" and plain.feedback == "no"


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('"exact", "PD"]\nplanners', '"exat", "PD"]\nplanners', "exat"),
        ('"plain, no corrector"]', '"plane"]', "plane"),
        ('"zvezda_aft"', '"zvezda"', "zvezda_aft"),
        ("flights = 5", "flight = 5", "flight"),
    ],
)
def test_mistakes_in_a_table_are_named(tmp_path, old, new, message):
    assert old in TABLE
    (tmp_path / "t.toml").write_text(TABLE.replace(old, new))
    with pytest.raises(ValueError, match=message):
        read_matrix(tmp_path / "t.toml")


def test_conditions_change_what_is_flown_and_not_what_is_told():
    nominal = condition("nominal")
    off_nominal = [each for each in CONDITIONS.values() if each.hidden]
    wrong_maps = [each for each in CONDITIONS.values() if each.map]
    assert len(off_nominal) == 39 and len(wrong_maps) == 3
    for each in off_nominal:
        assert each.told() in (nominal.told(), condition("noncooperative").told()) and each.flown() != each.told()
    assert condition("heavy").flown().chaser.mass == 15_000 and condition("light").flown().chaser.mass == 9_000
    assert condition("delay").flown().structure.longest_delay == 5 and condition("on-off").flown().structure.on_off
    assert condition("biased").flown().structure.biased and condition("biased").flown().noise.position == 0.05
    assert condition("noncooperative").told() == condition("noncooperative").flown() != nominal.told()
    for each in wrong_maps:
        assert each.flown() == nominal.flown() and each.map_boxes() is not None
    with pytest.raises(ValueError, match="heavy"):
        condition("heavi")


def test_wrong_maps_are_wrong_by_what_they_say():
    boxes = hull_boxes()
    np.testing.assert_allclose(np.linalg.norm(condition("map shifted").map_boxes() - boxes, axis=-1), 0.3)
    turned = condition("map turned").map_boxes()
    volume = np.prod(turned[:, 1] - turned[:, 0], axis=1).sum()
    assert volume == pytest.approx(np.prod(boxes[:, 1] - boxes[:, 0], axis=1).sum())
    # The farthest corner moves by its distance from the axis times a degree.
    arm = boxes[np.argmax(boxes[:, 1, 0]), 1]
    off_axis = np.linalg.norm(arm - arm.sum() / 3)
    moved = np.min(np.linalg.norm(turned[:, 1] - arm, axis=1))
    assert moved == pytest.approx(np.radians(1.0) * off_axis, rel=0.1)
    gone = {tuple(b.ravel()) for b in boxes} - {tuple(b.ravel()) for b in condition("map without array").map_boxes()}
    assert 30 < len(gone) < 60 and min(b[0] for b in gone) > 25 and min(b[5] for b in gone) > 6


def test_a_coast_called_clear_is_clear_of_the_boxes(quick_fields):
    rng = np.random.default_rng(0)
    place = rng.normal(size=(150, 3))
    place *= rng.uniform(20, 60, (150, 1)) / np.linalg.norm(place, axis=1, keepdims=True)
    speed = rng.uniform(0, 0.6, (150, 1))
    states = np.concatenate([place, rng.normal(size=(150, 3)) * speed / 3**0.5], axis=1).astype(np.float32)
    n = 1.127e-3
    clear = coasts_clear(load_field(), states, n)
    paths = np.einsum("tij,nj->nti", transitions(n), states)
    least = hull_distance(paths, 2.25).min(axis=1)
    assert 40 < clear.sum() < 130
    assert (least[clear] > 0).all() and clear[least > 1.0].all()
    # Nothing moves about a point of the orbit; a metre ahead and at rest stays there.
    still = transitions(n) @ np.array([0.0, -50, 0, 0, 0, 0])
    np.testing.assert_allclose(still, np.tile([0.0, -50, 0], (int(COAST) + 1, 1)), atol=1e-4)


# Ten seconds of a simple world: enough to see what is flown when, too little to dock.
SIMPLE = Condition("simple", fidelity="iss", hidden={"precision": "float32", "horizon": 10.0})


STUDY = Study(title="Simple", policies=("PD", "drift"), against=("PD",), figures=True, trajectories=("PD",))
SMALL = Matrix(
    flights=2, ports=("zvezda_aft", "unity_nadir"), policies={"PD": "dock", "drift": "random"}, studies=(STUDY,)
)
"""Two policies to two ports, in one study."""


class Killed(Exception):
    pass


@pytest.mark.slow
def test_a_killed_run_goes_on_and_other_settings_are_refused(tmp_path):
    matrix, (study,), simple = SMALL, SMALL.studies, SIMPLE
    seen = []

    def kill(done, total, what, how_far):
        seen.append(what)
        if "unity_nadir" in what:
            raise Killed

    with pytest.raises(Killed):
        run_matrix(matrix, tmp_path, conditions={"nominal": simple}, report=kill)
    first = tmp_path / "flights" / "PD" / "own" / "nominal" / "zvezda_aft.npz"
    kept = first.read_bytes()
    seen.clear()
    flown = run_matrix(matrix, tmp_path, conditions={"nominal": simple}, report=lambda *now: seen.append(now[2]))
    assert not any("PD to zvezda_aft" in what for what in seen) and any("PD to unity_nadir" in what for what in seen)
    assert first.read_bytes() == kept
    pd, drift = flown["PD", None, "nominal"][0], flown["drift", None, "nominal"][0]
    assert len(pd) == 4 and pd.digest.tolist() == drift.digest.tolist() and (pd.instants == 5).all()

    with pytest.raises(ValueError, match=r"differs in settings.flights.*--fresh"):
        run_matrix(matrix.model_copy(update={"flights": 3}), tmp_path, conditions={"nominal": simple})
    heavy = Condition("heavy", fidelity="iss", hidden={**simple.hidden, "chaser": {"mass": 15_000.0}})
    with pytest.raises(ValueError, match=r"differs in settings.environment.chaser.mass"):
        run_matrix(matrix, tmp_path, conditions={"nominal": heavy})

    # Flights are added to, and never left out of a report in silence.
    fewer_ports = matrix.model_copy(update={"ports": ("unity_nadir",)})
    with pytest.raises(FolderTaken, match=r"not asked for now \(PD/own/nominal/zvezda_aft\): choose another folder"):
        run_matrix(fewer_ports, tmp_path, conditions={"nominal": simple})
    with pytest.raises(FolderTaken, match=r"differs in command: choose another folder"):
        run_matrix(matrix, tmp_path, conditions={"nominal": simple}, command="owm fly")
    assert first.read_bytes() == kept

    # A study that wants fewer flights than were flown shows the first of each port.
    fewer = matrix.model_copy(update={"studies": (study.model_copy(update={"flights": 1, "figures": False}),)})
    text = write_matrix_report(fewer, flown, tmp_path, conditions={"nominal": simple})[0].read_text(encoding="utf-8")
    assert "| PD | 2 | 0 %" in text and "Left out: 1 comparisons" in text
    # A trained seed of which more was flown shows as much as the others.
    both = {("PD", None, "nominal"): [pd, rows_flown(fewer, fewer.studies[0], flown)["PD", None, "nominal"][0]]}
    assert [len(each) for each in both["PD", None, "nominal"]] == [4, 2]
    (shown,) = rows_flown(fewer, fewer.studies[0], both).values()
    assert docking_table([shown]).rows[0][1] == "2 × 2"

    files = write_matrix_report(matrix, flown, tmp_path, conditions={"nominal": simple}, commands="owm ...")
    text = files[0].read_text(encoding="utf-8")
    assert "| PD | 4 | 0 % [0, 49] |" in text and "(figures/ports_Simple.png)" in text
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["pairs"][0]["both"] == 0 and len(results["rows"]) == 2
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 1 + 2 * 5
    assert str(tmp_path) not in text and str(Path.home()) not in text


@pytest.mark.slow
def test_processes_fly_the_same_as_one_and_one_that_dies_is_told_of(whole, tmp_path, monkeypatch):
    said, conditions = [], {"nominal": SIMPLE}
    with monkeypatch.context() as patch:
        patch.setattr(matrix_workers, "_fly", mortal.fly_one_port_and_die)
        with pytest.raises(RuntimeError, match="what has landed is kept"):
            run_matrix(SMALL, tmp_path / "two", conditions=conditions, processes=2)
    landed = {path.name for path in tmp_path.rglob("*.npz")}
    assert landed == {"zvezda_aft.npz"}

    flown = run_matrix(
        SMALL, tmp_path / "two", conditions=conditions, processes=2, report=lambda *now: said.append(now)
    )
    assert said[-1] == (8, 8, "all flown", "")
    assert any(what.endswith("/2 rows, 2 processes") for _, _, what, _ in said)
    alone = whole[1]
    assert flown.keys() == alone.keys()
    for key, (flights,) in flown.items():
        np.testing.assert_array_equal(flights.digest, alone[key][0].digest)
        np.testing.assert_allclose(flights.closest_distance, alone[key][0].closest_distance, rtol=1e-5)


def same_flights(one, other):
    """Whether two runs flew the same to the bit; how long decisions took is no part of it."""
    assert one.keys() == other.keys()
    for key in one:
        for a, b in zip(one[key], other[key], strict=True):
            for name, values in vars(replace(a, decision_seconds=b.decision_seconds)).items():
                np.testing.assert_array_equal(values, getattr(b, name), f"{key}, {name}")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The small matrix flown at one go: its folder and its flights."""
    out = tmp_path_factory.mktemp("matrix") / "whole"
    return out, run_matrix(SMALL, out, conditions={"nominal": SIMPLE})


def copied(whole, folder):
    return Path(shutil.copytree(whole[0], folder / "out")), folder / "out" / "flights" / "drift" / "own" / "nominal"


def flown_again(out):
    """The flights, and the rows and ports that had to be flown for them."""
    seen = []
    flown = run_matrix(
        SMALL, out, conditions={"nominal": SIMPLE}, report=lambda *now: seen.append(now[2].partition(": ")[2])
    )
    return flown, set(filter(None, seen))


def test_flights_with_draws_are_the_same_whatever_was_killed(whole, tmp_path):
    """Whichever ports are there already; killed after they were saved and before they were noted."""
    out, row = copied(whole, tmp_path)
    told = json.loads((row / "row.json").read_text())
    del told["ports"]["unity_nadir"], told["sha256"]["unity_nadir.npz"]
    (row / "row.json").write_text(json.dumps(told))
    (row.parents[2] / "PD" / "own" / "nominal" / "row.json").write_text("{}")
    flown, again = flown_again(out)
    assert {what.split(",")[0] for what in again} == {"PD to zvezda_aft", "PD to unity_nadir", "drift to unity_nadir"}
    same_flights(flown, whole[1])
    ends = flown["drift", None, "nominal"][0].trajectory[:, 20]
    assert len({tuple(end) for end in ends.tolist()}) == 4, "draws of their own"
    assert not flown_again(out)[1], "mended for good"


OWN = """
import numpy as np

class Noisy:
    def __init__(self, seed):
        self.draws = np.random.default_rng(seed)

    def reset(self, mask, ports):
        pass

    def predict(self, observation, state, episode_start, deterministic):
        return self.draws.normal(size=(len(observation), 6)).astype(np.float32) * 100, state
"""


def test_a_policy_of_one_s_own_draws_the_same_too(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "noisy_own.py").write_text(OWN)
    study = Study(title="Own", policies=("mine",))
    matrix = SMALL.model_copy(update={"policies": {"mine": "noisy_own:Noisy"}, "studies": (study,)})
    first = run_matrix(matrix, tmp_path / "out", conditions={"nominal": SIMPLE})
    (tmp_path / "out" / "flights" / "mine" / "own" / "nominal" / "unity_nadir.npz").unlink()
    same_flights(run_matrix(matrix, tmp_path / "out", conditions={"nominal": SIMPLE}), first)


def of_another_seed(whole, row):
    replace(whole[1]["drift", None, "nominal"][0], seed=np.arange(4), port=np.full(4, 99)).save(row / "unity_nadir.npz")


def not_a_number(whole, row):
    flights = whole[1]["drift", None, "nominal"][0].select(slice(2, 4))
    replace(flights, closest_distance=np.full(2, np.nan)).save(row / "unity_nadir.npz")


def noted(change):
    def damage(whole, row):
        told = json.loads((row / "row.json").read_text())
        change(told)
        (row / "row.json").write_text(json.dumps(told))

    return damage


ROT = {
    "port 99": of_another_seed,
    "NaN": not_a_number,
    "another port's": lambda whole, row: shutil.copyfile(row / "zvezda_aft.npz", row / "unity_nadir.npz"),
    "another row's": lambda whole, row: shutil.copyfile(
        row.parents[2] / "PD" / "own" / "nominal" / "unity_nadir.npz", row / "unity_nadir.npz"
    ),
    "cut": lambda whole, row: (row / "unity_nadir.npz").write_bytes((row / "unity_nadir.npz").read_bytes()[:5000]),
    "empty": lambda whole, row: (row / "unity_nadir.npz").write_bytes(b""),
    "no file": lambda whole, row: (row / "unity_nadir.npz").unlink(),
    "a row of nothing": lambda whole, row: (row / "row.json").write_text("{}"),
    "half a row": lambda whole, row: (row / "row.json").write_bytes((row / "row.json").read_bytes()[:900]),
    "no row": lambda whole, row: (row / "row.json").unlink(),
    "ports of a wrong form": noted(lambda told: told.update(ports={"unity_nadir": 3})),
    "no digests": noted(lambda told: told.pop("sha256")),
    "digests of a wrong form": noted(lambda told: told.update(sha256=[])),
}


@pytest.mark.parametrize("damage", ROT)
def test_flights_that_were_damaged_count_as_missing(damage, whole, tmp_path):
    out, row = copied(whole, tmp_path)
    ROT[damage](whole, row)
    missing = {each.label: Store(out, each, SIMPLE, SMALL).missing() for each in rows_of(SMALL)}
    of_a_file = damage in ("port 99", "NaN", "another port's", "another row's", "cut", "empty", "no file")
    assert missing == {"PD": [], "drift": ["unity_nadir"] if of_a_file else ["zvezda_aft", "unity_nadir"]}


@pytest.mark.parametrize(
    ("policies", "named"),
    [
        ({"PD": "dock", "PD+": "random"}, "'PD' and 'PD\\+'"),
        ({"PD": "dock", "pd": "random"}, "'PD' and 'pd'"),
        ({"a/b": "dock", "a_b": "random"}, "'a/b' and 'a_b'"),
        ({"a": ("dock", "random"), "a seed 2": "orbit"}, "'a' and 'a seed 2'"),
        ({"PD": "dock", "PD, heavy": "random"}, "'PD, heavy' and 'PD'"),
        ({"+": "dock", "": "random"}, r"'\+' and ''"),
        ({"é": "dock", "e\u0301": "random"}, "would share the name"),
    ],
)
def test_rows_that_would_share_a_folder_or_a_name_are_refused_before_anything_flies(policies, named, tmp_path):
    study = Study(title="one", policies=tuple(policies), conditions=("nominal", "heavy"))
    matrix = Matrix(flights=1, ports=("zvezda_aft",), policies=policies, studies=(study,))
    with pytest.raises(ValueError, match=rf"policies {named}" if "share" not in named else named):
        run_matrix(matrix, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_names_of_any_script_have_folders_of_their_own():
    policies = {"模型一": "dock", "模型二": "random", "модель": "orbit", "PD 2": "excite"}
    rows = rows_of(Matrix(policies=policies, studies=(Study(title="all", policies=tuple(policies)),)))
    assert [row.folder.split("/")[0] for row in rows] == ["模型一", "模型二", "модель", "PD_2"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ports": ("zvezda_aft", "zvezda_aft")}, "ports must differ, got 'zvezda_aft' twice"),
        ({"policies": {"PD": ()}}, "policy 'PD' must have a source"),
        ({"policies": {"PD": ("dock", "dock")}}, "or several different ones"),
        (
            {"studies": (Study(title="A b", policies=("PD",)), Study(title="a+B", policies=("PD",)))},
            "titles of studies",
        ),
    ],
)
def test_what_would_be_counted_or_drawn_twice_is_refused(change, message):
    good = {"policies": {"PD": "dock"}, "studies": (Study(title="A", policies=("PD",)),)}
    with pytest.raises(ValueError, match=message):
        Matrix(**good | change)


def test_two_runs_do_not_fly_into_one_folder(whole, tmp_path):
    out, _ = copied(whole, tmp_path)
    with Claim(out, {"command": "run_matrix"}), pytest.raises(FolderTaken, match="another process is at work"):
        flown_again(out)


def test_only_pairs_that_differ_get_a_line_and_all_count_for_their_p():
    alike, apart = Pairs("a", "b", 7, 0, 0, 3), Pairs("c", "b", 2, 8, 0, 0)
    table = pairs_table([("1 m", [alike, apart]), ("strict", [alike, alike])])
    # Eight heads in a row are as likely as 2 / 256; four tests.
    assert table.rows == [["c", "b", "10", "+80.0", "8 : 0", "0.031", "+0.0", "0 : 0", "1"]]
    assert "over all 4 tests" in table.caption and "Left out: 1 comparisons" in table.caption


def test_the_rest_is_estimated_from_rows_alike(table):
    exact, plain, pd, heavy = rows_of(table)
    pace = Pace()
    assert pace.left([(pd, 1)]) is None
    pace.add(exact, 100.0, 20)
    assert pace.left([(exact, 2), (plain, 2), (pd, 1)]) == pytest.approx(25.0)
    pace.add(pd, 20.0, 20)  # compiling
    pace.add(pd, 2.0, 20)
    assert pace.left([(heavy, 10)]) == pytest.approx(1.0)
