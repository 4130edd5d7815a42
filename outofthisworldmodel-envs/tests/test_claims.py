"""Run folders: claimed, kept to one process, and input when they come from elsewhere."""

import json
import os
import signal
import subprocess
import sys

import pytest

from owm_envs.claims import Claim
from owm_envs.files import FolderTaken, publish, published

ASKED = {"seed": 0}
HOLDER = """
import sys
from owm_envs.claims import Claim
with Claim(sys.argv[1], {"seed": 0}) as claim:
    claim.note()
    print("at work", flush=True)
    sys.stdin.read()
"""


def test_a_folder_is_one_process_s_until_that_ends_however_it_ends(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "run")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "at work\n"
        waiting = Claim(tmp_path / "run", ASKED)
        with pytest.raises(FolderTaken, match=r"another process is at work in .*run: wait for it, or choose another"):
            waiting.__enter__()
        with pytest.raises(FolderTaken, match="differs in seed"):
            Claim(tmp_path / "run", {"seed": 1})
        holder.send_signal(signal.SIGKILL)
    with waiting as claim:
        assert claim.found == ASKED


def test_what_another_process_did_before_the_lock_was_ours_counts(tmp_path):
    early = Claim(tmp_path / "run", ASKED)
    with Claim(tmp_path / "run", {"seed": 1}) as other:
        other.note()
    with pytest.raises(FolderTaken, match="differs in seed"):
        early.__enter__()
    with Claim(tmp_path / "run", {"seed": 1}) as again:  # the refused one does not hold it
        again.note(done=True)


def test_nothing_is_left_where_nothing_came_of_it(tmp_path):
    with pytest.raises(ValueError, match="too little"), Claim(tmp_path / "run", ASKED):
        raise ValueError("too little to learn from")
    assert not list(tmp_path.iterdir())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".lock").touch()  # of one that was killed before it wrote anything
    with Claim(tmp_path / "run", ASKED) as claim:
        claim.note()


@pytest.mark.parametrize("where", ["x", "made/x"])
@pytest.mark.parametrize("target", ["../other", "../other/thesis", "/", "../nowhere", "ABSOLUTE"])
def test_no_link_leads_out_of_a_run(where, target, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis").write_text("years")
    Claim(tmp_path / "run", ASKED).note()
    link = tmp_path / "run" / where
    link.parent.mkdir(exist_ok=True)
    target = target.replace("ABSOLUTE", str(other))
    link.symlink_to(target if target.startswith("/") else "../" * where.count("/") + target)
    for replace in (False, True):
        with pytest.raises(FolderTaken, match=r"x is a link that leads out of its run"):
            Claim(tmp_path / "run", ASKED, made=["x", "made"], replace=replace)
    assert (other / "thesis").read_text() == "years"


def test_links_inside_a_run_and_to_it_are_followed(tmp_path):
    claim = Claim(tmp_path / "run", ASKED)
    claim.note()
    (tmp_path / "run" / "real").mkdir()
    (tmp_path / "run" / "link").symlink_to("real")
    (tmp_path / "short").symlink_to("run")
    assert Claim(tmp_path / "short", ASKED).folder == claim.folder


FORM = {"settled": {"batch": int, "devices": int}, "ports": {...: {"seconds": (int, float)}}}
DAMAGED = (
    *("", "{}", "[]", "null", "0", '"x"', "{", '{"seed": 0', "[" * 100_000, "\udcff", "[[1, 2]]"),
    *('{"seed": 0, "settled": 3}', '{"seed": 0, "settled": {}}', '{"seed": 0, "settled": {"batch": 3}}'),
    *('{"seed": 0, "settled": {"batch": true, "devices": 1}}', '{"seed": 0, "settled": {"batch": 1.5, "devices": 1}}'),
    *('{"seed": 0, "ports": []}', '{"seed": 0, "ports": {"a": 3}}', '{"seed": 0, "ports": {"a": {"seconds": "3"}}}'),
    *('{"seed": 0, "sha256": []}', '{"seed": 0, "sha256": {"x": 3}}', '{"seed": 0, "ports": {"a": {}}}'),
)


@pytest.mark.parametrize("text", DAMAGED)
def test_a_damaged_file_of_a_run_is_told_of_or_made_anew(text, tmp_path):
    (tmp_path / "run.json").write_bytes(text.encode(errors="surrogateescape"))
    (tmp_path / "made").touch(), (tmp_path / "mine").touch()
    with pytest.raises(FolderTaken, match=r"run\.json is damaged: choose another folder"):
        Claim(tmp_path, ASKED, facts=FORM)
    for how in ("renew", "replace"):
        claim = Claim(tmp_path, ASKED, made=["made"], facts=FORM, **{how: True})
        assert claim.found is None and not claim.holds("made") and (tmp_path / "made").exists()
    claim.note()
    assert not (tmp_path / "made").exists() and (tmp_path / "mine").exists()
    assert json.loads((tmp_path / "run.json").read_text()) == ASKED


def test_what_was_sealed_is_known_again_until_it_changes(tmp_path):
    claim = Claim(tmp_path / "run", ASKED)
    claim.note()
    (claim.folder / "set").mkdir()
    for name in ("a", "b", "set/a", "set/b", "set/.DS_Store"):
        (claim.folder / name).write_text(name)
    assert not claim.holds("a")
    claim.seal("a", "b", "set", done=True)
    claim.seal("gone")
    again = Claim(tmp_path / "run", ASKED)
    assert again.found["done"] and again.holds("a", "b", "set") and not again.holds("gone") and not again.holds("new")
    (claim.folder / "set" / ".DS_Store").write_text("the desktop's")
    assert Claim(tmp_path / "run", ASKED).holds("set")
    damages = {
        "a": lambda: os.replace(claim.folder / "b", claim.folder / "a"),  # whole, and another's
        "b": lambda: None,  # gone with it
        "set": lambda: (claim.folder / "set" / "a").rename(claim.folder / "set" / "c"),
    }
    for name, damage in damages.items():
        damage()
        assert not Claim(tmp_path / "run", ASKED).holds(name)
    assert not again.holds("b"), "however often it has been looked at"


@pytest.mark.parametrize("name", ["../other", "ABSOLUTE", "..", "a/../../other", "sub/thesis", "."])
def test_a_folder_that_is_being_published_moves_only_its_own(name, tmp_path):
    other, finished = tmp_path / "other", tmp_path / "set.partial"
    other.mkdir(), finished.mkdir()
    (other / "thesis").write_text("years")
    (finished / "data").touch()
    (finished / ".publishing").write_text("data\n" + name.replace("ABSOLUTE", str(other)))
    with pytest.raises(ValueError, match=r"refused|not in its folder"):
        publish(finished, tmp_path / "set")
    with pytest.raises(ValueError, match=r"refused|not in its folder"):
        published(finished)
    assert (other / "thesis").read_text() == "years" and (finished / "data").exists()
