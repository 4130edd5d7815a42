import pytest

from owm.stages import Stages, peak_memory, source_digest
from owm_envs.files import write_atomically


def work(folder, log, name):
    def run():
        log.append(name)
        (folder / name).write_text(name)
        return {"made": name}

    return run


def test_a_killed_run_goes_on_and_a_finished_one_starts_over(tmp_path):
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
    second.finish()

    third = Stages(folder, {"seed": 0})
    assert not (folder / "a").exists() and not (folder / "b").exists()
    third.run("a", ["a"], work(folder, log, "a"))
    assert log == ["a", "b", "a"] and third.resumed == []


@pytest.mark.parametrize("again", [({"seed": 1}, False), ({"seed": 0}, True)])
def test_other_settings_or_fresh_start_over(tmp_path, again):
    settings, fresh = again
    folder, log = tmp_path / "run", []
    Stages(folder, {"seed": 0}).run("a", ["a"], work(folder, log, "a"))
    (folder / "mine").write_text("kept")
    Stages(folder, settings, fresh=fresh).run("a", ["a"], work(folder, log, "a"))
    assert log == ["a", "a"] and (folder / "mine").read_text() == "kept"


def test_a_stage_whose_output_is_gone_is_done_again(tmp_path):
    folder, log = tmp_path / "run", []
    Stages(folder, {}).run("a", ["a"], work(folder, log, "a"))
    (folder / "a").unlink()
    Stages(folder, {}).run("a", ["a"], work(folder, log, "a"))
    assert log == ["a", "a"]


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "corpus").mkdir()
    with pytest.raises(FileExistsError, match="something else"):
        Stages(tmp_path, {})
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
