"""What a run tells elsewhere: the real Weights & Biases client, which keeps its files where it is not online."""

import json
import os
import subprocess
import sys

import pytest

from owm.commands import run as commands
from owm.training.config import TrainConfig
from owm.training.metrics import Metrics, _known_id


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


LINE = '{"step": %d, "decode_loss": 0.5}\n'
TRUNCATED = """
import os, signal, sys
from pathlib import Path
from owm.training.metrics import _truncate
file, writes = Path(sys.argv[1]), {"os.rename", "os.remove", "open"}
before = file.read_bytes()
for step in range(100):
    file.write_bytes(before)
    child = os.fork()
    if not child:
        left = [step]
        def hook(event, args):
            if event in writes and (event != "open" or isinstance(args[1], str) and args[1] != "r"):
                left[0] -= 1
                if left[0] < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
        sys.addaudithook(hook)
        _truncate(file, 2)
        os._exit(0)
    killed = os.waitpid(child, 0)[1] == signal.SIGKILL
    kept = file.read_bytes()
    assert kept in (before, before[: len(before) // 3 * 2]), kept
    _truncate(file, 2)
    assert file.read_bytes() == before[: len(before) // 3 * 2]
    if not killed:
        break
print(step)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")
def test_no_kill_while_a_resumed_run_drops_lines_loses_the_others(tmp_path):
    file = tmp_path / "metrics.jsonl"
    file.write_text("".join(LINE % step for step in (1, 2, 3)), encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", TRUNCATED, str(file)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 2


@pytest.mark.parametrize("bad", ['{"step": 2', "[]", "null", '{"step": "2"}', '{"score": 3}', "\udcff", "", "[" * 9999])
def test_a_damaged_line_takes_no_other_with_it(bad, tmp_path):
    file = tmp_path / "metrics.jsonl"
    file.write_bytes(f"{bad}\n{LINE % 1}{bad}\n{LINE % 2}{LINE % 3}".encode(errors="surrogateescape"))
    with Metrics(tmp_path, 2) as metrics:
        metrics.write({"step": 3})
    assert [json.loads(line)["step"] for line in file.read_text(encoding="utf-8").splitlines()] == [1, 2, 3]


@pytest.mark.parametrize("found", ["../../other", "/tmp/x", "", "\udcff", "0123456789", "0123456\n"])
def test_an_id_that_is_none_of_ours_becomes_part_of_no_path(found, tmp_path):
    known = tmp_path / "id"
    assert _known_id(known) is None
    known.write_bytes(found.encode(errors="surrogateescape"))
    assert _known_id(known) is None
    known.write_text("0123abcd")
    assert _known_id(known) == "0123abcd"


def test_a_run_needs_weights_and_biases_only_if_it_is_to_tell_them(tmp_path, monkeypatch):
    monkeypatch.setattr(commands, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match='pip install "wandb'):
        commands.train([tmp_path], tmp_path / "run", TrainConfig(), wandb="docking")
