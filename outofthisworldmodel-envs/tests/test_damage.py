"""What is damaged is refused in one line, by each reader; what only a recomputation can know, by `verify`."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from damaged import DAMAGES, DATA, EPISODES, at, in_rows, rewrite, told

from owm_envs import datasets
from owm_envs.cli import main
from owm_envs.config import load_config
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.manifest import MANIFEST, differences, load_manifest, write_manifest
from owm_envs.datasets.verify import verify

CONFIG = load_config(fidelity="iss", noise="cooperative", horizon=2.0, ports=["zvezda_aft", "pirs_nadir"])


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A small dataset of both splits, with its manifest."""
    folder = tmp_path_factory.mktemp("sound") / "set"
    generate(folder, CONFIG, Request(160, 80, seed=7, episodes_per_batch=8))
    return folder


@pytest.fixture
def copy(sound, tmp_path):
    """A copy to damage."""
    return shutil.copytree(sound, tmp_path / "set")


def read_all(folder: Path) -> None:
    """Read all that readers read."""
    for split in ("train", "val"):
        datasets.read(folder, split)
        datasets.read_statistics(folder, split)


def refusal(folder: Path) -> str | None:
    """How a dataset is refused; None if it is not. Nothing but these errors may be raised."""
    try:
        read_all(folder)
    except (ValueError, FileNotFoundError) as error:
        return str(error)
    return None


def test_a_sound_dataset_is_read(sound):
    assert refusal(sound) is None


@pytest.mark.parametrize("manifest", ["none", "made to fit"])
@pytest.mark.parametrize("name", DAMAGES)
def test_each_damage_is_refused(copy, name, manifest):
    (copy / MANIFEST).unlink()
    DAMAGES[name](copy)
    if manifest != "none":
        write_manifest(copy)
    said = refusal(copy)
    assert said is not None and "\n" not in said


def _byte_damages(data: bytes, rng: np.random.Generator, count: int) -> list[tuple[str, bytes]]:
    """A file as it may come back from a bad disk or a broken transfer: a bit flipped, a byte lost, its end missing."""
    found = []
    for place in rng.integers(len(data), size=count).tolist():
        flipped = bytearray(data)
        flipped[place] ^= 1 << int(rng.integers(8))
        found.append((f"bit of byte {place} flipped", bytes(flipped)))
        found.append((f"byte {place} lost", data[:place] + data[place + 1 :]))
    return [*found, ("half of it", data[: len(data) // 2]), ("nothing", b""), ("a byte more", data + b"\n")]


def test_no_byte_of_a_run_may_change(copy):
    """With the manifest every damage of every file is named, and readers refuse it in the files that they read."""
    rng, tried = np.random.default_rng(0), 0
    for file in sorted(path for path in copy.rglob("*") if path.is_file()):
        name = file.relative_to(copy).as_posix()
        if name in (MANIFEST, "README.md"):
            continue
        whole = file.read_bytes()
        for how, data in _byte_damages(whole, rng, 3):
            file.write_bytes(data)
            tried += 1
            assert any(name in said for said in differences(copy)), f"{name}, {how}: not named"
            if name != "config.toml":
                assert refusal(copy), f"{name}, {how}: read"
        file.write_bytes(whole)
    assert tried > 90 and refusal(copy) is None


def test_a_damaged_manifest_is_refused_or_says_the_same(copy):
    rng, path = np.random.default_rng(1), copy / MANIFEST
    whole, listed = path.read_bytes(), load_manifest(copy)
    for how, data in _byte_damages(whole, rng, 15):
        path.write_bytes(data)
        if not refusal(copy):
            assert load_manifest(copy) == listed or list(differences(copy)), how


def test_without_a_manifest_page_checksums_keep_the_rows(copy):
    """What of a Parquet file is read at all is refused, or as it was: its header and its footer have no checksum."""
    (copy / MANIFEST).unlink()
    file, rng, refused = copy / DATA, np.random.default_rng(2), 0
    rewrite(file, lambda columns: None)
    whole, before = file.read_bytes(), datasets.read(copy, "train")
    for how, data in _byte_damages(whole, rng, 25):
        file.write_bytes(data)
        if refusal(copy):
            refused += 1
            continue
        for one, other in zip(before, datasets.read(copy, "train"), strict=True):
            np.testing.assert_array_equal(one.true_state, other.true_state, err_msg=how)
            np.testing.assert_array_equal(one.action, other.action, err_msg=how)
            np.testing.assert_array_equal(one.observation["state"], other.observation["state"], err_msg=how)
            np.testing.assert_array_equal(one.reward, other.reward, err_msg=how)
    assert refused > 40


WRONG = [None, True, -1, 1e300, 10**400, "x" * 300, "../x", [], {}, [[1], 2], "\ud800", {"": [None]}]
"""In place of any value of a JSON file."""


def _mutations(value, rng: np.random.Generator):
    """A table with one of its values, at any depth, replaced."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return WRONG[rng.integers(len(WRONG))]
    changed = value.copy()
    place = list(value)[rng.integers(len(value))] if isinstance(value, dict) else int(rng.integers(len(value)))
    changed[place] = _mutations(value[place], rng)
    return changed


@pytest.mark.parametrize("name", ["train/meta/info.json", "train/meta/stats.json", "generation.json", MANIFEST])
def test_whatever_a_table_tells_is_read_or_refused_in_a_line(copy, name):
    if name != MANIFEST:
        (copy / MANIFEST).unlink()
    rng, path, refused = np.random.default_rng(3), copy / name, 0
    whole = json.loads(path.read_text())
    for _ in range(40):
        path.write_text(json.dumps(_mutations(whole, rng)))
        try:
            dataset = datasets.open(copy, "train")
            assert dataset[0].action.shape[1] == 6 and dataset.statistics
        except (ValueError, FileNotFoundError) as error:
            assert "\n" not in str(error) and len(str(error)) < 2000
            refused += 1
    assert refused > 5


def _softer(columns):
    """Errors of half as much again: none is larger than can be."""
    off = columns["observation.state"][:, :3] - columns["observation.environment_state"][:, :3]
    columns["observation.state"][:, :3] += (0.5 * off).astype(np.float32)


def _pushed(columns):
    columns["action"][20, 1] += 3.0 if columns["action"][20, 1] < 0 else -3.0


SUBTLE = {
    "an action of another flight": (in_rows(_pushed), "dynamics", r"episode 0 is .* off a step of the dynamics"),
    "rewards of others": (
        in_rows(lambda c: c | {"next.reward": -c["next.reward"]}), "reward", "next.reward of episode 0 is not that of",
    ),
    "rewards in another order": (
        in_rows(lambda c: c | {"next.reward": np.append(c["next.reward"][20::-1], c["next.reward"][21:])}), "reward",
        "next.reward of episode 0 is not that of",
    ),
    "louder noise": (in_rows(_softer), "noise", "the measured position errs 1.5.* times as much as configured"),
    "other statistics": (
        told("val/meta/stats.json", "action", "mean", value=[0.0] * 6), "statistics", "mean of action is",
    ),
    "other statistics of an episode": (
        at("stats/action/mean", 1, [0.0] * 6, EPISODES), "statistics", "mean of action is",
    ),
    "another configuration": (
        lambda root: (root / "config.toml").write_text("fidelity = 'iss'\n"), "configuration", "another configuration",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SUBTLE)
def test_what_only_a_recomputation_can_know_is_found_by_verify(copy, name):
    damage, check, message = SUBTLE[name]
    damage(copy)
    write_manifest(copy)
    assert refusal(copy) is None
    report = verify(copy)
    wrong = [finding for finding in report.wrong if finding.check == check]
    assert not report.sound and wrong and re.search(message, wrong[0].told), report.findings


def test_verify_finds_nothing_wrong_with_a_sound_dataset(sound):
    said = []
    report = verify(sound, said.append)
    assert report.sound and {finding.result for finding in report.findings} == {"ok"}
    found = {(finding.check, finding.split) for finding in report.findings}
    checks = ("rows", "statistics", "dynamics", "reward", "noise")
    assert found >= {("hashes", ""), ("configuration", "")} | {(c, s) for c in checks for s in ("train", "val")}
    assert "train: physics" in said


def test_the_command_ends_with_1_and_says_what_is_wrong(copy, capsys):
    main(["verify", str(copy)])
    assert "hashes" in capsys.readouterr().out
    DAMAGES["rows reversed"](copy)
    with pytest.raises(SystemExit) as stop:
        main(["verify", str(copy)])
    said = capsys.readouterr()
    assert stop.value.code == 1 and "manifest.json tells of" in said.err and "Traceback" not in said.err
    with pytest.raises(SystemExit) as stop:
        main(["verify", str(copy / "nowhere")])
    assert stop.value.code == 2 and capsys.readouterr().err.startswith("error: no dataset at")


@pytest.mark.parametrize("name", DAMAGES)
def test_verify_raises_nothing_at_any_damage(copy, name, monkeypatch):
    DAMAGES[name](copy)
    monkeypatch.setattr("owm_envs.datasets.verify._physics", lambda dataset, split: iter(()))  # what is refused before
    assert not verify(copy).sound
