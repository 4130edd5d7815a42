"""The installed package: refuses a foreign namesake, leaves JAX's settings alone, ships its type marker."""

import os
import pathlib
import subprocess
import sys
import types
from importlib import metadata

import astrojax


def run(code, *paths):
    env = dict(os.environ, PYTHONPATH=os.pathsep.join(map(str, paths)))
    # From elsewhere: a folder named astrojax in the working directory must not matter.
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=env,
        cwd=pathlib.Path(sys.prefix),
        timeout=120,
    )


def test_version_and_marker():
    assert astrojax.__version__ == metadata.version("outofthisworldmodel-astrojax")
    assert (pathlib.Path(astrojax.__file__).parent / "py.typed").is_file()


def test_foreign_distribution_is_refused(tmp_path):
    info = tmp_path / "astrojax-0.9.9.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: astrojax\nVersion: 0.9.9\n", encoding="utf-8")
    result = run("import astrojax", tmp_path)
    assert result.returncode == 1
    assert "ImportError: the distribution 'astrojax' 0.9.9 is installed" in result.stderr
    assert "pip uninstall astrojax" in result.stderr


def test_import_changes_no_jax_setting():
    code = (
        "import jax; before = dict(jax.config.values); import astrojax; "
        "assert dict(jax.config.values) == before; print('same')"
    )
    result = run(code)
    assert result.stdout.strip() == "same", result.stderr


def test_the_conformance_page_is_what_the_tests_say():
    script = pathlib.Path(__file__).parents[1] / "tools" / "conformance_page.py"
    subprocess.run([sys.executable, script, "--check"], check=True)


def test_every_room_has_a_page_in_the_reference():
    """That the page has every name of the room, `nox -s docs` looks."""
    pages = pathlib.Path(__file__).parents[1] / "docs" / "reference"
    shown = {line.removeprefix("::: ") for page in pages.glob("*.md") for line in page.read_text("utf-8").splitlines()}

    def rooms(module):
        for name in getattr(module, "__all__", ()):
            if isinstance(inner := getattr(module, name), types.ModuleType):
                yield from (inner.__name__, *rooms(inner))

    found = set(rooms(astrojax))
    assert {"astrojax.constants", "astrojax.orbits.sgp4", "astrojax.forces.atmosphere"} < found <= shown
