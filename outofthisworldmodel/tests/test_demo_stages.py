import json

import pytest

from owm.stages import Stages, peak_memory, source_digest
from owm_envs.files import FolderTaken, write_atomically


def work(folder, log, name):
    def run():
        log.append(name)
        (folder / name).write_text(name)
        return {"made": name}

    return run


def test_a_killed_run_goes_on_and_a_finished_one_is_done(tmp_path):
    folder, log = tmp_path / "run", []

    def killed():
        (folder / "half").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), Stages(folder, {"seed": 0}) as first:
        assert first.run("a", ["a"], work(folder, log, "a")) == {"made": "a"}
        first.run("b", ["b"], killed)

    with Stages(folder, {"seed": 0}) as second:
        assert second.run("a", ["a"], work(folder, log, "a")) == {"made": "a"}
        assert second.run("b", ["b"], work(folder, log, "b")) == {"made": "b"}
    assert log == ["a", "b"] and second.resumed == ["a"] and set(second.seconds) == {"a", "b"}

    with Stages(folder, {"seed": 0}) as third:
        third.run("a", ["a"], work(folder, log, "a")), third.run("b", ["b"], work(folder, log, "b"))
    assert log == ["a", "b"] and third.resumed == ["a", "b"]


def test_other_settings_are_refused_and_other_code_or_fresh_starts_over(tmp_path):
    folder, log = tmp_path / "run", []

    def start(*asked, fresh=False):
        with Stages(folder, *asked, made=["a"], fresh=fresh) as stages:
            stages.run("a", ["a"], work(folder, log, "a"))

    start({"seed": 0}, "1.0")
    (folder / "mine").write_text("kept")
    with pytest.raises(FolderTaken, match=r"run holds another run, which differs in seed: choose .* --fresh"):
        Stages(folder, {"seed": 1}, "1.0")
    assert (folder / "a").exists()
    for number, again in enumerate([({"seed": 0}, "1.1", False), ({"seed": 0}, "1.1", True), ({"seed": 1}, "", True)]):
        *asked, fresh = again
        start(*asked, fresh=fresh)
        assert log == ["a"] * (number + 2) and (folder / "mine").read_text() == "kept"


@pytest.mark.parametrize("output", ["gone", "changed", "a folder", "note", "facts"])
def test_a_stage_whose_results_were_damaged_is_done_again(output, tmp_path):
    folder, log = tmp_path / "run", []

    def start():
        with Stages(folder, {}) as stages:
            return stages.run("a", ["a"], work(folder, log, "a"))

    start()
    state = json.loads((folder / "state.json").read_text())
    match output:
        case "gone":
            (folder / "a").unlink()
        case "changed":
            (folder / "a").write_text("b")
        case "a folder":
            (folder / "a").unlink(), (folder / "a").mkdir()
        case "note":
            del state["stages"]["a"]["sha256"], state["stages"]["a"]["facts"]
        case "facts":
            state["stages"]["a"]["facts"] = {"made": 3}
    (folder / "state.json").write_text(json.dumps(state))
    if output == "note":
        with pytest.raises(FolderTaken, match=r"state.json is damaged: choose another folder .* --fresh"):
            start()
        return
    assert start() == {"made": "a"} and (folder / "a").read_text() == "a"
    assert start() == {"made": "a"} and log == ["a", "a"], "mended for good"


@pytest.mark.parametrize("name", ["../other", "ABSOLUTE", "a/../../other", "link/other", "..", "."])
def test_a_received_folder_removes_nothing_outside_of_it(name, tmp_path):
    """Whatever its notes say of what it has made, however it is started over."""
    folder, log, other = tmp_path / "run", [], tmp_path / "other"
    other.mkdir()
    (other / "thesis").write_text("years")
    with Stages(folder, {"seed": 0}, "1.0", made=["a"]) as stages:
        stages.run("a", ["a"], work(folder, log, "a"))
    state = json.loads((folder / "state.json").read_text())
    name = name.replace("ABSOLUTE", str(other))
    state |= {"made": [name], "sha256": {name: ""}, "stages": {name: state["stages"]["a"]}}
    (folder / "state.json").write_text(json.dumps(state))
    for code, fresh in (("1.1", False), ("1.1", True)):
        with Stages(folder, {"seed": 0}, code, made=["a"], fresh=fresh) as stages:
            stages.run("a", ["a"], work(folder, log, "a"))
        assert (other / "thesis").read_text() == "years"


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "corpus").mkdir()
    for fresh in (False, True):
        with pytest.raises(FolderTaken, match="something else"):
            Stages(tmp_path, {}, fresh=fresh).__enter__()
    assert (tmp_path / "corpus").is_dir()


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_atomically(tmp_path / "f", lambda file: file.write("old"), text=True)

    def broken(file):
        file.write("new")
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_atomically(tmp_path / "f", broken, text=True)
    assert [file.name for file in tmp_path.iterdir()] == ["f"] and (tmp_path / "f").read_text() == "old"


def test_digest_and_memory_are_told():
    assert len(source_digest()) == 64 and source_digest() == source_digest()
    memory = peak_memory()
    assert memory is None or 1e7 < memory < 1e12
