"""Training: it learns, it survives being killed, it refuses another run's directory."""

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from owm.data import Episodes
from owm.evaluation.prediction import window_errors
from owm.model.checkpoint import CheckpointError, load_world_model
from owm.model.config import ModelConfig
from owm.training.config import PRESETS, TrainConfig, preset
from owm.training.loop import train
from owm.training.step import train_chunk

CONFIG = TrainConfig(
    model=ModelConfig(width=8, heads=2, window=4, head_width=8, history_length=4),
    steps=300,
    batch=16,
    learning_rate=1e-2,
    warmup=20,
    rollouts=((1.0, 6),),
    chunk=25,
    save_every=25,
    validation_windows=32,
    validation_horizon=32,
    keep_checkpoints=3,
)
QUIET = Console(quiet=True)

CHILD = """
import sys
import numpy as np
from owm.data import Episodes
from owm.training.config import TrainConfig
from owm.training.loop import train
data = dict(np.load(sys.argv[1]))
texts = {k: tuple(data.pop(k).tolist()) for k in ("policies", "ports")}
episodes = Episodes(**{k: v for k, v in data.items() if k != "dt"}, **texts, dt=float(data["dt"]))
train(TrainConfig.model_validate_json(sys.argv[2]), episodes, episodes, sys.argv[3])
"""


def lines(result_or_dir):
    file = Path(result_or_dir) / "metrics.jsonl"
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


@pytest.fixture(scope="module")
def uninterrupted(episodes, tmp_path_factory):
    traces = train_chunk._cache_size() + 0, window_errors._cache_size() + 0
    out = tmp_path_factory.mktemp("runs") / "whole"
    result = train(CONFIG, episodes, episodes, out, console=QUIET)
    traced = train_chunk._cache_size() - traces[0], window_errors._cache_size() - traces[1]
    return result, out, traced


def test_a_run_learns_and_publishes_its_best(uninterrupted):
    result, out, _ = uninterrupted
    log = lines(out)
    assert [line["step"] for line in log] == list(range(0, 301, 25))
    flow = [line["flow_loss"] for line in log[1:]]
    assert 0.6 < flow[0] < 1.5, "the target has unit variance and an untrained head predicts zero"
    assert np.mean(flow[-3:]) < 0.8 * flow[0]
    scores = {line["step"]: line["score"] for line in log if "score" in line}
    assert result.score == pytest.approx(min(scores.values()), rel=1e-5)
    assert scores[result.step] == pytest.approx(result.score, rel=1e-5)
    assert result.score < scores[0], "better than the least-squares skip it starts from"
    published = load_world_model(result.model_dir, expect=CONFIG.model)
    for a, b in zip(jax.tree.leaves(published.params), jax.tree.leaves(result.model.params), strict=True):
        np.testing.assert_array_equal(a, b)


def test_one_rollout_length_compiles_once(uninterrupted):
    assert uninterrupted[2] == (1, 1)


def test_a_finished_run_is_returned_and_another_is_refused(uninterrupted, episodes):
    result, out, _ = uninterrupted
    again = train(CONFIG, episodes, episodes, out, console=QUIET)
    assert (again.score, again.step) == (result.score, result.step)
    with pytest.raises(ValueError, match=r"differs in config.*choose another folder"):
        train(CONFIG.model_copy(update={"seed": 1}), episodes, episodes, out, console=QUIET)
    other = replace(episodes, observation=episodes.observation + 1.0)
    with pytest.raises(ValueError, match="differs in val"):
        train(CONFIG, episodes, other, out, console=QUIET)


@pytest.mark.parametrize("part", ["run.json", "state"])
def test_a_damaged_run_is_named(part, uninterrupted, episodes, tmp_path):
    out = tmp_path / "damaged"
    shutil.copytree(uninterrupted[1], out)
    shutil.rmtree(out / "model")
    files = [out / part] if part == "run.json" else [file for file in (out / part).rglob("*") if file.is_file()]
    for file in files:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(CheckpointError, match=r"is damaged.*choose another folder"):
        train(CONFIG, episodes, episodes, out, console=QUIET)


def test_killed_and_resumed_equals_uninterrupted(uninterrupted, episodes, tmp_path):
    _, whole, _ = uninterrupted
    data, out = tmp_path / "data.npz", tmp_path / "killed"
    np.savez(data, **{f.name: np.asarray(getattr(episodes, f.name)) for f in fields(Episodes)})

    def saved():
        """Tell whether a save has been completed: its directory then has the step's number for a name."""
        return any(path.name.isdigit() for path in (out / "state").glob("*"))

    command = [sys.executable, "-c", CHILD, str(data), CONFIG.model_dump_json(), str(out)]
    with (tmp_path / "log").open("wb") as log:
        child = subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | {"JAX_PLATFORMS": "cpu"})
        try:
            deadline = time.monotonic() + 240
            while not saved() and child.poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)
        finally:
            child.kill()
            child.wait()
    assert child.returncode != 0, (tmp_path / "log").read_text(encoding="utf-8", errors="replace")
    assert saved(), "it was killed before its first save"
    assert not (out / "model").exists(), "a killed run publishes nothing"
    # What a kill within a line of the log would leave.
    with (out / "metrics.jsonl").open("a", encoding="utf-8") as file:
        file.write('{"step": 3')
    train(CONFIG, episodes, episodes, out, console=QUIET)
    published = {
        path.relative_to(whole) for folder in ("model", "checkpoints") for path in (whole / folder).rglob("*.*")
    }
    assert len(published) == 3 * (1 + CONFIG.keep_checkpoints)
    for path in published:
        assert (out / path).read_bytes() == (whole / path).read_bytes(), f"{path} differs"
    assert lines(out) == lines(whole)


def test_data_that_does_not_fit_is_refused(episodes, tmp_path):
    with pytest.raises(ValueError, match="training episodes are too short for rollouts of 500 steps"):
        train(CONFIG.model_copy(update={"rollouts": ((1.0, 500),)}), episodes, episodes, tmp_path / "a")
    with pytest.raises(ValueError, match=r"validation episodes step by 0\.5 s, the model by 0\.25 s"):
        train(CONFIG, episodes, replace(episodes, dt=0.5), tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_configurations_are_checked():
    with pytest.raises(ValueError, match="unknown training preset 'nanno'"):
        preset("nanno")
    with pytest.raises(ValueError, match="multiple of chunk"):
        TrainConfig(save_every=77)
    with pytest.raises(ValueError, match=r"ending at 1\.0"):
        TrainConfig(rollouts=((0.5, 16),))
    for config in PRESETS.values():
        assert TrainConfig.model_validate_json(config.model_dump_json()) == config
    nano = preset("nano")
    assert [nano.rollout_at(step) for step in (0, 2999, 3000, 5999)] == [16, 16, 32, 32]
