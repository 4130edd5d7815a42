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
    first = Stages(folder, {"seed": 0})
    assert first.run("a", ["a"], work(folder, log, "a")) == {"made": "a"}

    def killed():
        (folder / "half").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first.run("b", ["b"], killed)

    second = Stages(folder, {"seed": 0})
    assert second.run("a", ["a"], work(folder, log, "a")) == {"made": "a"}
    assert second.run("b", ["b"], work(folder, log, "b")) == {"made": "b"}
    assert log == ["a", "b"] and second.resumed == ["a"] and set(second.seconds) == {"a", "b"}

    third = Stages(folder, {"seed": 0})
    third.run("a", ["a"], work(folder, log, "a")), third.run("b", ["b"], work(folder, log, "b"))
    assert log == ["a", "b"] and third.resumed == ["a", "b"]


def test_other_settings_are_refused_and_other_code_or_fresh_starts_over(tmp_path):
    folder, log = tmp_path / "run", []
    Stages(folder, {"seed": 0}, "1.0").run("a", ["a"], work(folder, log, "a"))
    (folder / "mine").write_text("kept")
    with pytest.raises(FolderTaken, match=r"run holds another run, which differs in seed: choose .* --fresh"):
        Stages(folder, {"seed": 1}, "1.0")
    assert (folder / "a").exists()
    for number, again in enumerate([({"seed": 0}, "1.1", False), ({"seed": 0}, "1.1", True), ({"seed": 1}, "", True)]):
        *asked, fresh = again
        Stages(folder, *asked, fresh=fresh).run("a", ["a"], work(folder, log, "a"))
        assert log == ["a"] * (number + 2) and (folder / "mine").read_text() == "kept"


def test_a_stage_whose_output_is_gone_is_done_again(tmp_path):
    folder, log = tmp_path / "run", []
    Stages(folder, {}).run("a", ["a"], work(folder, log, "a"))
    (folder / "a").unlink()
    Stages(folder, {}).run("a", ["a"], work(folder, log, "a"))
    assert log == ["a", "a"]


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "corpus").mkdir()
    for fresh in (False, True):
        with pytest.raises(FolderTaken, match="something else"):
            Stages(tmp_path, {}, fresh=fresh)
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
