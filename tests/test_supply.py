"""What others could slip in: foreign packages of our names, actions and tools that change behind their names."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from owm_envs.words import _EXTRAS, install

ROOT = Path(__file__).parents[1]
PACKAGES = {"astrojax": "astrojax", "outofthisworldmodel-envs": "owm_envs", "outofthisworldmodel": "owm"}
OURS = {"astrojax", "owm", "owm-envs", *PACKAGES, "outofthisworldmodel-astrojax"}
"""Names that an index may give to others, or has given."""
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TEXTS = sorted(
    path
    for folder in (".", ".github", "docs", "examples", "tests", *PACKAGES)
    for path in (ROOT / folder).glob("*" if folder == "." else "**/*")
    if path.suffix in (".md", ".py", ".toml", ".yml", ".ipynb", ".html", ".js") and path.name != "three.min.js"
)
PROJECTS = {name: tomllib.loads((ROOT / name / "pyproject.toml").read_text(encoding="utf-8")) for name in PACKAGES}


def installed(text: str) -> set[str]:
    """The names that a text tells to install, as indexes write them; no folders, files and options."""
    found = set()
    for words in re.findall(r"\b(?:pipx? install|uv add|uvx|uv pip install)\s+([^\n`#;&)]*)", text):
        for word in words.replace("\\n", " ").split():
            word = word.strip("\"',.\\")
            if re.match(r"[A-Za-z]", word) and "/" not in word:
                found.add(re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", word)[0]).lower())
    return found


def test_nobody_is_told_to_install_a_name_of_ours():
    assert installed('pip install "outofthisworldmodel-envs[sb3]" av') == {"outofthisworldmodel-envs", "av"}
    assert installed("pip install -e ./astrojax -e './owm[test]'") == set()
    told = {path.relative_to(ROOT): installed(path.read_text(encoding="utf-8")) & OURS for path in TEXTS}
    assert len(told) > 300 and not {
        path: names for path, names in told.items() if names and path.name != "test_supply.py"
    }


def test_messages_name_what_the_extras_bring():
    said = {extra: packages for project in PROJECTS.values() for extra, packages in _optional(project).items()}
    assert {extra: list(packages) for extra, packages in _EXTRAS.items()} == {extra: said[extra] for extra in _EXTRAS}
    assert install("mesh") == 'pip install "trimesh>=4.5" "scipy>=1.13"'


def _optional(project: dict) -> dict[str, list[str]]:
    extras = project["project"]["optional-dependencies"]
    return {name: packages for name, packages in extras.items() if not any("outofthis" in each for each in packages)}


@pytest.mark.parametrize("name", ["astrojax", "owm-envs", "owm"])
def test_a_foreign_distribution_of_the_name_is_refused(name, tmp_path):
    info = tmp_path / f"{name.replace('-', '_')}-9.9.9.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.9.9\n", encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    code = f"import {name.replace('-', '_')}"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}, timeout=60
    )
    assert done.returncode == 1
    assert f"ImportError: the distribution '{name}' 9.9.9 is installed beside" in done.stderr
    assert f"Fix: pip uninstall {name}, then install ours again from its source" in done.stderr


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_pinned_by_commit_and_tools_by_hash(workflow):
    text = workflow.read_text(encoding="utf-8")
    uses = re.findall(r"^\s*-? uses: (.*)$", text, re.MULTILINE)
    assert uses and all(re.fullmatch(r"[\w.-]+/[\w.-]+@[0-9a-f]{40} # v[\d.]+", each) for each in uses), uses
    installs = re.findall(r"^.*\bpip install\b(.*)$", text, re.MULTILINE)
    assert set(installs) == {" --require-hashes -r .github/tools.txt"}


def test_one_action_has_one_commit():
    uses = {each for path in WORKFLOWS for each in re.findall(r"uses: (\S+)", path.read_text(encoding="utf-8"))}
    assert len(uses) == len({each.split("@")[0] for each in uses})


def test_what_publishes_runs_no_code_of_others():
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    jobs = dict(re.findall(r"^  (\w+):\n((?:    .*\n|\n|  #.*\n)+)", text.partition("\njobs:\n")[2], re.MULTILINE))
    assert set(jobs) == {"build", "tests", "publish"}
    assert [name for name, job in jobs.items() if "id-token" in job] == ["publish"] and "id-token" not in text[:600]
    assert "needs: [build, tests]" in jobs["publish"] and not re.search(r"nox|pip|python|checkout", jobs["publish"])
    assert "nox -s tests" in jobs["tests"] and "nox -s tests" not in jobs["build"]


def test_build_tools_are_pinned():
    lines = [
        line
        for line in (ROOT / ".github" / "tools.txt").read_text(encoding="utf-8").splitlines()
        if line[:1] not in "#"
    ]
    pins = {re.match(r"[\w-]+==[\w.]+(?= (?:; .* )?--hash=sha256:[0-9a-f]{64}$)", line)[0] for line in lines if line}
    assert {pin.split("==")[0] for pin in pins} >= {"nox", "build", "hatchling", "virtualenv"}
    for project in PROJECTS.values():
        assert set(project["build-system"]["requires"]) <= pins
