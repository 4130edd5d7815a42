"""World models by hub id, from a server on this machine that speaks the hub's protocol."""

import json
import threading
from hashlib import sha1
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import jax.numpy as jnp
import numpy as np
import pytest

from owm.baselines.least_squares import LeastSquares
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.hub import CONTENTS, checkpoint_folder, is_repository, local_folder
from owm.catalogue.policies import kind_of, load_policy
from owm.catalogue.predictors import evaluate_prediction
from owm.checkpoint import CheckpointError, save_world_model
from owm.model.config import ModelConfig
from owm.motion.linear import LinearMap
from owm_envs.config import load_config

constants = pytest.importorskip("huggingface_hub.constants")
COMMIT = "c" * 40


@pytest.fixture
def serve(tmp_path, monkeypatch):
    """Publish a folder as `user/model`; return the paths that were asked for."""
    asked = []

    def start(folder):
        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                asked.append(self.path)
                path = self.path.partition("?")[0]
                names = sorted(file.name for file in folder.iterdir())
                if path == "/api/models/user/model/revision/main":
                    siblings = [{"rfilename": name} for name in names]
                    return self._send(json.dumps({"id": "user/model", "sha": COMMIT, "siblings": siblings}).encode())
                if path == f"/api/models/user/model/tree/{COMMIT}":
                    sizes = {name: (folder / name).stat().st_size for name in names}
                    entries = [{"type": "file", "path": k, "size": v, "oid": "0" * 40} for k, v in sizes.items()]
                    return self._send(json.dumps(entries).encode())
                prefix = f"/user/model/resolve/{COMMIT}/"
                if path.startswith(prefix) and path.removeprefix(prefix) in names:
                    return self._send((folder / path.removeprefix(prefix)).read_bytes())
                self._send(b'{"error": "Repository not found"}', 404)

            do_HEAD = do_GET

            def _send(self, content, status=200):
                self.send_response(status)
                self.send_header("Content-Length", str(len(content)))
                self.send_header("ETag", f'"{sha1(content).hexdigest()}"')
                self.send_header("X-Repo-Commit", COMMIT)
                if status == 404:
                    self.send_header("X-Error-Code", "RepoNotFound")
                self.end_headers()
                if self.command == "GET":
                    self.wfile.write(content)

            def log_message(self, *_):
                pass

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        # The client reads its settings when it is imported; these are where it keeps them.
        address = f"http://127.0.0.1:{server.server_port}"
        monkeypatch.setattr(constants, "ENDPOINT", address)
        template = address + "/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
        return asked

    servers = []
    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture
def published(tmp_path):
    action = np.random.default_rng(0).normal(size=(6, 6)).astype(np.float32)
    zeros = (jnp.zeros(shape, jnp.float32) for shape in ((6,), (3, 6), (3, 15)))
    linear = LinearMap(jnp.asarray(action), *zeros)
    folder = save_world_model(LeastSquares(linear), tmp_path / "published")
    (folder / "pickled.pkl").write_bytes(b"never fetched")
    return folder


def test_a_model_comes_by_id_and_nothing_but_its_files(serve, published):
    asked = serve(published)
    model, local = load_world_model("user/model"), load_world_model(published)
    np.testing.assert_array_equal(model.params.action, local.params.action)
    fetched = {path.rpartition("/")[2] for path in asked if "/resolve/" in path}
    assert fetched == set(CONTENTS)
    asked.clear()
    load_world_model(f"user/model@{COMMIT}")
    assert not any("/resolve/" in path for path in asked), "what is there is not fetched again"


def test_what_does_not_match_is_refused(serve, published):
    serve(published)
    with pytest.raises(CheckpointError, match="expected a learned model, found 'least_squares'"):
        load_world_model("user/model", expect=ModelConfig())
    with pytest.raises(FileNotFoundError, match=r"'user/other': neither a folder nor found on the hub"):
        load_world_model("user/other")


def test_damaged_files_are_refused(serve, published):
    (published / "weights.safetensors").write_bytes(b"other weights")
    serve(published)
    with pytest.raises(CheckpointError, match=r"weights\.safetensors does not match config\.json"):
        load_world_model("user/model")


def test_a_hub_that_cannot_be_reached_is_told_with_both_readings(monkeypatch, tmp_path):
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:9")  # where nobody answers
    told = "there is no checkpoint at 'user/model': neither a folder nor found on the hub, which cannot be reached"
    for lookup in (load_world_model, kind_of, lambda name: evaluate_prediction([name], [tmp_path])):
        with pytest.raises(FileNotFoundError) as error:
            lookup("user/model")
        assert str(error.value) == told


def test_every_door_takes_the_same_and_says_the_same(published, monkeypatch):
    run = published.parent
    published.rename(run / "model")
    assert load_world_model(run) == load_world_model(run / "model")
    monkeypatch.chdir(run)
    config = load_config(fidelity="iss")
    for source, told in (
        ("runs/mine", "there is no checkpoint at 'runs/mine'"),
        ("mine", "unknown .* 'mine'; known: "),
    ):
        for lookup in (load_world_model, kind_of, lambda name: load_policy(name, config), checkpoint_folder):
            with pytest.raises(ValueError, match=told):
                lookup(source)


def test_paths_stay_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not is_repository("runs/mine"), "where commands write to"
    (tmp_path / "runs").mkdir()
    assert is_repository("user/model") and is_repository("user/model@v1.0")
    for path in ("runs/typo", "a/b/c", "/user/model", "./model", "model", "../user/model"):
        assert not is_repository(path) and local_folder(path).as_posix() == (path.removeprefix("./"))
