"""The two commands as a terminal runs them: encodings, versions, nested help, Ctrl-C at any moment."""

import os
import signal
import subprocess
import sys
import time

import pytest

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
    assert complaint.split("\n") == ["", "interrupted: the same command goes on where it was", ""]
