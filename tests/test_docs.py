"""The code in the documentation runs as it stands there."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from owm_envs.station import PORTS, goal_poses, hull_boxes, port_index

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "jax.md"
PACKAGES = ("astrojax", "outofthisworldmodel-envs", "outofthisworldmodel")
PAGES = sorted(
    [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *(ROOT / package / "README.md" for package in PACKAGES)]
)
FILES = [path.as_posix() for package in PACKAGES for path in sorted((ROOT / package).rglob("*.*"))]
SOURCES = "\n".join(Path(name).read_text(encoding="utf-8") for name in FILES if name.endswith(".py"))
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


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files(page):
    targets = re.findall(r"\]\((?!https?:|#)([^)#\s]+)", page.read_text(encoding="utf-8"))
    assert not [target for target in targets if not (page.parent / target).exists()]


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "decisions").glob("*.md")), ids=lambda path: path.stem)
def test_a_decision_has_its_parts_and_names_what_exists(page):
    text = page.read_text(encoding="utf-8")
    if page.stem != "README":
        assert re.findall(r"^## (\w+)$", text, re.MULTILINE) == ["Choice", "Measurement", "Where"]
        date = re.search(r"^Date: (\d{4}-\d\d-\d\d)$", text, re.MULTILINE)[1]
        assert f"| {date} | [{text.splitlines()[0][2:]}]({page.name}) |" in page.with_name("README.md").read_text(
            "utf-8"
        )
    for name in re.findall(r"`([^`]+)`", re.sub(r"\[`.*?\)", "", text)):
        file = any(path.endswith(f"/{name}") for path in FILES)
        words = re.findall(r"[A-Za-z_]\w+", name)
        assert file or all(re.search(rf"\b{word}\b", SOURCES) for word in words), f"nothing is called {name}"


def test_the_front_page_is_short_and_its_code_runs_as_it_stands(tmp_path):
    page = (PAGE.parents[1] / "README.md").read_text(encoding="utf-8")
    assert len(page.split()) <= 700
    code = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert code
    for number, block in enumerate(code):
        file = tmp_path / f"block{number}.py"
        file.write_text(block, encoding="utf-8")
        subprocess.run([sys.executable, str(file)], check=True, timeout=200, env=QUICK)


def test_what_the_glossary_says_of_hold_poses():
    apart = np.array([np.linalg.norm(goal[:3] - np.asarray(port.interface)) for goal, port in zip(goal_poses(), PORTS)])
    assert apart.min() == pytest.approx(3.66) and apart.max() == pytest.approx(6.5)
    boxes, hold = hull_boxes(), goal_poses()[port_index("zvezda_aft"), :3]
    outside = np.maximum(np.maximum(boxes[:, 0] - hold, hold - boxes[:, 1]), 0)
    assert np.linalg.norm(outside, axis=1).min() - 2.25 == pytest.approx(3.75, abs=0.005)
