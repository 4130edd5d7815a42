"""The PPO baseline under the real Stable-Baselines3. Run by `nox -s sb3`, which brings it."""

import csv
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from rich.console import Console

from owm.baselines.ppo import train
from owm.baselines.ppo.config import PRESETS, PPOConfig
from owm.baselines.ppo.features import field_features
from owm.baselines.ppo.policy import PPOPolicy
from owm.baselines.ppo.train import _export, _restore_statistics, _resumed, train_ppo
from owm.baselines.ppo.vec_env import make_env
from owm.catalogue.policies import kind_of, load_policy
from owm.checkpoint import CheckpointError
from owm_envs.claims import Claim
from owm_envs.config import load_config
from owm_envs.field import load_field
from owm_envs.files import FolderTaken
from owm_envs.station import goal_poses

QUICK = PRESETS["ci"].model_copy(update={"env": "iss-hcw", "observe_field": True})
QUIET = Console(quiet=True)
CHILD = """
import sys
from pathlib import Path
from owm.baselines.ppo.config import PPOConfig
from owm.baselines.ppo.train import train_ppo
train_ppo(PPOConfig.model_validate_json(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("ppo") / "run"
    best = train_ppo(QUICK, out, QUIET)
    return out, best


def lines(out):
    return [json.loads(text) for text in (out / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]


def test_the_paper_s_table_is_the_default():
    config = PPOConfig()
    assert (config.steps, config.envs, config.learning_rate, config.gamma) == (25_000_000, 32, 2.2e-4, 0.997)
    assert (config.network, config.batch, config.rollout, config.gae_lambda) == ((256,) * 3, 1024, 1024, 0.945)
    assert (config.clip, config.epochs, config.value_weight) == (0.1, 20, 0.67)
    assert (config.entropy_weight, config.target_kl) == (1e-3, 0.02)
    venv = make_env(config.model_copy(update={"env": "iss-hcw"}), 1, 0, training=True)
    task = venv.get_attr("config")[0]
    assert task.reward.dock == 1000 and task.decision_dt == 1.0 and task.reset.radius_max == 125.0
    with pytest.raises(ValueError, match="batch must not exceed"):
        PPOConfig(batch=65_536)


def test_a_run_leaves_curve_metrics_and_its_best_policy(run):
    out, best = run
    log = lines(out)
    assert [line["step"] for line in log] == [0, 1024, 2048]
    assert best == max(log[1:], key=lambda line: line["validation/return"])
    assert best["steps_per_second"] > 0 and (out / "curve.png").read_bytes()[:4] == b"\x89PNG"
    with (out / "curve.csv").open(encoding="utf-8") as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [0, 1024, 2048]
    about = json.loads((out / "policy" / "config.json").read_text(encoding="utf-8"))["about"]
    assert about["validation_return"] == max(line["validation/return"] for line in log[1:])
    assert kind_of(str(out)) == "ppo-field"


def test_the_exported_actor_is_stable_baselines3_s(run, tmp_path):
    out, _ = run
    (save,) = (out / "state").iterdir()
    venv = make_env(QUICK, 5, 7, training=False)
    model = _resumed(QUICK.model_copy(update={"batch": 128}), venv, save)
    assert model.num_timesteps == int(save.name)
    _restore_statistics(venv, json.loads((save / "statistics.json").read_text(encoding="utf-8")))
    _export(model, venv, tmp_path / "policy", QUICK, {"step": 0, "validation/return": 0.0})
    config = venv.get_attr("config")[0]
    ours = PPOPolicy(tmp_path / "policy", config, 5, load_field())
    observation = venv.reset()
    ours.reset(ports=[info["port"] for info in venv.unwrapped.reset_infos])
    raw = venv.get_original_obs()
    for _ in range(5):
        expected = model.predict(observation, deterministic=True)[0]
        actions, _ = ours.predict(raw[:, :-4])
        np.testing.assert_allclose(actions, expected, atol=2e-5)
        observation = venv.step(expected)[0]
        raw = venv.get_original_obs()


def test_actions_are_held_for_a_second_in_a_4_hz_flight(run):
    out, _ = run
    config = load_config(fidelity="iss-hcw", noise="cooperative", steps_per_action=5, horizon=2.0)
    policy = load_policy(str(out), config, 2)
    policy.reset(np.ones(2, bool), np.array([0, 3]))
    observation = np.random.default_rng(0).normal(size=(9, 2, 25)).astype(np.float32) * 10
    flown = [policy.predict(seen)[0] for seen in observation]
    for start in (0, 4):
        for later in flown[start : start + 4]:
            np.testing.assert_array_equal(later, flown[start])
    assert not np.array_equal(flown[0], flown[4]) and np.abs(flown[0]).max() > 1.0
    policy.reset(np.array([True, False]), np.array([1, 3]))
    fresh = policy.predict(observation[3])[0]
    assert not np.array_equal(fresh[0], flown[8][0]) and np.array_equal(fresh[1], flown[8][1])
    with pytest.raises(ValueError, match="must divide"):
        load_policy(str(out), load_config(fidelity="iss-hcw", steps_per_action=6))
    with pytest.raises(ValueError, match="the environment shows 27"):
        load_policy(str(out), load_config(fidelity="iss-numerical", steps_per_action=5))


def test_the_field_is_observed_at_the_measured_position_of_each_slot_s_port():
    venv = make_env(QUICK.model_copy(update={"noise": "none"}), 6, 3, training=False)
    venv.reset()
    raw, field = venv.get_original_obs(), load_field()
    ports = np.array([info["port"] for info in venv.unwrapped.reset_infos], np.int32)
    true = np.stack([info["true_state"] for info in venv.unwrapped.reset_infos])
    np.testing.assert_allclose(raw[:, -4:], field_features(field, ports, true[:, :3].astype(np.float32)), atol=1e-4)
    distance = np.linalg.norm(true[:, :3] - goal_poses()[ports, :3], axis=1)
    assert (raw[:, -1] * 225.0 > 0.99 * distance).all(), "no way is shorter than the straight one"


def test_the_minutes_before_the_first_validation_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(train, "_SAVE_EVERY", 0.0)
    validate, calls = train._validate, []

    def killed(*given):
        calls.append(given)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return validate(*given)

    config = QUICK.model_copy(update={"validate_every": 2, "steps": 1000})  # fewer than were saved when it was killed
    monkeypatch.setattr(train, "_validate", killed)
    with pytest.raises(KeyboardInterrupt):
        train_ppo(config, tmp_path / "run", QUIET)
    assert [path.name for path in (tmp_path / "run" / "state").iterdir()] == ["1024"]
    train_ppo(config, tmp_path / "run", QUIET)
    assert [line["step"] for line in lines(tmp_path / "run")] == [0, 2048]


def test_a_killed_run_goes_on_and_another_is_refused(run, tmp_path):
    out = tmp_path / "killed"
    config = QUICK.model_copy(update={"steps": 10**6})
    command = [sys.executable, "-c", CHILD, config.model_dump_json(), str(out)]
    child = subprocess.Popen(command, env=os.environ, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline and child.poll() is None:
        if any(path.name.isdigit() for path in (out / "state").glob("*")):
            break
        time.sleep(0.02)
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    reached = max(int(path.name) for path in (out / "state").iterdir() if path.name.isdigit())
    train_ppo(QUICK.model_copy(update={"steps": reached + 1024}), out, QUIET)
    steps = [line["step"] for line in lines(out)]
    assert steps == list(range(0, reached + 1025, 1024))
    with pytest.raises(ValueError, match="differs in gamma"):
        train_ppo(QUICK.model_copy(update={"gamma": 0.9}), out, QUIET)


class Executed:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (os.fspath(self.folder),)


def test_a_received_run_executes_nothing_and_is_one_trainer_s(run, tmp_path):
    out = tmp_path / "received"
    shutil.copytree(run[0], out)
    further = QUICK.model_copy(update={"steps": QUICK.steps + 1024})
    with (
        Claim(out, QUICK.model_dump(mode="json", exclude={"steps"})),
        pytest.raises(FolderTaken, match="another process is at work in"),
    ):
        train_ppo(further, out, QUIET)
    (save,) = (out / "state").iterdir()
    (save / "parameters.pt").write_bytes(pickle.dumps(Executed(tmp_path / "executed")))
    with pytest.raises(
        CheckpointError, match=r"parameters\.pt is damaged, or none of ours: remove .*, and train again"
    ):
        train_ppo(further, out, QUIET)
    assert not (tmp_path / "executed").exists()


def test_a_damaged_policy_is_refused(run, tmp_path):
    shutil.copytree(run[0] / "policy", tmp_path / "policy")
    (tmp_path / "policy" / "weights.safetensors").write_bytes(b"cut")
    config = load_config(fidelity="iss-hcw", steps_per_action=5)
    with pytest.raises(CheckpointError, match=r"weights\.safetensors is damaged"):
        load_policy(str(tmp_path / "policy"), config)
