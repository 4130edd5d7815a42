"""The two commands as a terminal runs them: encodings, versions, nested help, Ctrl-C at any moment."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.table import Table

from owm_envs import cli
from owm_envs.registration import IDS
from owm_envs.shell import terminal

SOURCES = sorted(Path(__file__).parents[1].glob("*/src/**/*.py"))

COMMANDS = ("owm", "owm_envs")
COMPILING = (
    "import jax, sys\n"
    "from owm_envs.shell import run\n"
    "class App:\n"
    "    def cli(self, **_):\n"
    "        print('compiling', flush=True)\n"
    "        def body(x):\n"
    "            for i in range(6000):\n"
    "                x = jax.numpy.sin(x) * i + x @ x\n"
    "            return x\n"
    "        jax.jit(body)(jax.numpy.ones((3, 3)))\n"
    "sys.argv = ['owm']\n"
    "run('owm', '', '0', lambda arguments: App())\n"
)


def start(*words, **environ):
    return subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",  # of another encoding's bytes
        env=os.environ | environ,
    )


@pytest.mark.parametrize("package", COMMANDS)
def test_help_and_version_on_any_terminal(package):
    for encoding in ("ascii", "cp1252"):
        process = start("-m", package, "--help", PYTHONIOENCODING=encoding)
        said, complaint = process.communicate(timeout=60)
        assert process.returncode == 0, complaint
        assert "usage" in said.lower()
    said = start("-m", package, "--version").communicate(timeout=60)[0].split()
    assert said == [package.replace("_", "-"), "0.1.0"]


def test_help_tells_of_the_commands_inside_a_command():
    said = start("-m", "owm", "evaluate", "--help").communicate(timeout=60)[0]
    for name in ("docking", "matrix", "prediction"):
        assert name in said
    assert "--flights" in start("-m", "owm", "evaluate", "docking", "--help").communicate(timeout=60)[0]


@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal are POSIX's")
@pytest.mark.parametrize("delay", [0.0, 1.0, 4.0])
def test_an_interruption_while_xla_compiles_ends_in_one_line(delay):
    process = start("-c", COMPILING)
    assert process.stdout.readline() == "compiling\n"
    time.sleep(delay)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=30)
    assert process.returncode == 130
    assert complaint == "interrupted\n"


@pytest.mark.parametrize(
    "words", [["verify"], ["plot"], ["station", "import"], ["config", "validate"], ["merge", "--out", "x"]]
)
def test_a_path_that_looks_like_markup_is_named_in_one_line(words, tmp_path, capsys):
    place = tmp_path / "[" / "x]"
    place.mkdir(parents=True)
    with pytest.raises(SystemExit) as ended:
        cli.main([*words, str(place)])
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert ended.value.code == 2 and told.startswith("error: ") and "[/x]" in told and "closing tag" not in told


def test_consoles_print_text_as_it_is(capsys):
    marked = "a [/x] [bold] :smile:"
    table = Table(marked, title=marked)
    table.add_row(marked)
    terminal().print(table)
    terminal().print(marked)
    assert capsys.readouterr().out.count(marked) == 4
    # And no other consoles are made.
    made = [file.name for file in SOURCES if re.search(r"\bConsole\(", file.read_text(encoding="utf-8"))]
    assert made == ["shell.py"]


STRUCK = """
import os, runpy, signal, sys
package, module, *sys.argv[1:] = sys.argv[1:]
class Strike:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Strike())
runpy.run_module(package, run_name="__main__", alter_sys=True)
"""
GENERATE = ["generate", "--out", "never"]
FLY = ["fly", "--policy", "dock", "--out", "never"]
MATRIX = ["evaluate", "docking", "dock", "--out", "never"]


@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal are POSIX's")
@pytest.mark.parametrize(
    ("package", "module", "words"),
    [
        ("owm_envs", "owm_envs.cli", ["ports"]),
        ("owm_envs", "tyro", ["--help"]),
        ("owm_envs", "rich.table", ["ports"]),
        ("owm_envs", "pydantic", GENERATE),
        ("owm", "owm.cli", ["--help"]),
        ("owm", "tyro", ["presets"]),
        ("owm", "gymnasium", FLY),
        ("owm", "jax", FLY),
        ("owm", "owm.commands.run", FLY),
        ("owm", "owm.study.run", MATRIX),
    ],
)
def test_an_interruption_of_any_import_ends_in_one_line(package, module, words, tmp_path):
    process = subprocess.run(
        [sys.executable, "-c", STRUCK, package, module, *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=60,
    )
    assert (process.returncode, process.stderr) == (130, "interrupted\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal are POSIX's")
def test_work_that_can_be_resumed_says_so(tmp_path):
    process = start("-m", "owm_envs", "generate", "--env", "iss", "--out", str(tmp_path / "set"))
    process.stderr.readline()  # it has begun
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 130
    assert complaint.splitlines()[-1] == "interrupted: the same command goes on where it was"


@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal are POSIX's")
def test_an_interruption_of_several_processes_leaves_no_warning(tmp_path):
    flights = ["--flights", "1", "--ports", "zvezda_aft", "unity_nadir", "--out", str(tmp_path / "report")]
    process = subprocess.Popen(
        [sys.executable, "-m", "owm", "evaluate", "docking", "dock", "random", *flights, "--processes", "2"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    for line in process.stderr:
        if "0/2 rows" in line or "flights;" in line:
            break
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: all of them
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 130, complaint
    assert "Traceback" not in complaint and "resource_tracker" not in complaint
    assert complaint.splitlines()[-1] == "interrupted: the same command goes on where it was"


@pytest.mark.parametrize("first", ["import gymnasium, owm_envs", "import owm_envs, gymnasium"])
def test_environments_are_registered_in_either_order(first):
    script = (
        f"import sys\nsys.path[:0] = {sys.path!r}\n{first}\n"
        "assert 'jax' not in sys.modules\n"
        "print(sorted(name for name in gymnasium.registry if 'iss' in name.lower()))"
    )
    done = subprocess.run([sys.executable, "-I", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(sorted(IDS))
