"""The code in the documentation runs as it stands there."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "jax.md"
# Everything here runs once: programs that compile sooner are worth more than programs that run faster.
QUICK = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"}


def blocks() -> list[str]:
    """The page's Python, block by block."""
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def script(name: str) -> str:
    """The block that begins with a file's name: a program of its own."""
    (found,) = (block for block in blocks() if block.startswith(f"# {name}\n"))
    return found


def test_the_blocks_run_in_order(tmp_path):
    # The two devices must be asked for before JAX is first used; what follows doesn't mind having them.
    together = [script("shard.py")] + [block for block in blocks() if not re.match(r"# \w+\.py\n", block)]
    assert len(together) >= 7
    file = tmp_path / "page.py"
    file.write_text("\n".join(together), encoding="utf-8")
    subprocess.run([sys.executable, str(file)], check=True, timeout=200, env=QUICK)


def test_two_processes_fly_one_set_of_slots(tmp_path):
    file = tmp_path / "hosts.py"
    file.write_text(script("hosts.py"), encoding="utf-8")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, str(file), address, "2"]
    processes = [
        subprocess.Popen([*command, str(index)], stdout=subprocess.PIPE, text=True, env=QUICK) for index in range(2)
    ]
    try:
        said = [process.communicate(timeout=200)[0] for process in processes]
    finally:
        for process in processes:
            process.kill()
    assert [process.returncode for process in processes] == [0, 0]
    means = {re.search(r"process (\d) of 2: mean start ([\d.]+) m", text).groups() for text in said}
    assert {process for process, _ in means} == {"0", "1"} and len({mean for _, mean in means}) == 1
