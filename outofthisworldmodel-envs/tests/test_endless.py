"""What never answers is given up, and what never ends is not read: in a line that says so."""

import os
import threading
from types import SimpleNamespace

import pytest
from local_hub import Fault

from owm_envs import hub, hub_client
from owm_envs.camera.sky import load_sky
from owm_envs.claims import Claim
from owm_envs.cli import main
from owm_envs.config import load_config
from owm_envs.datasets import open as open_dataset
from owm_envs.datasets.fetch import origin
from owm_envs.datasets.manifest import load_manifest
from owm_envs.datasets.merge import merge
from owm_envs.datasets.recipe import load_recipe
from owm_envs.files import MOST_BYTES, plain_file, read_text
from owm_envs.hub_client import Unreachable
from owm_envs.station.hull import load_hull
from owm_envs.station.mesh import load_triangles

FILES = {"data.parquet": b"large" * 99, "meta/info.json": b"small"}
SILENT = "does not answer: try again later"


@pytest.fixture
def impatient(local_hub, monkeypatch):
    """A hub on this machine, and a client that gives up at once."""
    monkeypatch.setattr(hub_client, "PATIENCE", 0.2)
    monkeypatch.setattr(hub_client, "SILENCE", 0.2)
    for name in ("HF_HUB_DOWNLOAD_TIMEOUT", "HF_HUB_ETAG_TIMEOUT", "DEFAULT_ETAG_TIMEOUT"):
        monkeypatch.setattr(f"huggingface_hub.constants.{name}", 0.2)
    monkeypatch.setattr("time.sleep", lambda seconds: None)  # between the client's own attempts
    return local_hub


@pytest.mark.parametrize("where", ["/api/datasets/user/set", "/tree/", "/resolve/", "/cdn/"])
def test_a_fetch_from_a_silent_hub_ends(impatient, where):
    impatient.publish("user/set", FILES, "dataset")
    impatient.faults.append(Fault(where, "silent"))
    with pytest.raises(Unreachable, match=SILENT):
        hub.fetch("user/set", kind="dataset")
    impatient.faults.clear()
    assert (hub.fetch("user/set", kind="dataset").folder / "data.parquet").read_bytes() == FILES["data.parquet"]


@pytest.mark.parametrize(
    "where", ["/repos/create", "/api/datasets/user/set", "/tree/", "/preupload/", "/objects/batch", "/lfs/", "/commit/",
              "/refs", "/tag/"]
)  # fmt: skip
def test_a_push_to_a_silent_hub_ends(impatient, where):
    repository = hub.Repository("user/set", "dataset", FILES, "m", tag="v3.0")
    impatient.faults.append(Fault(where, "silent"))
    with pytest.raises(Unreachable, match=SILENT):
        hub.push(repository)
    impatient.faults.clear()
    commit = hub.push(repository).commit
    assert impatient.repos["dataset", "user/set"].tags == {"v3.0": commit}


def test_a_download_that_stops_in_the_middle_of_a_file_ends(impatient):
    impatient.publish("user/set", FILES, "dataset")
    impatient.faults.append(Fault("/cdn/", "hold"))
    with pytest.raises(Unreachable, match=SILENT):
        hub.fetch("user/set", kind="dataset")


def test_the_command_says_that_the_hub_is_silent(impatient, tmp_path, capsys):
    impatient.faults.append(Fault("", "silent"))
    with pytest.raises(SystemExit) as stop:
        main(["download", "user/set", "--out", str(tmp_path / "set")])
    assert stop.value.code == 2 and SILENT in capsys.readouterr().err


@pytest.mark.parametrize("client", ["httpx", "requests"])
def test_limits_are_for_our_own_questions_alone(client):
    """Of the two kinds of clients that the hub's own stands on."""
    session = SimpleNamespace(send=lambda request, **given: given.get("timeout") or request.extensions["timeout"])

    def ask(method, **own):
        request = SimpleNamespace(method=method, extensions={"timeout": own})
        if client == "requests":
            del request.extensions
            return hub_client._limited(session).send(request, timeout=own.get("read"))
        return hub_client._limited(session).send(request)["read"]

    assert ask("HEAD", read=99) == 99
    with hub_client._patient():
        whole = lambda seconds: seconds if client == "httpx" else (10, seconds)
        assert ask("POST", read=None) == whole(60) and ask("HEAD", read=99) == whole(10)
        assert ask("GET", read=99) == 99, "one that the user has set"


READERS = {
    "config": lambda path: load_config(path),
    "hull": lambda path: load_config(hull=path),
    "hull, alone": load_hull,
    "recipe": load_recipe,
    "text": read_text,
    "mesh": load_triangles,
    "map": lambda path: load_sky(earth=str(path)),
}


def fifo(path):
    """A pipe that nobody reads: whoever opens it gets an end at once, so that a test fails and does not hang."""
    os.mkfifo(path)
    threading.Thread(target=lambda: open(path, "wb").close(), daemon=True).start()
    return path


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
@pytest.mark.parametrize("name", READERS)
def test_no_file_without_an_end_is_read(name, tmp_path):
    read = READERS[name]
    for path, kind in ((fifo(tmp_path / "pipe.toml"), "a pipe or device"), ("/dev/zero", "a pipe or device")):
        with pytest.raises(ValueError, match=rf"{path} is {kind}, not a file"):
            read(path)
    with pytest.raises(ValueError, match="is a folder, not a file"):
        read(tmp_path)
    huge = tmp_path / "huge.toml"
    with open(huge, "wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    with pytest.raises(ValueError, match=r"has 1,099,511,627,776 bytes; no such file has more than"):
        read(huge)


@pytest.mark.parametrize("number", [0, 1, True, 3.5, b"config.toml"])
def test_a_number_is_no_path(number):
    with pytest.raises(TypeError, match="config must be a DockingConfig, a mapping of its fields, or the path of a"):
        load_config(number)
    with pytest.raises(TypeError, match="a file must be given by its path"):
        plain_file(number)
    with pytest.raises((TypeError, ValueError)):
        load_config(hull=number)
    for read in (load_recipe, open_dataset, load_triangles):
        with pytest.raises((TypeError, ValueError)):
            read(number)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
@pytest.mark.parametrize(
    ("file", "read", "message"),
    [
        ("manifest.json", load_manifest, "is damaged"),
        ("generation.json", lambda root: merge([root], root / "out"), "is damaged"),
        ("run.json", lambda root: Claim(root, {}), "run.json is damaged"),
        ("source.json", origin, None),
        ("meta/info.json", open_dataset, "is not a LeRobot dataset"),
    ],
)
def test_no_pipe_in_a_folder_is_read(tmp_path, file, read, message):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    fifo(tmp_path / file)
    if message is None:
        assert read(tmp_path) is None
    else:
        with pytest.raises(ValueError, match=message):
            read(tmp_path)


def test_a_file_as_large_as_may_be_is_read(tmp_path):
    (tmp_path / "f").write_bytes(b"x" * 9)
    assert plain_file(tmp_path / "f", 9) == tmp_path / "f" and MOST_BYTES > 2**20
    with pytest.raises(ValueError, match="has 9 bytes; no such file has more than 8"):
        plain_file(tmp_path / "f", 8)
