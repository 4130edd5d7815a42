"""A run's manifest: lists what is there, and names the first thing that differs from it."""

import json

import pytest

from owm_envs.datasets.manifest import MANIFEST, Entry, check_manifest, load_manifest, write_manifest


@pytest.fixture
def run(tmp_path):
    for name, text in {"train/data/b.bin": "bb", "train/data/a.bin": "a", "config.toml": ""}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "train" / ".a.bin.123.partial").write_text("half")
    (tmp_path / ".cache").mkdir()
    (tmp_path / ".cache" / "note").write_text("")
    write_manifest(tmp_path)
    return tmp_path


def test_a_manifest_lists_plain_files_sorted_and_holds(run):
    assert list(load_manifest(run)) == ["config.toml", "train/data/a.bin", "train/data/b.bin"]
    # SHA-256 of "a": FIPS 180 test vectors as printed by sha256sum
    digest = "ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb"
    assert load_manifest(run)["train/data/a.bin"] == Entry(digest, 1)
    check_manifest(run)
    before = (run / MANIFEST).read_bytes()
    write_manifest(run)
    assert (run / MANIFEST).read_bytes() == before, "it does not list itself"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda run: (run / "config.toml").unlink(), "config.toml is missing"),
        (lambda run: (run / "more.txt").write_text(""), "more.txt is not listed"),
        (lambda run: (run / "train/data/b.bin").write_text("b"), "b.bin has 1 bytes, manifest.json tells of 2"),
        (lambda run: (run / "train/data/b.bin").write_text("bc"), "b.bin does not match its SHA-256"),
        (lambda run: (run / MANIFEST).write_text("[]"), "manifest.json is damaged"),
        (lambda run: (run / "train/link").symlink_to(run / "config.toml"), "link is no plain file"),
        (lambda run: (run / MANIFEST).unlink(), "has no manifest.json"),
    ],
)
def test_the_first_difference_is_named(run, change, told):
    change(run)
    with pytest.raises((ValueError, FileNotFoundError), match=told):
        check_manifest(run)


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", "a\\x", "C:x", "", "a//b", "./a"])
def test_a_path_that_may_leave_the_folder_is_refused(run, name):
    listed = json.loads((run / MANIFEST).read_text())
    listed["files"][name] = {"sha256": "0" * 64, "bytes": 0}
    (run / MANIFEST).write_text(json.dumps(listed))
    with pytest.raises(ValueError, match="may lead out of its folder"):
        load_manifest(run)
