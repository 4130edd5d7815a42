"""The code in the documentation runs as it stands there, its links lead somewhere, and its sentences are short."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.config import NOISE_PRESETS, DockingConfig
from owm_envs.env import DockingEnv
from owm_envs.station import PARTS, PORTS, goal_poses, hull_boxes, nearest_part, port_index
from owm_envs.task.navigation import goal_error

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "jax.md"
PACKAGES = ("astrojax", "outofthisworldmodel-envs", "outofthisworldmodel")
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("astrojax/docs/**/*.md"),
        *(ROOT / package / "README.md" for package in PACKAGES),
    ]
)
FILES = [path.as_posix() for package in PACKAGES for path in sorted((ROOT / package).rglob("*.*"))]
SOURCES = "\n".join(Path(name).read_text(encoding="utf-8") for name in FILES if name.endswith(".py"))
# Everything here runs once: programs that compile sooner are worth more than programs that run faster.
QUICK = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"}


def blocks(page: Path = PAGE) -> list[str]:
    """A page's Python, block by block."""
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def script(name: str) -> str:
    """The block that begins with a file's name: a program of its own."""
    (found,) = (block for block in blocks() if block.startswith(f"# {name}\n"))
    return found


@pytest.mark.slow
def test_the_blocks_run_in_order(tmp_path):
    # The two devices must be asked for before JAX is first used; what follows doesn't mind having them.
    together = [script("shard.py")] + [block for block in blocks() if not re.match(r"# \w+\.py\n", block)]
    assert len(together) >= 7
    file = tmp_path / "page.py"
    file.write_text("\n".join(together), encoding="utf-8")
    subprocess.run([sys.executable, str(file)], check=True, timeout=600, env=QUICK)


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
    # `nox -s docs` makes what the guide shows, and looks whether it is there.
    assert not [each for each in targets if not each.startswith("made/") and not (page.parent / each).exists()]


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


def sentences(page: Path) -> list[str]:
    """The sentences of a page's prose: without code, tables, headings and pictures, code and links as one word."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"!\[[^]]*\]\([^)]*\)", "", re.sub(r"^(\||#).*$", "", text, flags=re.MULTILINE))
    text = re.sub(r"`[^`]*`", "CODE", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text))
    found = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text):
        found += re.split(r"(?<=[.!?])\**\s+(?=[A-Z\"(0-9*+])", " ".join(block.split()))
    return found


PROSE = [page for page in PAGES if page.name not in ("CHANGELOG.md", "report.md")]


@pytest.mark.parametrize("page", PROSE, ids=lambda path: str(path.relative_to(ROOT)))
def test_sentences_are_short(page):
    long = [each for each in sentences(page) if sum(bool(re.search(r"\w", word)) for word in each.split()) > 24]
    assert not long, "\n".join(long)


def test_the_front_page_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 700


@pytest.mark.slow
@pytest.mark.parametrize("package", [".", *PACKAGES])
def test_the_code_of_a_readme_runs_block_by_block(package, tmp_path):
    # That of Stable-Baselines3 runs where that is installed: outofthisworldmodel-envs/tests_sb3.
    code = [block for block in blocks(ROOT / package / "README.md") if "stable_baselines3" not in block]
    assert code
    front = blocks(ROOT / "README.md")
    code = [block for block in code if package == "." or block not in front]
    # Each block begins with nothing, and with no environment registered but by itself.
    begin = "import gymnasium; gymnasium.registry.clear(); import sys; sys.modules.pop('owm_envs', None)"
    runs = [f"{begin}\nexec(compile({block!r}, 'block {i}', 'exec'), {{}})\n" for i, block in enumerate(code)]
    file = tmp_path / "blocks.py"
    file.write_text("\n".join(runs), encoding="utf-8")
    subprocess.run([sys.executable, str(file)], check=True, timeout=600, env=QUICK, cwd=tmp_path)


def test_what_the_glossary_says_of_hold_poses():
    apart = np.array([np.linalg.norm(goal[:3] - np.asarray(port.interface)) for goal, port in zip(goal_poses(), PORTS)])
    assert apart.min() == pytest.approx(3.66) and apart.max() == pytest.approx(6.5)
    boxes, hold = hull_boxes(), goal_poses()[port_index("zvezda_aft"), :3]

    def clearance(place):
        outside = np.maximum(np.maximum(boxes[:, 0] - place, place - boxes[:, 1]), 0)
        return np.linalg.norm(outside, axis=1).min() - 2.25

    assert clearance(hold) == pytest.approx(3.75, abs=0.005)
    (to_parts,), _ = nearest_part(PARTS, hold[None])
    assert to_parts - 2.25 == pytest.approx(3.75, abs=0.005)
    # A flight is captured within 0.1 m of the pose.
    ends = [clearance(hold + offset * np.array(PORTS[port_index("zvezda_aft")].normal)) for offset in (-0.1, 0.1)]
    assert ends == pytest.approx([3.65, 3.85], abs=0.005)


def test_what_the_glossary_says_of_noise_and_observations():
    page = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    assert "| `cooperative` | 0.05 m | 0.002 m/s | 5e-5 rad | 1e-5 rad/s |" in page
    assert (
        "| `noncooperative` | 1 % of the distance to the station's origin | 0.03 m/s | 5e-5 rad | 1e-5 rad/s |" in page
    )
    good, poor = NOISE_PRESETS["cooperative"], NOISE_PRESETS["noncooperative"]
    assert (good.position, good.position_per_range, good.velocity, good.attitude, good.rate) == (
        0.05,
        0,
        0.002,
        5e-5,
        1e-5,
    )
    assert (poor.position, poor.position_per_range, poor.velocity, poor.attitude, poor.rate) == (
        0,
        0.01,
        0.03,
        5e-5,
        1e-5,
    )
    names = DockingEnv(fidelity="iss-numerical").layout.names
    blocks_of = ["epoch_mjd_day", "position_x", "velocity_x", "attitude_w", "rate_x", "goal_position_x"]
    assert [names.index(name) for name in blocks_of] == [0, 2, 5, 8, 12, 15] and names[-1] == "goal_rate_z"
    tolerances = DockingConfig().docking
    for value in tolerances.model_dump().values():
        assert f"below {value:g} " in page


def test_what_the_glossary_says_of_signs():
    goal = np.array([0, 38.55, -1.87, 1, 0, 0, 0])
    turned = [np.cos(0.05), 0, np.sin(0.05), 0]  # by 0.1 rad about the body's y
    view = np.array([1, 38.55, -1.87, 0.2, 0, 0, *turned, 0, 0, 0.3])
    with jax.enable_x64(True):
        error = np.asarray(goal_error(jnp.asarray(view), jnp.asarray(goal)))
    # Position and velocity: measured minus goal. Attitude: the turn still to be made. Rate: the measured one.
    np.testing.assert_allclose(error, [1, 0, 0, 0.2, 0, 0, 0, -0.1, 0, 0, 0, 0.3], atol=1e-9)
