"""Training: it learns, it survives being killed, it refuses another run's directory."""

import json
import os
import shutil
import struct
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic
from rich.console import Console
from tensorboardX.proto.event_pb2 import Event

from owm.baselines.constant_velocity import ConstantVelocity
from owm.catalogue.checkpoint import load_world_model
from owm.data.windows import Episodes, from_episodes
from owm.model.config import ModelConfig
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Params
from owm.scores.calibration import calibration
from owm.scores.prediction import window_errors
from owm.training.autobatch import compiled_bytes, largest_batch, memory_budget
from owm.training.config import PRESETS, TrainConfig, preset
from owm.training.loop import train
from owm.training.step import initial_state, train_chunk
from owm.training.validation import SCORE_UNITS, coasting_score, validation_sets
from owm_envs.claims import Claim
from owm_envs.files import FolderTaken

CONFIG = TrainConfig(
    model=ModelConfig(width=8, heads=2, window=4, head_width=8, history_length=4),
    steps=300,
    batch=16,
    learning_rate=1e-2,
    warmup=20,
    rollouts=((1.0, 6),),
    decoded=4,
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
from owm.data.windows import Episodes
from owm.training.config import TrainConfig
from owm.training.loop import train
data = dict(np.load(sys.argv[1]))
texts = {k: tuple(data.pop(k).tolist()) for k in ("policies", "ports")}
data["observation"] = {"state": data.pop("observation")}
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


@pytest.mark.slow
def test_a_run_learns_and_publishes_its_best(uninterrupted):
    result, out, _ = uninterrupted
    log = lines(out)
    assert [line["step"] for line in log] == list(range(0, 301, 25))
    flow = [line["flow_loss"] for line in log[1:]]
    # The target is the innovation: most of it is the noise of the measurement, which no training takes away.
    assert 0.6 < flow[0] < 1.5 and max(flow) < 1.1 * flow[0]
    scores = {line["step"]: line["score"] for line in log if "score" in line}
    assert result.score == pytest.approx(min(scores.values()), rel=1e-5)
    assert scores[result.step] == pytest.approx(result.score, rel=1e-5)
    assert result.score < 0.9 * scores[0], "better than the least-squares map it starts from"
    published = load_world_model(result.model_dir, expect=CONFIG.model)
    for a, b in zip(jax.tree.leaves(published.params), jax.tree.leaves(result.model.params), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_sampled_rollouts_are_spread_as_the_measurements_are(uninterrupted, episodes):
    """Short as the training was: the spread neither collapses nor walks away over 32 steps."""
    windows = episodes.windows(CONFIG.model.history_length + 32, 64, seed=3)
    result = calibration(
        uninterrupted[0].model, windows, (1, 8, 32), samples=39, outcome="measurement", levels=(0.5, 0.9)
    )
    position, velocity = result.coverage[:, 0], result.coverage[:, 1]
    for covered in (position, velocity):
        assert (np.abs(covered[:, 0] - 0.5) < 0.15).all()
        assert (np.abs(covered[:, 1] - 0.9) < 0.1).all()
    ratio = (result.spread / result.error)[:, :2]
    assert (0.7 < ratio).all() and (ratio < 1.4).all()
    point = result.error[:, 0].mean()
    assert (result.crps[:, 0] < 0.45 * point).all(), "a point forecast's would be about half of the error's norm"


@pytest.mark.slow
def test_one_rollout_length_compiles_once(uninterrupted):
    assert uninterrupted[2] == (1, 1)


@pytest.mark.slow
def test_a_finished_run_is_returned_and_another_is_refused(uninterrupted, episodes):
    result, out, _ = uninterrupted
    again = train(CONFIG, episodes, episodes, out, console=QUIET)
    assert (again.score, again.step) == (result.score, result.step)
    with pytest.raises(ValueError, match=r"differs in config.*choose another folder"):
        train(CONFIG.model_copy(update={"seed": 1}), episodes, episodes, out, console=QUIET)
    other = replace(episodes, observation={"state": episodes.view + 1.0})
    with pytest.raises(ValueError, match="differs in val"):
        train(CONFIG, episodes, other, out, console=QUIET)


@pytest.mark.parametrize("resume", [True, False])
def test_a_folder_of_something_else_is_no_place_to_train_in(resume, episodes, tmp_path):
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "mine").write_text("precious")
    with pytest.raises(FolderTaken, match=r"holds files of something else \(model\)"):
        train(CONFIG, episodes, episodes, tmp_path, resume=resume, console=QUIET)
    assert [path.name for path in tmp_path.rglob("*")] == ["model", "mine"]


@pytest.mark.slow
@pytest.mark.parametrize("part", ["run.json", "state"])
def test_a_damaged_run_is_named(part, uninterrupted, episodes, tmp_path):
    out = tmp_path / "damaged"
    shutil.copytree(uninterrupted[1], out)
    shutil.rmtree(out / "model")
    files = [out / part] if part == "run.json" else [file for file in (out / part).rglob("*") if file.is_file()]
    for file in files:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(ValueError, match=r"is damaged.*choose another folder"):
        train(CONFIG, episodes, episodes, out, console=QUIET)


def claimed(out, episodes):
    """The claim of a run, as `train` makes it."""
    digest = episodes.digest()
    return Claim(out, {"config": CONFIG.model_dump(mode="json"), "train": digest, "val": digest})


@pytest.mark.parametrize("settled", [{"batch": 10**9, "devices": 1}, {"batch": -1, "devices": 1}, {"batch": "16"}, 3])
def test_a_received_run_asks_for_no_more_than_there_is(settled, episodes, tmp_path):
    claimed(tmp_path / "run", episodes).note(settled=settled)
    with pytest.raises(ValueError, match=r"run\.json is damaged"):
        train(CONFIG, episodes, episodes, tmp_path / "run", console=QUIET)


def test_two_trainers_do_not_share_a_folder(episodes, tmp_path):
    with claimed(tmp_path / "run", episodes) as claim:
        claim.note(settled={"batch": 16, "devices": 1})
        for resume in (True, False):
            with pytest.raises(FolderTaken, match="another process is at work in"):
                train(CONFIG, episodes, episodes, claim.folder, resume=resume, console=QUIET)
        assert {path.name for path in claim.folder.iterdir()} == {"run.json", ".lock"}


def killed_once(reached, episodes, folder, out, **environ):
    """Train in a process that is killed as soon as `reached()` says so."""
    data, log = folder / "data.npz", folder / "log"
    stored = {f.name: getattr(episodes, f.name) for f in fields(Episodes)}
    np.savez(data, **stored | {"observation": episodes.view})
    command = [sys.executable, "-c", CHILD, str(data), CONFIG.model_dump_json(), str(out)]
    with log.open("wb") as file:
        child = subprocess.Popen(command, stdout=file, stderr=file, env=os.environ | {"JAX_PLATFORMS": "cpu"} | environ)
        try:
            deadline = time.monotonic() + 240
            while not reached() and child.poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)
        finally:
            child.kill()
            child.wait()
    assert reached() and child.returncode != 0, log.read_text(encoding="utf-8", errors="replace")


@pytest.mark.slow
def test_killed_and_resumed_equals_uninterrupted(uninterrupted, episodes, tmp_path):
    _, whole, _ = uninterrupted
    out = tmp_path / "killed"

    def saved():
        """Tell whether a save has been completed: its directory then has the step's number for a name."""
        return any(path.name.isdigit() for path in (out / "state").glob("*"))

    killed_once(saved, episodes, tmp_path, out)
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


@pytest.mark.slow
def test_both_kinds_of_flights_choose_the_best(uninterrupted, episodes):
    _, out, _ = uninterrupted
    sets = validation_sets(CONFIG, episodes)
    assert set(sets) == {"behaviour", "planner"}
    planned = episodes.flown_by(["excite"])
    assert set(planned.policies) == {"excite"} and len(planned) + len(episodes.flown_by(["excite"], others=True)) == 8
    for line in lines(out):
        parts = [line[f"{kind}/{part}"] for kind in sets for part in ("score", "energy")]
        assert line["score"] == pytest.approx(np.mean(parts))
    assert set(validation_sets(CONFIG, episodes.flown_by(["dock"]))) == {"behaviour"}
    assert episodes.flown_by(["nobody"]) is None


@pytest.mark.slow
def test_kept_checkpoints_are_models_to_compare(uninterrupted):
    _, out, _ = uninterrupted
    kept = sorted(int(path.name) for path in (out / "checkpoints").iterdir())
    assert kept == [250, 275, 300]
    names = [load_world_model(out / "checkpoints" / str(step)).name for step in kept]
    assert names == ["learned, step 250", "learned, step 275", "learned, step 300"]


@pytest.mark.slow
def test_tensorboard_reads_what_the_lines_say(uninterrupted):
    _, out, _ = uninterrupted
    (file,) = (out / "tensorboard").iterdir()
    data, told = file.read_bytes(), {}
    while data:  # a record: length, its checksum, an event, its checksum
        (length,) = struct.unpack("<Q", data[:8])
        event = Event.FromString(data[12 : 12 + length])
        told |= {(event.step, value.tag): value.simple_value for value in event.summary.value}
        data = data[16 + length :]
    written = {(line["step"], name): value for line in lines(out) for name, value in line.items() if name != "step"}
    assert told == pytest.approx(written, rel=1e-6)


def test_epochs_are_counted_in_steps():
    config = TrainConfig(epochs=16, teacher_epochs=4, batch="auto", rollouts=((1.0, 64),))
    settled = config.settled(windows=10_000, batch=64, devices=1)
    assert settled.steps == 2500 and settled.teacher == pytest.approx(0.25)
    assert (settled.batch, settled.epochs, settled.devices) == (64, None, 1)
    assert TrainConfig().settled(10_000, 32, 1).steps == TrainConfig().steps


@pytest.mark.parametrize("budget, batch", [(1100, 1), (1199, 1), (8_000, 64), (20_000, 128), (10**9, 4096)])
def test_the_largest_batch_that_fits_is_found_in_few_tries(budget, batch):
    tried = []

    def needs(batch):
        tried.append(batch)
        return 1000 + 100 * batch

    assert largest_batch(needs, budget, largest=4096) == batch
    assert len(tried) == len(set(tried)) <= 5
    with pytest.raises(ValueError, match="memory_gb must be at least"):
        largest_batch(needs, 1000)


def test_what_a_compiled_program_needs_is_told():
    needs = [
        compiled_bytes(jax.jit(lambda x: jnp.outer(x, x) @ x).lower(jax.ShapeDtypeStruct((n,), "float32")).compile())
        for n in (64, 1024)
    ]
    assert 2 * 4 * 64 <= needs[0] < needs[1] and needs[1] >= 4 * 1024**2, "the outer product is held"
    assert memory_budget(2.5) == 2_500_000_000
    with pytest.raises(ValueError, match="memory_gb must be given"):
        memory_budget(None)


def test_bfloat16_is_the_network_s_alone():
    config = CONFIG.model_copy(update={"precision": "bfloat16"}).settled(1000, 16, 1)
    state = jax.eval_shape(lambda: initial_state(config))
    statistics = STREAMS["kinematic"].skeleton(jnp.float32)
    model = LearnedWorldModel(config.model, Params(state.network, statistics))
    views, actions = (jax.ShapeDtypeStruct((1000, size), jnp.float32) for size in (13, 6))
    rows = {"state": views}, actions
    starts = jax.ShapeDtypeStruct((900,), jnp.int32)
    traced = train_chunk.trace(
        config, model, state.network, state.optimizer, statistics, rows, starts, state.step, depth=6, count=25
    )
    network, _, losses, norms = traced.out_info
    assert {leaf.dtype.name for leaf in jax.tree.leaves((network, losses, norms))} == {"float32"}
    products = [line for line in str(traced.jaxpr).splitlines() if "dot_general" in line]
    assert sum("bf16" in line for line in products) > len(products) / 2


@pytest.mark.slow
def test_two_devices_give_one_device_s_losses(uninterrupted, episodes, tmp_path):
    _, one, _ = uninterrupted
    out = tmp_path / "two"
    metrics = out / "metrics.jsonl"

    def logged():
        return metrics.exists() and metrics.read_bytes().count(b"\n") >= 4

    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    killed_once(logged, episodes, tmp_path, out, XLA_FLAGS=flags)
    assert json.loads((out / "run.json").read_text(encoding="utf-8"))["settled"] == {"batch": 16, "devices": 2}
    theirs = [json.loads(line) for line in metrics.read_text(encoding="utf-8").splitlines()[:4]]
    for ours, other in zip(lines(one)[:4], theirs, strict=True):
        assert other == pytest.approx(ours, rel=1e-3), "the same but for rounding, which training then amplifies"
    with pytest.raises(ValueError, match="devices must be at most 1, the local devices, got 2"):
        train(CONFIG, episodes, episodes, out, console=QUIET)


def test_data_that_does_not_fit_is_refused(episodes, tmp_path):
    with pytest.raises(ValueError, match="training episodes are too short for rollouts of 500 steps"):
        train(CONFIG.model_copy(update={"rollouts": ((1.0, 500),)}), episodes, episodes, tmp_path / "a")
    with pytest.raises(ValueError, match=r"validation episodes step by 0\.5 s, the model by 0\.25 s"):
        train(CONFIG, episodes, replace(episodes, dt=0.5), tmp_path / "a")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: replace(e, action=e.action * np.float32([1, 1, 1, 1, 1, 0])), "never vary torque z: nothing can be"),
        (lambda e: replace(e, observation={"state": e.view * np.float32([0, *[1] * 12])}), "never vary position x"),
        (lambda e: replace(e, observation={"state": np.where(np.arange(13) == 12, np.inf, e.view)}), "statistics, "),
    ],
)
def test_data_that_teach_nothing_are_refused_before_anything_is_written(change, message, episodes, tmp_path):
    with pytest.raises((ValueError, FloatingPointError), match=f"{message}.*record more flights"):
        train(CONFIG, change(episodes), episodes, tmp_path / "run", console=QUIET)
    assert not (tmp_path / "run").exists()


def test_fewer_windows_than_a_batch_are_refused(episodes, tmp_path):
    short = from_episodes(synthetic.episodes(3, 2, 3.5))
    with pytest.raises(ValueError, match=r"hold 12 windows, fewer than batch=16; record more flights"):
        train(CONFIG, short, episodes, tmp_path / "run", console=QUIET)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("policy", "seed", "told"),
    [
        ("orbit", 0, "predictions diverge in validation at step 0"),
        ("random", 1, r"the best weights score \S+ in validation, constant velocity \S+: not published"),
    ],
)
def test_a_single_flight_publishes_no_model(policy, seed, told, episodes, tmp_path):
    # As often as there are flights elsewhere, so that the programs are those of the other tests.
    flight = from_episodes(synthetic.episodes(seed, 8, 60.0, policies=(policy,))[:1] * 8)
    with pytest.raises((ValueError, FloatingPointError), match=f"{told}.*record more flights"):
        train(CONFIG, flight, episodes, tmp_path, console=QUIET)
    assert not (tmp_path / "model").exists()


def test_constant_velocity_is_the_bar(episodes):
    sets, model = validation_sets(CONFIG, episodes), ConstantVelocity(CONFIG.model.history_length)

    def score(windows):
        context = jnp.full(len(windows.action), model.history_length, jnp.int32)
        return np.sum(np.mean(window_errors(model, (), windows, context)[1], axis=(0, 1)) / np.asarray(SCORE_UNITS))

    assert coasting_score(CONFIG.model, sets) == pytest.approx(np.mean([score(each) for each in sets.values()]), 1e-5)


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
    assert [nano.rollout_at(step) for step in (0, 1799, 1800, 2999)] == [16, 16, 32, 32]
