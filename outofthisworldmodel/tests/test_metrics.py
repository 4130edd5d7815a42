"""What a run tells elsewhere: the real Weights & Biases client, which keeps its files where it is not online."""

import pytest

from owm.commands import run as commands
from owm.training.config import TrainConfig
from owm.training.metrics import Metrics


def test_weights_and_biases_gets_the_lines_and_a_resumed_run_keeps_its_id(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    with Metrics(tmp_path, -1, project="docking", config={"seed": 3}) as metrics:
        metrics.write({"step": 25, "decode_loss": 0.5})
    with Metrics(tmp_path, 25, project="docking") as metrics:
        metrics.write({"step": 50, "decode_loss": 0.25})
    first, second = sorted((tmp_path / "wandb").glob("offline-run-*/*.wandb"))
    assert first.name == second.name
    assert b"decode_loss" in first.read_bytes() and b"docking" in first.read_bytes()
    assert len(metrics.file.read_text(encoding="utf-8").splitlines()) == 2


def test_a_run_needs_weights_and_biases_only_if_it_is_to_tell_them(tmp_path, monkeypatch):
    monkeypatch.setattr(commands, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"outofthisworldmodel\[wandb\]"):
        commands.train([tmp_path], tmp_path / "run", TrainConfig(), wandb="docking")
