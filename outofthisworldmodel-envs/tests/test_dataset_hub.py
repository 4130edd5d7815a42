"""Recorded datasets on a hub: pushed, fetched at a commit, checked; with the hub's real client and a hub of our own."""

import json
import os
import shlex
import shutil
import subprocess
import sys

import numpy as np
import pytest
from local_hub import TOKEN, Fault

from owm_envs import datasets, hub
from owm_envs.cli import main
from owm_envs.config import load_config
from owm_envs.datasets.fetch import download, local_dataset, origin
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.manifest import check_manifest, write_manifest
from owm_envs.datasets.publish import repositories
from owm_envs.files import FolderTaken
from owm_envs.hub_client import HubError

DATA = "data/chunk-000/file-000.parquet"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded") / "set"
    config = load_config(fidelity="iss", noise="cooperative", horizon=2.0, ports=["zvezda_aft", "unity_nadir"])
    generate(folder, config, Request(transitions=200, val_transitions=40, seed=7, episodes_per_batch=4))
    write_manifest(folder)
    return folder


@pytest.fixture
def run(recorded, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(recorded, tmp_path / "set")


def pushed(run, name="user/set", **how):
    return [hub.push(repository) for repository in repositories(run, name, **how)]


def assert_same_episodes(one, other):
    for split in ("train", "val"):
        for a, b in zip(datasets.read(one, split), datasets.read(other, split), strict=True):
            np.testing.assert_array_equal(a.true_state, b.true_state)
            np.testing.assert_array_equal(a.action, b.action)


def test_a_run_comes_back_as_it_was(local_hub, run, tmp_path, said_by):
    code, said = said_by(main, "push", run, "user/set")
    assert code == 0
    train, val = (local_hub.repos["dataset", f"user/set-{split}"] for split in ("train", "val"))
    assert [line.split(": ")[0].rpartition("/")[2] for line in said.splitlines()] == [train.head, val.head]
    for repo in (train, val):
        assert repo.tags == {"v3.0": repo.head}, "LeRobot looks for the tag"
        assert {"meta/info.json", DATA, "README.md", "config.toml", "generation.json"} <= set(repo.commits[repo.head])
    code, said = said_by(main, "download", "user/set", "--out", tmp_path / "back")
    assert code == 0, said
    assert train.head in said and val.head in said
    check_manifest(tmp_path / "back")
    assert (tmp_path / "back" / "train" / DATA).read_bytes() == (run / "train" / DATA).read_bytes()
    assert (tmp_path / "back" / "generation.json").read_bytes() == (run / "generation.json").read_bytes()
    assert_same_episodes(run, tmp_path / "back")
    assert origin(tmp_path / "back") == f"user/set-train@{train.head}, user/set-val@{val.head}"
    # What was fetched is a finished run like any other.
    again = pushed(tmp_path / "back")
    assert [push.sent for push in again] == [(), ()]


def test_a_second_push_sends_what_changed_and_moves_the_tag(local_hub, run):
    more = run / "train" / "data" / "chunk-000" / "file-001.parquet"
    more.write_bytes((run / "train" / DATA).read_bytes())
    write_manifest(run)
    first = pushed(run)
    sent = local_hub.sent()
    assert [push.commit for push in pushed(run)] == [push.commit for push in first], "nothing new, no commit"
    assert local_hub.sent() == sent
    (run / "train" / DATA).write_bytes((run / "val" / DATA).read_bytes())
    more.unlink()
    write_manifest(run)
    train, val = pushed(run)
    assert set(train.sent) >= {DATA, "manifest.json"} and not any(path.startswith("meta/") for path in train.sent)
    assert train.removed == ("data/chunk-000/file-001.parquet",) and val.sent == ()
    assert local_hub.repos["dataset", "user/set-train"].tags == {"v3.0": train.commit}


def test_together_both_splits_are_in_one_repository(local_hub, run, tmp_path):
    (push,) = pushed(run, together=True)
    files = local_hub.repos["dataset", "user/set"].commits[push.commit]
    assert {"train/meta/info.json", "val/meta/info.json", "manifest.json"} <= set(files)
    assert_same_episodes(run, "user/set")
    assert_same_episodes(run, f"user/set@{push.commit}")
    download("user/set", tmp_path / "back")
    check_manifest(tmp_path / "back")


def test_a_dry_run_asks_nothing_of_the_hub(local_hub, run, said_by):
    code, said = said_by(main, "push", run, "user/set", "--dry-run")
    assert code == 0 and local_hub.asked == []
    heads = [line for line in said.splitlines() if not line.startswith(" ")]
    assert [head.split(":")[0] for head in heads] == [
        "user/set-train (dataset, tag v3.0)",
        "user/set-val (dataset, tag v3.0)",
    ]
    size = f"{(run / 'train' / DATA).stat().st_size:,}"
    assert any(line.split() == [size, DATA] for line in said.splitlines())


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda run: (run / "train" / DATA).write_bytes(b"other"), f"{DATA} has 5 bytes"),
        (lambda run: (run / "val" / "meta" / "stats.json").unlink(), "stats.json is missing"),
        (lambda run: (run / "manifest.json").unlink(), "has no manifest.json"),
        (lambda run: run.rename(run.with_name("set.partial")), "is unfinished: run the same `owm-envs generate` again"),
        (lambda run: (run / "generation.json").write_text('{"seed": 1}'), "tells of no result"),
        (lambda run: (run / "train" / "link").symlink_to("/etc/hostname"), "link is no plain file"),
    ],
)
def test_an_unfinished_or_unverified_run_is_refused_in_a_line(local_hub, run, said_by, spoil, told):
    spoil(run)
    code, said = said_by(main, "push", run, "user/set")
    assert code == 2 and told in said
    assert local_hub.asked == []


@pytest.mark.parametrize("large", [True, False])
def test_a_dropped_connection_is_resumed(local_hub, run, tmp_path, large):
    pushed(run, together=True)
    where = DATA if large else "generation.json"
    local_hub.faults.append(Fault(where, "drop", times=1))
    download("user/set", tmp_path / "back")
    check_manifest(tmp_path / "back")
    assert local_hub.faults[0].times == 0, "it did break"


def test_a_wrong_hash_names_the_file_and_the_same_call_fetches_it_again(local_hub, run, tmp_path, said_by):
    pushed(run, together=True)
    local_hub.faults.append(Fault(f"train/{DATA}", "wrong"))
    arguments = ("download", "user/set", "--out", tmp_path / "back")
    code, said = said_by(main, *arguments)
    assert code == 2 and f"does not give train/{DATA} with the hash that it lists" in said
    assert not (tmp_path / "back").exists()
    local_hub.faults.clear()
    local_hub.asked.clear()
    assert said_by(main, *arguments)[0] == 0
    assert local_hub.fetched() == [f"train/{DATA}"], "the others were there"


def test_a_damaged_cache_is_mended(local_hub, run, tmp_path):
    pushed(run, together=True)
    damaged = local_dataset("user/set") / "train" / DATA
    damaged.write_bytes(bytes(damaged.stat().st_size))
    local_hub.asked.clear()
    download("user/set", tmp_path / "back")
    check_manifest(tmp_path / "back")
    assert local_hub.fetched() == [f"train/{DATA}"]


def test_what_differs_from_its_own_manifest_is_refused(local_hub, run, tmp_path):
    (push,) = pushed(run, together=True)
    repo = local_hub.repos["dataset", "user/set"]
    repo.add(repo.commits[push.commit] | {f"train/{DATA}": b"somebody else's"})
    with pytest.raises(ValueError, match=f"{DATA} has 15 bytes, manifest.json tells of"):
        download("user/set", tmp_path / "back")
    download("user/set", tmp_path / "back", revision="v3.0")
    check_manifest(tmp_path / "back")


@pytest.mark.parametrize("path", ["../evil.txt", "/etc/evil", "a\\..\\evil", "train/../../evil"])
def test_a_path_that_leads_out_of_the_folder_is_refused(local_hub, run, tmp_path, said_by, path):
    pushed(run, together=True)
    local_hub.hidden.append(path)
    code, said = said_by(main, "download", "user/set", "--out", tmp_path / "back")
    assert code == 2 and "may lead out of its folder: refused" in said
    assert not any("/resolve/" in line for line in local_hub.asked)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (Fault("", 401), "log in with `hf auth login`"),
        (Fault("", 403), "refuses that (403)"),
        (Fault("", 404, "RepoNotFound"), "user/set: the hub has no such repository"),
        (Fault("/revision/", 404, "RevisionNotFound"), "has no revision 'v9' of it"),
        (Fault("", 403, "GatedRepo"), "keeps it for those who asked for it"),
        (Fault("", 503), "cannot be reached: it answers 503, and the cache does not hold it at v9"),
    ],
)
def test_a_refusal_is_told_in_a_line(local_hub, tmp_path, said_by, fault, told):
    local_hub.faults.append(fault)
    code, said = said_by(main, "download", "user/set", "--revision", "v9", "--out", tmp_path / "back")
    assert code == 2 and told in said


def test_a_push_needs_a_token_and_never_shows_it(local_hub, run, monkeypatch, said_by):
    local_hub.closed = True
    code, said = said_by(main, "push", run, "user/set")
    assert code == 2 and "log in with `hf auth login`" in said
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    code, said = said_by(main, "push", run, "user/set", "--private")
    assert code == 0 and TOKEN not in said
    assert local_hub.repos["dataset", "user/set-train"].private
    local_hub.repos["dataset", "user/set-train"].private = False
    code, said = said_by(main, "push", run, "user/set", "--private")
    assert code == 2 and "shows it to everybody already" in said


def test_a_push_that_broke_goes_on_with_what_had_not_arrived(local_hub, run, monkeypatch):
    local_hub.faults.append(Fault("/commit/", 403))
    with pytest.raises(HubError, match="refuses that"):
        pushed(run, together=True)
    before = local_hub.sent()
    assert before, "the large files had been sent"
    local_hub.faults.clear()
    pushed(run, together=True)
    assert local_hub.sent() == before


def test_a_killed_download_goes_on(local_hub, run, tmp_path):
    pushed(run, together=True)
    out, partial = tmp_path / "back", tmp_path / "back.partial"
    folder = local_dataset("user/set")
    partial.mkdir()
    shutil.copy(folder / "source.json", partial)
    (partial / "val" / "meta").mkdir(parents=True)
    shutil.copy(folder / "val/meta/info.json", partial / "val/meta")
    kept = (partial / "val/meta/info.json").stat().st_ino
    (partial / "generation.json").write_text("half")
    download("user/set", out)
    check_manifest(out)
    assert (out / "val/meta/info.json").stat().st_ino == kept and not partial.exists()


def test_a_download_killed_in_the_middle_of_a_file_is_resumed(local_hub, run, tmp_path):
    pushed(run, together=True)
    local_hub.faults.append(Fault(f"val/{DATA}", "hold"))
    out = tmp_path / "back"
    words = [sys.executable, "-m", "owm_envs", "download", "user/set", "--out", str(out)]
    environment = os.environ | {"HF_ENDPOINT": local_hub.address, "HF_HOME": str(tmp_path / "home")}
    with subprocess.Popen(words, env=environment, stderr=subprocess.DEVNULL) as process:
        assert local_hub.held.wait(60)
        process.kill()
    assert not out.exists()
    local_hub.faults.clear()
    local_hub.asked.clear()
    subprocess.run(words, env=environment, check=True, capture_output=True)
    check_manifest(out)
    assert 0 < len(local_hub.fetched()) < len([file for file in out.rglob("*") if file.is_file()])


def test_a_folder_that_holds_something_else_is_refused(local_hub, run, tmp_path):
    (push,) = pushed(run, together=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    with pytest.raises(FolderTaken, match="holds files of something else"):
        download("user/set", tmp_path / "mine")
    download("user/set", tmp_path / "back")
    local_hub.repos["dataset", "user/set"].add({"meta/info.json": b"{}"})
    with pytest.raises(FolderTaken, match=r"holds another run, which differs in repositories\.user/set"):
        download("user/set", tmp_path / "back")
    said = []
    download("user/set", tmp_path / "back", push.commit, said.append)
    assert said == [f"{tmp_path / 'back'} holds it already, and is whole"]
    (tmp_path / "back" / "config.toml").write_text("")
    with pytest.raises(ValueError, match=r"config\.toml has 0 bytes"):
        download("user/set", tmp_path / "back", push.commit)


@pytest.mark.parametrize("how", ["offline", "unreachable"])
@pytest.mark.parametrize("together", [True, False])
def test_the_cache_serves_without_the_hub(local_hub, run, tmp_path, monkeypatch, how, together):
    pushes = pushed(run, together=together)
    datasets.read("user/set", "train")
    if how == "offline":
        monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    else:
        monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")  # where nobody answers
    assert_same_episodes(run, "user/set")
    commits = download("user/set", tmp_path / "back")
    assert list(commits.values()) == [push.commit for push in pushes]
    told = "neither a folder nor found on the hub, which cannot be reached.*, and the cache does not hold it"
    with pytest.raises(FileNotFoundError, match=rf"no dataset at user/other: {told}"):
        local_dataset("user/other")
    with pytest.raises(FileNotFoundError, match=f"{told} at v1"):
        local_dataset("user/set@v1")


def test_a_dataset_of_others_is_taken_by_the_hubs_hashes_alone(local_hub, run, tmp_path):
    files = {f.relative_to(run / "val").as_posix(): f.read_bytes() for f in (run / "val").rglob("*") if f.is_file()}
    local_hub.publish("sislaboratory/val", files | {".gitattributes": b""}, "dataset")
    said = []
    download("sislaboratory/val", tmp_path / "back", announce=said.append)
    assert said == ["sislaboratory/val brings no manifest.json: checked by the hub's own hashes only"]
    assert (
        len(datasets.read(tmp_path / "back"))
        == len(datasets.read(run, "val"))
        == len(datasets.read("sislaboratory/val"))
    )


@pytest.mark.parametrize("together", [True, False])
def test_the_card_says_what_the_run_says(run, together):
    from huggingface_hub import DatasetCard

    told = json.loads((run / "generation.json").read_text())
    for repository in repositories(run, "user/set", together=together):
        text = repository.files["README.md"].decode()
        data = DatasetCard(text).data
        assert data.license == "mit" and data.size_categories == ["n<1K"]
        (config,) = data.configs
        for entry in config["data_files"]:
            head, _, tail = entry["path"].partition("*")
            assert any(path.startswith(head) for path in repository.files if path.endswith(".parquet")), entry
            assert tail == "/*.parquet"
        assert len(config["data_files"]) == (2 if together else 1)
        # The numbers are those of the run and of its configuration.
        counts = told["result"]["train"]
        assert f"| train | {counts['episodes']} | {counts['transitions']} |" in text
        assert "| unity_nadir | 0 |" in text and "| held out |" in text, "held-out ports are val's alone"
        assert "Sensor noise: cooperative" in text and "| velocity | 0.002 m/s |" in text
        assert f"]({'flights.png'})" in text and repository.files["flights.png"][:4] == b"\x89PNG"
        assert len(repository.files["flights.png"]) < 300_000


def test_the_cards_command_records_the_same_run(run, monkeypatch, capsys):
    (repository,) = repositories(run, "user/set", together=True)
    text = repository.files["README.md"].decode()
    line = next(line for line in text.splitlines() if line.startswith("owm-envs generate"))
    arguments = shlex.split(line)[1:]
    arguments[arguments.index("--out") + 1] = str(run)
    monkeypatch.chdir(run)
    main(arguments)  # a claim is refused unless request and environment are the very same
    assert "complete already" in " ".join(capsys.readouterr().err.split())


WAYS = {
    "fetch": lambda: hub.fetch("user/set", kind="dataset"),
    "fetch a commit": lambda: hub.fetch("user/set", "0" * 40, kind="dataset"),
    "read": lambda: datasets.read("user/set", "train"),
    "push": lambda: hub.push(hub.Repository("user/set", "dataset", {}, "m")),
    "cache": hub.cache,
    "address": lambda: hub.address("user/set", "dataset"),
}


@pytest.mark.parametrize("way", WAYS)
def test_without_the_client_every_way_to_the_hub_says_what_is_missing(way, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(ImportError, match="the hub needs its client: "):
        WAYS[way]()


def test_the_commands_are_quick_to_explain(tmp_path):
    program = "import sys; from owm_envs.cli import main\ntry: main(['push', '--help'])\nexcept SystemExit: pass\n"
    program += "print(sorted({'jax', 'pyarrow', 'huggingface_hub', 'cv2'} & set(sys.modules)), file=sys.stderr)"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert told.stderr.strip() == "[]"
