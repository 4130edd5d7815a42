"""Output folders: whole or not there, links followed, and nothing of the user's ever lost."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from owm_envs import files
from owm_envs.files import FolderTaken, publish, replace_folder, staged, write_atomically

MODEL = {"weights": b"w" * 9, "config.json": b"{}"}
NEWER = {"weights": b"v" * 9, "config.json": b"[]"}
SWEEP = """
import os, signal, sys
from pathlib import Path
from owm_envs.files import publish, replace_folder

os.fsync = lambda descriptor: None
WRITES = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "shutil.copytree", "open"}

def killed_at(step, work):
    '''Whether `work`, killed at its so manieth write, was killed before its end.'''
    child = os.fork()
    if not child:
        left = [step]
        def hook(event, args):
            if event in WRITES and (event != "open" or isinstance(args[1], str) and args[1] != "r"):
                left[0] -= 1
                if left[0] < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
        sys.addaudithook(hook)
        work()
        os._exit(0)
    return os.waitpid(child, 0)[1] == signal.SIGKILL
"""


def tree(folder: Path) -> dict[str, bytes]:
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def fill(folder: Path, contents: dict[str, bytes]) -> Path:
    for name, data in contents.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


@pytest.fixture
def home(tmp_path, monkeypatch):
    """An empty folder as the current one and as the user's own."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HOME", str(folder))
    return folder


@pytest.mark.parametrize(
    ("name", "place"), [("new/one", "new/one"), ("empty", "empty"), ("link", "target"), ("~/x", "x"), (".", ".")]
)
def test_a_folder_is_written_and_replaced_wherever_its_name_leads(home, name, place):
    (home / "empty").mkdir() if name == "empty" else None
    if name == "link":
        (home / "target").mkdir()
        (home / "link").symlink_to("target")
    for contents in (MODEL, NEWER):
        assert replace_folder(name, contents) == (home / place).resolve()
        assert tree(home / place) == contents
    assert (home / "link").is_symlink() == (name == "link") and Path.cwd() == home
    around = {path.name for path in [*home.iterdir(), *home.parent.iterdir()]}
    assert around <= {"home", "new", "empty", "target", "link", "x", *MODEL}, "nothing else is left behind"


def test_a_link_that_leads_nowhere_yet_is_followed(home):
    (home / "link").symlink_to("disk/model")
    replace_folder("link", MODEL)
    assert (home / "link").is_symlink() and tree(home / "disk" / "model") == MODEL
    (home / "file").symlink_to("real")
    write_atomically("file", lambda file: file.write(b"x"))
    assert (home / "file").is_symlink() and (home / "real").read_bytes() == b"x"


@pytest.mark.parametrize("name", ["mine", "link", "."])
def test_other_files_are_never_replaced(home, name, monkeypatch):
    mine = fill(home / "mine", {"thesis.tex": b"years", "weights": b"w", "sub/data": b"d"})
    (home / "link").symlink_to("mine")
    if name == ".":
        monkeypatch.chdir(mine)
    before = tree(home)
    with pytest.raises(FolderTaken, match=r"mine holds files of something else \(sub, thesis.tex\): choose another"):
        replace_folder(name, MODEL)
    assert tree(home) == before


def test_a_file_in_the_way_stays_a_file(home):
    (home / "f").write_bytes(b"mine")
    with pytest.raises(NotADirectoryError, match="f is no folder; choose another"):
        replace_folder("f", MODEL)
    assert tree(home) == {"f": b"mine"}


def test_a_write_that_fails_leaves_the_old_folder(home):
    replace_folder("x", MODEL)
    with pytest.raises(TypeError):
        replace_folder("x", {"weights": b"new", "config.json": None})
    assert tree(home) == {f"x/{name}": data for name, data in MODEL.items()}


@pytest.mark.parametrize("write", ["a file", "a folder"])
def test_bytes_are_on_the_disk_before_a_name_leads_to_them(home, write, monkeypatch):
    """Else a loss of power leaves names of nothing."""
    done = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: done.append(os.fstat(descriptor).st_size))
    for name in ("replace", "rename"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *paths, real=real: (done.append("named"), real(*paths)))
    if write == "a file":
        write_atomically("x", lambda file: file.write(b"w" * 9))
        assert done == [9, "named"]
    else:
        replace_folder("x", MODEL)
        assert sorted(done[:2]) == [2, 9] and done[2:] == ["named"]


@pytest.mark.parametrize("folder", [True, False])
def test_what_killed_writers_left_goes_and_what_living_ones_write_stays(home, folder):
    left = home / ".x.123.partial"
    left.mkdir() if folder else left.write_bytes(b"half")
    if folder:
        (left / "new").mkdir()
    with staged(home / "x", folder=folder) as living, staged(home / "x", folder=folder):
        assert left.exists() and living.exists()
    assert not left.exists()
    with staged(home / "x", folder=folder) as living:
        replace_folder("x", MODEL) if folder else write_atomically("x", lambda file: file.write(b"x"))
        assert living.exists()
    assert [path.name for path in home.iterdir()] == ["x"]
    (home / ".y.1.partial").write_bytes(b"half of another")
    write_atomically("z", lambda file: file.write(b"x"))
    assert (home / ".y.1.partial").exists()


@pytest.mark.skipif(files.fcntl is None, reason="what is open cannot be removed there")
def test_what_another_process_writes_stays(home):
    code = "import sys; from pathlib import Path; from owm_envs.files import staged\n"
    code += "with staged(Path('x')) as place: print(place, flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1, text=True) as other:
        place = home / other.stdout.readline().strip()
        write_atomically("x", lambda file: file.write(b"x"))
        assert place.exists()
        other.kill()
    write_atomically("x", lambda file: file.write(b"x"))
    assert not place.exists()


@pytest.mark.parametrize("inside", [True, False])
def test_publishing_into_a_folder_of_other_files_is_refused(home, inside, monkeypatch):
    finished = fill(home / "set.partial", {"README.md": b"card", "train/a": b"a", "generation.json": b"{}"})
    mine = fill(home / "set", {"README.md": b"mine"})
    if inside:
        monkeypatch.chdir(mine)
    before = tree(home)
    with pytest.raises(FolderTaken, match=r"set holds files of something else \(README.md\)"):
        publish(finished, mine)
    assert tree(home) == before


def swept(script: str, *arguments: object) -> int:
    """Run a sweep of kills in a process without JAX: it forks; what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", SWEEP + script, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")
@pytest.mark.parametrize(
    ("place", "disk"), [("current", "the same disk"), ("other", "the same disk"), ("current", "another disk")]
)
def test_publishing_goes_on_wherever_it_was_killed(tmp_path, place, disk):
    """Kill it at its first write, its second, and so on: the same call ends in the same bytes."""
    there = str(tmp_path) if disk == "the same disk" else "/dev/shm"
    if not os.path.isdir(there) or (os.stat(there).st_dev == tmp_path.stat().st_dev) != (disk == "the same disk"):
        pytest.skip("there is one disk only")
    script = """
from owm_envs.files import remove
out, finished, inside = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] == "current"
files = {"README.md": b"card", "train/meta/a": b"a" * 99, "train/b": b"b", "generation.json": b"{}"}
for step in range(1000):
    remove(out), remove(finished)
    out.mkdir()
    for name, data in files.items():
        (finished / name).parent.mkdir(parents=True, exist_ok=True)
        (finished / name).write_bytes(data)
    os.chdir(out if inside else "/")
    going = killed_at(step, lambda: publish(finished, out))
    if sys.argv[4] == "the same disk":
        os.chdir("/")  # where the user types the same again does not matter
    if (out / "generation.json").exists():
        assert {f.relative_to(out).as_posix() for f in out.rglob("*") if f.is_file()} >= set(files)
    if finished.exists():
        publish(finished, out)
    found = {f.relative_to(out).as_posix(): f.read_bytes() for f in out.rglob("*") if f.is_file()}
    assert found == files and not finished.exists(), (step, found)
    if not going:
        break
print(step)
"""
    with tempfile.TemporaryDirectory(dir=there) as folder:
        least = 6 if place == "current" else 1
        assert swept(script, tmp_path / "set", Path(folder) / "set.partial", place, disk) >= least


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")
@pytest.mark.parametrize("place", ["current", "other"])
def test_a_folder_killed_while_it_is_replaced_is_replaced_by_the_next_call(tmp_path, place):
    """Elsewhere than in the current folder no reader ever sees a mixture."""
    script = """
out, inside = Path(sys.argv[1]), sys.argv[2] == "current"
old, new = {"w": b"1", "config.json": b"{}"}, {"w": b"2", "config.json": b"[]"}
for step in range(1000):
    os.chdir("/")
    replace_folder(out, old)
    os.chdir(out if inside else "/")
    going = killed_at(step, lambda: replace_folder(out, new))
    found = {f.name: f.read_bytes() for f in out.glob("[!.]*")}
    assert inside or found in (old, new, {}), found
    replace_folder(out, new)
    assert {f.name: f.read_bytes() for f in out.iterdir()} == new
    assert [f.name for f in out.parent.iterdir()] == [out.name]
    if not going:
        break
print(step)
"""
    folder = tmp_path / "below"
    assert swept(script, folder / "model", place) >= 4


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")
def test_a_claim_killed_at_any_write_is_found_again(tmp_path):
    """It is never taken for another run's, and leaves nothing behind."""
    script = """
from owm_envs.claims import Claim
from owm_envs.files import remove
out = Path(sys.argv[1])
for step in range(1000):
    remove(out)
    going = killed_at(step, lambda: Claim(out, {"seed": 1}, "generation.json").note(done=True))
    Claim(out, {"seed": 1}, "generation.json").note(done=True)
    assert [f.name for f in out.iterdir()] == ["generation.json"], step
    if not going:
        break
print(step)
"""
    assert swept(script, tmp_path / "set.partial") >= 2
