"""The code in the documentation runs as it stands there."""

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = ("docs/jax.md", "outofthisworldmodel-envs/README.md")


def blocks(page: str) -> list[str]:
    """The page's Python, block by block."""
    return re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def scripts() -> dict[str, str]:
    """The blocks that begin with a file's name: programs of their own."""
    named = (re.match(r"# (\w+\.py)\n", block) for page in PAGES for block in blocks(page))
    return {match[1]: match.string for match in named if match}


@pytest.mark.parametrize("page", PAGES)
def test_the_blocks_of_a_page_run_in_order(page):
    names = {}
    # Stable-Baselines3 brings torch; its block is run by the session that has it.
    here = [block for block in blocks(page) if block not in scripts().values() and "stable_baselines3" not in block]
    assert len(here) >= 3
    for number, block in enumerate(here):
        exec(compile(block, f"{page}, block {number}", "exec"), names)


def test_a_batch_is_split_over_two_devices(tmp_path):
    file = tmp_path / "shard.py"
    file.write_text(scripts()["shard.py"], encoding="utf-8")
    subprocess.run([sys.executable, str(file)], check=True, timeout=120)


def test_two_processes_fly_one_set_of_slots(tmp_path):
    file = tmp_path / "hosts.py"
    file.write_text(scripts()["hosts.py"], encoding="utf-8")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    processes = [
        subprocess.Popen([sys.executable, str(file), address, "2", str(index)], stdout=subprocess.PIPE, text=True)
        for index in range(2)
    ]
    try:
        said = [process.communicate(timeout=120)[0] for process in processes]
    finally:
        for process in processes:
            process.kill()
    assert [process.returncode for process in processes] == [0, 0]
    means = {re.search(r"process (\d) of 2: mean start ([\d.]+) m", text).groups() for text in said}
    assert {process for process, _ in means} == {"0", "1"} and len({mean for _, mean in means}) == 1
