"""World models and what they train on by hub id, from a hub on this machine, with the hub's real client."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from local_hub import Fault

from owm.baselines.least_squares import LeastSquares
from owm.baselines.ppo.policy import Observed, save_policy
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.hub import CARD, checkpoint_folder, download, local_folder, repository
from owm.catalogue.policies import content_digest, kind_of, load_policy
from owm.catalogue.predictors import evaluate_prediction
from owm.checkpoint import FILES, CheckpointError, save_world_model
from owm.cli import main
from owm.data.recordings import training_episodes
from owm.model.config import ModelConfig
from owm.motion.linear import LinearMap
from owm_envs import hub
from owm_envs.config import load_config
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.manifest import write_manifest
from owm_envs.datasets.publish import repositories
from owm_envs.files import FolderTaken


@pytest.fixture
def published(tmp_path):
    action = np.random.default_rng(0).normal(size=(6, 6)).astype(np.float32)
    zeros = (jnp.zeros(shape, jnp.float32) for shape in ((6,), (3, 6), (3, 15)))
    linear = LinearMap(jnp.asarray(action), *zeros)
    folder = save_world_model(LeastSquares(linear), tmp_path / "published")
    (folder / "pickled.pkl").write_bytes(b"never fetched")
    return folder


@pytest.fixture
def serve(local_hub):
    """Publish a folder as `user/model`; return the hub, and the commit."""

    def publish(folder):
        return local_hub, local_hub.publish("user/model", {file.name: file.read_bytes() for file in folder.iterdir()})

    return publish


def test_a_model_comes_by_id_and_nothing_but_its_files(serve, published):
    server, commit = serve(published)
    model, local = load_world_model("user/model"), load_world_model(published)
    np.testing.assert_array_equal(model.params.action, local.params.action)
    assert set(server.fetched()) == set(FILES)
    server.asked.clear()
    load_world_model(f"user/model@{commit}")
    assert server.asked == [], "a commit that is there is not asked for again"


def test_what_does_not_match_is_refused(serve, published):
    serve(published)
    with pytest.raises(CheckpointError, match="expected a learned model, found 'least_squares'"):
        load_world_model("user/model", expect=ModelConfig())
    with pytest.raises(FileNotFoundError, match=r"'user/other': neither a folder nor found on the hub, which has no"):
        load_world_model("user/other")


def test_damaged_files_are_refused(serve, published, tmp_path):
    (published / "weights.safetensors").write_bytes(b"other weights")
    serve(published)
    with pytest.raises(CheckpointError, match=r"weights\.safetensors is damaged"):
        load_world_model("user/model")
    with pytest.raises(CheckpointError, match=r"weights\.safetensors is damaged"):
        download("user/model", tmp_path / "back")
    with pytest.raises(CheckpointError, match=r"weights\.safetensors is damaged"):
        repository(published, "user/model")


def test_a_hub_that_cannot_be_reached_is_told_with_both_readings(local_hub, monkeypatch, tmp_path):
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")  # where nobody answers
    told = (
        "there is no checkpoint at 'user/model': neither a folder nor found on the hub, which cannot be reached, and "
        "the cache does not hold it"
    )
    for lookup in (load_world_model, kind_of, lambda name: evaluate_prediction([name], [tmp_path])):
        with pytest.raises(FileNotFoundError) as error:
            lookup("user/model")
        assert str(error.value) == told


def test_a_checkpoint_goes_there_and_back(local_hub, published, tmp_path, said_by):
    code, said = said_by(main, "push", published, "user/model", "--dry-run")
    assert code == 0 and said.startswith("user/model (model): 4 files") and local_hub.asked == []
    code, said = said_by(main, "push", published, "user/model")
    repo = local_hub.repos["model", "user/model"]
    assert code == 0 and said == f"{local_hub.address}/user/model/tree/{repo.head}: 4 files sent"
    assert set(repo.commits[repo.head]) == {*FILES, CARD, ".gitattributes"}
    assert said_by(main, "push", published, "user/model")[1].endswith("nothing new to send")
    code, said = said_by(main, "download", "user/model", "--out", tmp_path / "back")
    assert code == 0 and said.endswith(f"user/model at {repo.head}")
    for name in FILES:
        assert (tmp_path / "back" / name).read_bytes() == (published / name).read_bytes()
    load_world_model(tmp_path / "back")
    (published / "pickled.pkl").unlink()
    assert content_digest(str(tmp_path / "back")) == content_digest("user/model") == content_digest(str(published))
    repo.add({})
    code, said = said_by(main, "download", "user/model", "--out", tmp_path / "back")
    assert code == 2 and "no checkpoint" in said
    with pytest.raises(FolderTaken):
        download(f"user/model@{list(repo.commits)[1]}", published)


def test_the_card_says_what_the_checkpoint_says(published):
    from huggingface_hub import ModelCard

    run = published.parent / "run"
    run.mkdir()
    corpus = {"name": "user/set@abc", "fidelity": "iss", "noise": {"position": 0.05, "velocity": 0.002}}
    about = {"corpus": [corpus], "settled": {"steps": 30, "seed": 7}, "score": 0.25, "step": 30}
    (published / "pickled.pkl").unlink()
    save_world_model(load_world_model(published), published, about=about)
    (run / "metrics.jsonl").write_text(
        '{"step": 20, "validation/score": 0.3}\n{"step": 30, "validation/score": 0.25}\n'
    )
    published.rename(run / "model")
    card = ModelCard(repository(run, "user/model").files[CARD].decode())
    assert card.data.license == "mit" and card.data.library_name == "outofthisworldmodel"
    for words in (
        "| user/set@abc | iss | 0.05 m | 0.002 m/s |",
        "Trained with seed 7:\n`steps = 30`.",
        "Validation score 0.2500 at step 30",
        "| validation/score | 0.2500 |",
        'owm.load_world_model("user/model")',
    ):
        assert words in card.text


def test_a_policy_is_pushed_alike_and_a_run_without_a_model_is_refused(local_hub, tmp_path, said_by):
    observed = Observed(env="iss", observe_field=False, observation=["x", "y"])
    weights = {"mean": np.zeros(2), "variance": np.ones(2), "weight.0": np.zeros((6, 2)), "bias.0": np.zeros(6)}
    save_policy(tmp_path / "ppo" / "policy", weights, observed, {})
    assert said_by(main, "push", tmp_path / "ppo", "user/policy")[0] == 0
    assert kind_of("user/policy") == "ppo"
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    code, said = said_by(main, "push", tmp_path / "run", "user/model")
    assert code == 2 and "has no model yet: the same `owm train` again finishes it" in said


def test_a_refusal_is_told_in_a_line(local_hub, published, tmp_path, said_by):
    local_hub.faults.append(Fault("", 401))
    for arguments in (("push", published, "user/model"), ("download", "user/model", "--out", tmp_path / "back")):
        code, said = said_by(main, *arguments)
        assert code == 2 and "log in with `hf auth login`" in said


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
    assert hub.parse("runs/mine") is None, "where commands write to"
    (tmp_path / "runs").mkdir()
    assert hub.parse("user/model") == ("user/model", None) and hub.parse("user/model@v1.0") == ("user/model", "v1.0")
    for path in ("runs/typo", "a/b/c", "/user/model", "./model", "model", "../user/model"):
        assert hub.parse(path) is None and local_folder(path).as_posix() == (path.removeprefix("./"))


@pytest.mark.slow
def test_a_model_is_trained_on_a_dataset_of_the_hub(local_hub, tmp_path, monkeypatch):
    run = tmp_path / "set"
    generate(run, load_config(fidelity="iss", noise="cooperative", horizon=12.0), Request(2400, 200, 3, 0.5, 24))
    write_manifest(run)
    train, val = (hub.push(repository) for repository in repositories(run, "user/set"))
    monkeypatch.chdir(tmp_path)
    one, other = training_episodes("user/set")[0], training_episodes(run)[0]
    assert one.steps == other.steps and (one.view == other.view).all()
    small = "--width 8 --heads 2 --window 4 --head-width 8 --history-length 4 --rollouts 1.0 2 --validation-horizon 4"
    options = f"--preset ci --steps 2 --batch 2 --validation-windows 4 --chunk 2 --save-every 2 {small}"
    main(["train", "--data", "user/set", "--out", str(tmp_path / "mine"), *options.split()])
    (corpus,) = json.loads((tmp_path / "mine/model/config.json").read_text())["about"]["corpus"]
    assert corpus["name"] == f"user/set-train@{train.commit}, user/set-val@{val.commit}"
    assert corpus["fidelity"] == "iss" and corpus["noise"]["position"] == 0.05
