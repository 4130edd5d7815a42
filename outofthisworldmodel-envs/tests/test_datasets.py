import json
import shutil
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from owm_envs import datasets
from owm_envs.config import NOISE_PRESETS, load_config
from owm_envs.datasets.generate import generate
from owm_envs.datasets.pieces import Pieces
from owm_envs.datasets.recipe import Request, flights, load_recipe, shipped, splits
from owm_envs.datasets.schema import FEATURES, columns_from_episode
from owm_envs.datasets.statistics import QUANTILES, episode_statistics, exact_quantiles, pixel_statistics, united
from owm_envs.datasets.writer import write_meta, write_split
from owm_envs.episode import POLICY_NAMES, Episode
from owm_envs.files import JOURNAL, FolderTaken
from owm_envs.station import PORT_NAMES, TRAIN_PORTS, goal_poses
from owm_envs.task.events import Outcome
from owm_envs.view import View

ARRAYS = ("true_state", "epoch", "action", "reward", "done", "success", "goal_pose")
CONFIG = load_config(fidelity="iss", noise="cooperative", horizon=4.0, ports=["zvezda_aft", "unity_nadir"])
REQUEST = Request(transitions=3000, val_transitions=100, seed=7, episodes_per_batch=2)


def assert_same(episode: Episode, other: Episode) -> None:
    pairs = {name: (getattr(episode, name), getattr(other, name)) for name in ARRAYS}
    assert episode.observation.keys() == other.observation.keys()
    pairs |= {name: (value, other.observation[name]) for name, value in episode.observation.items()}
    for name, (one, two) in pairs.items():
        assert one.dtype == two.dtype, name
        np.testing.assert_array_equal(one, two, err_msg=name)
    assert (episode.port, episode.policy, episode.outcome) == (other.port, other.policy, other.outcome)


def made_up(rng: np.random.Generator, length: int, port: int = 3, outcome: Outcome = Outcome.DOCKED) -> Episode:
    """An episode that coasts, of random numbers; subnormal ones among them."""
    last = np.arange(length) == length - 1
    seconds = np.arange(length + 1)[:, None] / 20
    coasts = rng.normal(size=3) * 1e-310
    attitude = np.tile([0.5, 0.5, 0.5, 0.5], (length + 1, 1))
    moves = [rng.normal(size=3) + seconds * coasts, np.tile(coasts, (length + 1, 1)), attitude, seconds * 0 + [0, 0, 0]]
    seen = rng.normal(size=(length + 1, 13)).astype(np.float32) * np.float32(1e-40)
    seen[:, 6:10] = attitude
    start = rng.uniform(0, 86_000)
    return Episode(
        observation={"state": seen},
        true_state=np.concatenate(moves, axis=1),
        epoch=np.concatenate([np.full((length + 1, 1), 61_253.0), start + seconds], axis=1),
        action=rng.normal(size=(length, 6)).astype(np.float32),
        reward=rng.normal(size=length).astype(np.float32),
        done=last,
        success=last & (outcome == Outcome.DOCKED),
        port=port,
        goal_pose=goal_poses()[port],
        policy=2,
        outcome=int(outcome),
    )


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A dataset recorded in one go: (folder, its summary)."""
    folder = tmp_path_factory.mktemp("recorded") / "set"
    return folder, generate(folder, CONFIG, REQUEST)


@pytest.fixture
def at_home(tmp_path, monkeypatch):
    """An empty folder as the current one and as the user's own."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)
    monkeypatch.setenv("HOME", str(home))
    return home


@pytest.fixture
def written(tmp_path, monkeypatch):
    """A dataset of made-up episodes in two files: (folder, episodes)."""
    rng = np.random.default_rng(0)
    episodes = [made_up(rng, length, port=length % 8) for length in (1, 5, 30)]
    pieces = Pieces(tmp_path / "pieces")
    for number, episode in enumerate(episodes):
        pieces.put(number, episode, 20.0)
    monkeypatch.setattr("owm_envs.datasets.writer.DATA_MB", sum(pieces.sizes(i)[0] for i in (0, 1)) / 1e6)
    split = write_split(tmp_path / "set", pieces, range(3), 20.0, {})
    write_meta(tmp_path / "set", split, split.statistics, 20.0, {})
    return tmp_path / "set", episodes


def test_reading_gives_back_every_bit(written):
    folder, episodes = written
    for episode, back in zip(episodes, datasets.read(folder), strict=True):
        assert_same(episode, back)


def test_the_last_row_of_an_episode_pads_its_terminal_observation():
    episode = made_up(np.random.default_rng(1), 4)
    rows = columns_from_episode(episode, episode_index=2, first_index=100, fps=20)
    assert set(rows) == set(FEATURES)
    assert all(values.shape[0] == 5 and values.dtype == FEATURES[name].dtype for name, values in rows.items())
    np.testing.assert_array_equal(rows["observation.environment_state"][-1], episode.true_state[-1])
    assert not rows["action"][-1].any() and rows["next.reward"][-1] == 0
    assert rows["next.done"].tolist() == rows["next.success"].tolist() == [False] * 3 + [True] * 2
    np.testing.assert_allclose(rows["timestamp"], np.arange(5) / 20)
    assert rows["index"].tolist() == [100, 101, 102, 103, 104]


def test_statistics_of_episodes_add_up_to_those_of_all_rows():
    rng = np.random.default_rng(2)
    parts = [{"action": rng.normal(5, 3, (n, 2)), "port": np.full(n, 4)} for n in (50, 2, 300)]
    total = {}
    for part in parts:
        total = united(total, episode_statistics(part))
    rows = np.concatenate([part["action"][:-1] for part in parts])
    for name, value in [("mean", rows.mean(0)), ("std", rows.std(0)), ("min", rows.min(0)), ("max", rows.max(0))]:
        np.testing.assert_allclose(total["action"][name], value, rtol=1e-12)
    assert total["action"]["count"].tolist() == [349] and total["port"]["count"].tolist() == [352]
    values = rng.normal(size=(999, 1))
    np.testing.assert_allclose(episode_statistics({"port": values})["port"]["q90"], np.quantile(values, 0.9, axis=0))


@pytest.mark.parametrize("most", [0, 300, 2**22])
@pytest.mark.parametrize("counts", [(1,), (2,), (5, 1000, 77)])
def test_quantiles_are_exact_however_the_rows_are_cut(counts, most):
    rng = np.random.default_rng(3)
    numbers = rng.normal(size=(sum(counts), 3)) * 10.0 ** rng.integers(-300, 300, (sum(counts), 3))
    rows = np.concatenate([numbers, rng.integers(-1, 2, (len(numbers), 2)), np.zeros((len(numbers), 1))], axis=1)
    found = exact_quantiles(lambda: iter(np.split(rows, np.cumsum(counts)[:-1])), most)
    for name, q in QUANTILES.items():
        np.testing.assert_allclose(found[name], np.quantile(rows, q, axis=0), rtol=1e-14, err_msg=name)
    singles = rows[:, 3:].astype(np.float32)
    found = exact_quantiles(lambda: iter([singles]), most)
    np.testing.assert_array_equal(found["q50"], np.quantile(singles.astype(np.float64), 0.5, axis=0))


_MEMORY = """
import resource, sys, tempfile
from pathlib import Path
import numpy as np
from owm_envs.datasets import writer
from owm_envs.datasets.pieces import Pieces
sys.path.insert(0, sys.argv[1])
from test_datasets import made_up
writer.DATA_MB = 2
rng = np.random.default_rng(0)
with tempfile.TemporaryDirectory() as folder:
    pieces = Pieces(Path(folder, "pieces"))
    for count in (80, 240):
        for number in range(count):
            if number not in pieces:
                pieces.put(number, made_up(rng, 2000), 20.0)
        writer.write_split(Path(folder, f"set-{count}"), pieces, range(count), 20.0, {})
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="tells no peak of memory")
def test_memory_does_not_grow_with_the_corpus():
    """Of three times as many episodes, 100 MB of numbers more, no more is held."""
    command = [sys.executable, "-c", _MEMORY, str(Path(__file__).parent)]
    few, many = map(int, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
    assert many - few < 30


def test_statistics_of_pixels_are_those_of_all_of_them():
    rng = np.random.default_rng(4)
    frames = rng.integers(0, 200, (6, 5, 7, 3), dtype=np.uint8)
    counts = np.stack([np.bincount(frames[..., channel].ravel(), minlength=256) for channel in range(3)])
    found, rows = pixel_statistics(counts, 6), frames.reshape(-1, 3) / 255.0
    expected = {"mean": rows.mean(0), "std": rows.std(0), "min": rows.min(0), "max": rows.max(0)}
    expected |= {name: np.quantile(rows, q, axis=0) for name, q in QUANTILES.items()}
    for name, value in expected.items():
        assert found[name].shape == (3, 1, 1)
        np.testing.assert_allclose(found[name].ravel(), value, rtol=1e-12, err_msg=name)
    assert found["count"].tolist() == [6]


def test_a_recorded_dataset_is_what_was_asked_for(recorded):
    folder, summary = recorded
    train, val = datasets.read(folder, "train"), datasets.read(folder, "val")
    for split, episodes, target in [("train", train, 3000), ("val", val, 100)]:
        counts = [len(episode) for episode in episodes]
        assert sum(counts) == summary[split]["transitions"] >= target > sum(counts[:-1])
        assert summary[split]["episodes"] == len(episodes)
    assert {PORT_NAMES[episode.port] for episode in train} == {"zvezda_aft"}
    assert [PORT_NAMES[episode.port] for episode in val] == ["zvezda_aft", "unity_nadir"]
    assert {episode.policy_name for episode in val} == {"dock"}
    assert len({episode.true_state[0, 0] for episode in train + val}) == len(train + val)
    info = json.loads((folder / "generation.json").read_text())
    assert info["request"]["seed"] == 7 and info["result"] == summary
    assert load_config(folder / "config.toml") == CONFIG
    assert not list(folder.rglob("*.tmp")) and not folder.with_name("set.partial").exists()


def test_both_splits_are_normalised_by_train_alone(recorded):
    folder, _ = recorded
    for split in ("train", "val"):
        statistics = datasets.read_statistics(folder, split)
        rows = np.concatenate([episode.action for episode in datasets.read(folder, "train")]).astype(np.float64)
        np.testing.assert_allclose(statistics["action"]["mean"], rows.mean(axis=0), rtol=1e-6)
        np.testing.assert_allclose(statistics["action"]["std"], rows.std(axis=0), rtol=1e-6)
        assert set(statistics) == set(FEATURES)


def test_the_metadata_says_what_the_files_hold(recorded):
    folder, summary = recorded
    for split in ("train", "val"):
        info = json.loads((folder / split / "meta/info.json").read_text())
        assert info["codebase_version"] == "v3.0" and info["fps"] == 20
        files = sorted((folder / split / "data").rglob("*.parquet"))
        table = pa.concat_tables([pq.read_table(file) for file in files])
        assert table.num_rows == info["total_frames"] == summary[split]["transitions"] + info["total_episodes"]
        assert table["index"].to_pylist() == list(range(table.num_rows))
        assert {name: len(feature["names"] or "-") for name, feature in info["features"].items()} == {
            name: feature.shape[0] for name, feature in FEATURES.items()
        }
        meta = pa.concat_tables(pq.read_table(file) for file in sorted((folder / split / "meta/episodes").rglob("*.*")))
        for row in meta.to_pylist():
            file = (
                folder
                / split
                / info["data_path"].format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
            )
            held = pq.read_table(file, filters=[("episode_index", "==", row["episode_index"])])
            assert held["index"].to_pylist() == list(range(row["dataset_from_index"], row["dataset_to_index"]))
            assert len(held) == row["length"]


def planned(config=None, count=1000, split="train", **request):
    return list(islice(flights(splits(Request(**request), config or load_config())[split]), count))


def test_flights_are_spread_as_the_mix_says():
    train = planned(planner_style=0.2)
    share = Counter(flight.policy for flight in train)
    for policy, expected in [("random", 240), ("orbit", 280), ("dock", 280), ("excite", 200)]:
        assert abs(share[policy] - expected) <= 5
    ports = Counter(PORT_NAMES[flight.port] for flight in train)
    assert ports == dict.fromkeys(TRAIN_PORTS, 200)
    both = Counter(train)
    assert min(both.values()) > 20, "policy and port must not be tied to each other"
    assert {flight.policy for flight in train[:8]} >= {"random", "orbit", "dock"}
    assert [PORT_NAMES[flight.port] for flight in planned(count=8, split="val")] == list(PORT_NAMES)
    assert train == planned(planner_style=0.2) != planned(planner_style=0.2, seed=1)


def test_mixtures_and_ports_of_each_split_may_be_chosen():
    asked = {
        "policies": {"dock-geodesic": 3, "random": 1},
        "ports": ("unity_nadir", "zvezda_aft"),
        "val_policies": {"orbit": 1.0},
        "val_ports": ("poisk_zenith",),
    }
    train, val = planned(**asked), planned(**asked, split="val", count=3)
    assert abs(Counter(flight.policy for flight in train)["dock-geodesic"] - 750) <= 2
    assert Counter(PORT_NAMES[flight.port] for flight in train) == {"unity_nadir": 500, "zvezda_aft": 500}
    assert {(flight.policy, PORT_NAMES[flight.port]) for flight in val} == {("orbit", "poisk_zenith")}


def test_recipes_that_come_with_the_package_are_requests():
    assert {"quick", "small-64", *(f"paper-500k-{n}" for n in ("none", "cooperative", "noncooperative"))} == {
        *shipped()
    }
    for name in shipped():
        request, environment = load_recipe(name)
        config = load_config(environment)
        plan = splits(Request(**request), config)
        assert plan["train"].transitions == (500_000 if "500k" in name else 20_000)
        if "500k" in name:
            assert config.camera.height == config.camera.width == 512 and config.decision_dt == 0.05
            assert plan["val"].ports == list(range(8)) and name.endswith(tuple(NOISE_PRESETS))
            assert config.noise == NOISE_PRESETS[name.rpartition("-")[2]]
    assert load_config(load_recipe("small-64")[1]).decision_dt == 0.25


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("transition = 5", "recipe '.*': unknown key 'transition'; did you mean 'transitions'"),
        ("transitions = ", "is not valid TOML"),
        ("[environment]\nfidelty = 'iss'", "unknown .*'fidelty'; did you mean 'fidelity'"),
    ],
)
def test_a_recipe_with_a_mistake_is_refused(tmp_path, text, message):
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_recipe(tmp_path / "own.toml")
    with pytest.raises(ValueError, match="unknown recipe 'smal-64'; did you mean 'small-64'"):
        load_recipe("smal-64")


def _command(folder, config):
    module = [sys.executable, "-m", "owm_envs.cli", "generate", "--out", str(folder), "--config", str(config)]
    numbers = {"transitions": 3000, "val-transitions": 100, "seed": 7, "episodes-per-batch": 2}
    return module + [word for name, value in numbers.items() for word in (f"--{name}", str(value))]


def test_a_killed_run_leaves_nothing_or_resumes_to_the_same_dataset(recorded, tmp_path):
    whole, _ = recorded
    folder, config = tmp_path / "set", tmp_path / "config.toml"
    config.write_text(CONFIG.to_toml(), encoding="utf-8")
    first = folder.with_name("set.partial") / "pieces/train/000000.arrow"
    with subprocess.Popen(_command(folder, config), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        while not first.is_file() and process.poll() is None:
            time.sleep(0.005)
        ended = process.poll()
        process.kill()
        assert ended is None, f"the run ended before it could be killed: {process.stderr.read()}"
    assert not folder.exists()
    with pytest.raises(FileNotFoundError, match="holds an unfinished one"):
        datasets.read(folder, "train")
    with pytest.raises(FileExistsError, match=r"set.partial holds another run, which differs in request.seed"):
        generate(folder, CONFIG, Request(transitions=3000, val_transitions=100, seed=8, episodes_per_batch=2))
    kept, told = {piece.name: piece.stat().st_mtime_ns for piece in first.parent.iterdir()}, []

    def look(progress):
        for name, time_ns in kept.items():
            piece = first.with_name(name)
            assert not piece.exists() or piece.stat().st_mtime_ns == time_ns, "a finished episode was flown again"

    generate(folder, CONFIG, REQUEST, announce=told.append, progress=look)
    assert any("resuming" in message for message in told) and "000000.arrow" in kept
    assert_same_bytes(whole, folder)


def assert_same_bytes(one, other):
    names = [{file.relative_to(root) for file in root.rglob("*") if file.is_file()} for root in (one, other)]
    assert names[0] == names[1]
    assert [str(name) for name in names[0] if (one / name).read_bytes() != (other / name).read_bytes()] == []


def test_an_existing_folder_is_left_alone(recorded):
    """The same again is done already; anything else is refused before anything is written."""
    folder, summary = recorded
    before, told = {file: file.stat().st_mtime_ns for file in folder.rglob("*")}, []
    assert generate(folder, CONFIG, REQUEST, announce=told.append) == summary and "complete" in told[0]
    with pytest.raises(FolderTaken, match=r"set holds another run, which differs in request.seed: choose another"):
        generate(folder, CONFIG, replace(REQUEST, seed=8))
    with pytest.raises(FolderTaken, match=r"holds files of something else \(set\): choose another folder"):
        generate(folder.parent, CONFIG, REQUEST)
    assert {file: file.stat().st_mtime_ns for file in folder.rglob("*")} == before
    assert [path.name for path in folder.parent.iterdir()] == ["set"]


@pytest.mark.parametrize("name", ["elsewhere", "."])
def test_a_finished_run_is_not_published_over_other_files(recorded, at_home, name):
    whole, _ = recorded
    place = (at_home / name).resolve()
    place.mkdir(exist_ok=True)
    shutil.copytree(whole, partial := place.with_name(place.name + ".partial"))
    (place / "README.md").write_text("precious")
    with pytest.raises(FolderTaken, match=r"holds files of something else \(README.md\)"):
        generate(name, CONFIG, REQUEST)
    assert [(f.name, f.read_text()) for f in place.glob("R*")] == [("README.md", "precious")]
    (place / "README.md").unlink()
    generate(name, CONFIG, REQUEST)
    assert datasets.read(place, "val") and not partial.exists()


def test_a_run_killed_while_it_claimed_its_folder_may_begin(tmp_path):
    (tmp_path / "set.partial").mkdir()
    (tmp_path / "set.partial" / ".generation.json.17.partial").write_text("{")
    with pytest.raises(OSError, match="MB are free"):  # refused for its size alone
        generate(tmp_path / "set", CONFIG, Request(transitions=10**12))


@pytest.mark.parametrize("journal", [False, True])
def test_a_run_killed_after_its_last_file_has_moved_is_complete(recorded, tmp_path, journal):
    whole, summary = recorded
    partial = tmp_path / "set.partial"
    partial.mkdir()
    if journal:
        (partial / JOURNAL).write_text("\n".join(path.name for path in whole.iterdir()))
    shutil.copytree(whole, tmp_path / "set")
    assert generate(tmp_path / "set", CONFIG, REQUEST) == summary and not partial.exists()


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"transitions": 0}, "transitions must be at least 1"),
        ({"planner_style": 1.5}, "planner_style must be from 0 to 1"),
        ({"seed": -1}, "seed must be an integer of at least 0, got -1"),
        ({"episodes": 3}, "exactly one of transitions and episodes"),
        ({"val_transitions": None}, "exactly one of val_transitions and val_episodes"),
        ({"policies": {"dok": 1.0}}, "unknown policy 'dok'; did you mean 'dock'"),
        ({"val_policies": {"dock": 0.0}}, "val_policies must be shares"),
        ({"ports": ("zvesda_aft",)}, "zvezda_aft"),
    ],
)
def test_impossible_requests_are_refused_by_name(request_, message):
    with pytest.raises(ValueError, match=message):
        Request(**request_)


def test_nothing_is_written_where_no_train_port_or_no_room_is(tmp_path):
    with pytest.raises(ValueError, match="at least one train port"):
        generate(tmp_path / "a", load_config(fidelity="iss", ports=["unity_nadir"]), REQUEST)
    with pytest.raises(OSError, match="MB are free"):
        generate(tmp_path / "b", CONFIG, Request(transitions=10**12))
    assert not (tmp_path / "a.partial").exists() and not (tmp_path / "b.partial").exists()


def _break(folder, how):
    info, data = folder / "meta/info.json", folder / "data/chunk-000/file-000.parquet"
    if how == "missing":
        return folder / "nowhere"
    if how == "split":
        shutil.copytree(folder, folder.with_name("other"))
        return folder.parent
    if how == "not lerobot":
        info.unlink()
    elif how == "version":
        info.write_text(info.read_text().replace("v3.0", "v1.6"))
    elif how == "info":
        info.write_text("{")
    elif how == "truncated":
        data.write_bytes(data.read_bytes()[:-500])
    elif how == "no data":
        for file in (folder / "data").rglob("*.parquet"):
            file.unlink()
    elif how == "incomplete":
        (folder / "data/chunk-000/file-001.parquet").unlink()
    elif how == "columns":
        pq.write_table(pq.read_table(data).drop_columns(["goal_pose", "epoch"]), data)
    return folder


@pytest.mark.parametrize(
    ("how", "error", "message"),
    [
        ("missing", FileNotFoundError, "no dataset at"),
        ("split", ValueError, "holds the splits other, set: name one"),
        ("not lerobot", ValueError, "no meta/info.json"),
        ("version", ValueError, "version 'v1.6'; this reads v2.1 and v3"),
        ("info", ValueError, "not the info.json"),
        ("truncated", ValueError, "may be truncated"),
        ("no data", FileNotFoundError, "file-000.parquet is missing: .* is incomplete"),
        ("incomplete", FileNotFoundError, "file-001.parquet is missing: .* is incomplete"),
        ("columns", ValueError, "lacks the columns goal_pose, epoch"),
    ],
)
def test_a_broken_dataset_is_refused_in_words(written, how, error, message):
    folder, _ = written
    with pytest.raises(error, match=message):
        datasets.read(_break(folder, how))


@pytest.mark.parametrize("inertial", [False, True])
def test_the_columns_of_the_published_datasets_are_read_too(tmp_path, inertial):
    rng = np.random.default_rng(5)
    episode = made_up(rng, 6, port=5)
    rows = 7
    if inertial:
        # A chief on the x axis of a circular equatorial orbit and a chaser 10 m above it, at rest beside it.
        speed, radius = 7_660.0, 6_795_000.0
        chief = [radius, 0, 0, 0, speed, 0]
        chaser = [radius + 10, 0, 0, 0, speed * (radius + 10) / radius, 0]
        state = np.tile([61_253.0, 0.0, *chief, *chaser, 1, 0, 0, 0, 0, 0, speed / radius], (rows, 1))
    else:
        state = rng.normal(size=(rows, 13))
    vector = np.concatenate([episode.epoch, episode.observation["state"], np.zeros((rows, 12))], axis=1)

    def nested(values):
        return pa.array([[[float(v)]] for v in values], pa.list_(pa.list_(pa.float32(), 1), 1))

    reward = np.append(episode.reward, 0.0)
    reward[5] = -1e6
    table = pa.table(
        {
            "observation_vector": pa.array(list(vector)),
            "state_vector": pa.array(list(state)),
            "action": pa.array(list(np.append(episode.action, np.zeros((1, 6)), axis=0))),
            "reward": nested(reward),
            "terminated": pa.array([False] * 5 + [True] * 2),
            "policy_id": nested(np.full(rows, 2)),
            "dock_target": pa.array([[list(episode.goal_pose)]] * rows, pa.list_(pa.list_(pa.float32()), 1)),
            "episode_index": np.zeros(rows, np.int64),
        }
    )
    (tmp_path / "data/chunk-000").mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    pq.write_table(table, tmp_path / "data/chunk-000/file-000.parquet")
    (tmp_path / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "total_frames": rows}))
    (back,) = datasets.read(tmp_path)
    np.testing.assert_array_equal(back.observation["state"], episode.observation["state"])
    np.testing.assert_array_equal(back.action, episode.action)
    assert back.port == 5 and back.outcome == Outcome.COLLIDED and back.policy_name == "dock"
    assert back.done.tolist() == [False] * 5 + [True]
    if inertial:
        first = View.of(back.true_state[0])
        np.testing.assert_allclose(first.position, [0, 0, 10], atol=1e-6)
        np.testing.assert_allclose(first.velocity, 0, atol=1e-4)
    else:
        np.testing.assert_array_equal(back.true_state, state)


def test_policy_ids_in_files_never_change():
    assert POLICY_NAMES[:5] == ("random", "orbit", "dock", "dock-geodesic", "excite")


def test_an_empty_folder_may_be_named_in_any_way(recorded, at_home):
    """A finished run is published into what a link, ".", or "~" stands for; recording itself is `recorded`'s."""
    whole, _ = recorded
    (at_home / "target").mkdir()
    (at_home / "link").symlink_to("target")
    for name, place in [("link", "target"), ("~/tilde/", "tilde"), (".", ".")]:
        place = (at_home / place).resolve()
        partial = place.with_name(place.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        for child in [*place.iterdir()] if name == "." else []:
            child.unlink() if child.is_symlink() else shutil.rmtree(child)
        shutil.copytree(whole, partial)
        (partial / "train" / ".info.json.17.partial").touch()  # of a writer that was killed
        generate(name, CONFIG, REQUEST)
        assert not partial.exists() and not list(place.rglob("*.partial"))
        files = [file.relative_to(whole) for file in whole.rglob("*") if file.is_file()]
        assert all((place / file).read_bytes() == (whole / file).read_bytes() for file in files)
    assert (at_home.parent / "home") == at_home.resolve() == Path.cwd()


def test_what_cannot_be_written_to_is_refused_before_anything_is_simulated(tmp_path):
    file = tmp_path / "file"
    file.touch()
    for out in (file, file / "below"):
        with pytest.raises(NotADirectoryError, match="is no folder"):
            generate(out, CONFIG, REQUEST)
