"""What never ends is not read, and a hub that stays silent is given up: in a line that says so."""

import os
import threading
from pathlib import Path

import pytest
from local_hub import Fault

from owm.catalogue.checkpoint import load_world_model
from owm.checkpoint import NoCheckpointError
from owm.data.recordings import corpus_facts
from owm.study.matrix import read_matrix
from owm_envs import hub_client


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_no_file_without_an_end_is_read(tmp_path):
    pipe = tmp_path / "generation.json"
    os.mkfifo(pipe)
    # Whoever opens it gets an end at once, so that a test fails and does not hang.
    threading.Thread(target=lambda: open(pipe, "wb").close(), daemon=True).start()
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(ValueError, match="is a pipe or device, not a file"):
            read_matrix(path)
        with pytest.raises(NoCheckpointError, match="there is no checkpoint at"):
            load_world_model(path)
    assert set(corpus_facts(tmp_path)) == {"name"}


def test_a_model_of_a_silent_hub_is_given_up(local_hub, monkeypatch):
    monkeypatch.setattr(hub_client, "PATIENCE", 0.2)
    local_hub.publish("user/model", {"config.json": b"{}"})
    local_hub.faults.append(Fault("/api/models/", "silent"))
    with pytest.raises(NoCheckpointError, match="neither a folder nor found on the hub, which does not answer"):
        load_world_model("user/model")
