"""The project's chores: `nox -s tests`, `nox -s demo`; `nox -l` lists them all."""

import hashlib
import os
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path

import nox

if sys.version_info < (3, 11):  # noqa: UP036 (nox itself may well have been installed with an older one)
    raise SystemExit(
        f"This project needs Python 3.11 or later; nox runs on {sys.version.split()[0]}. "
        "Delete .venv and make it anew with a later one, for example `python3.12 -m venv .venv`."
    )

nox.needs_version = ">=2024.4.15"
nox.options.reuse_existing_virtualenvs = True
nox.options.sessions = ["lint", "tests"]

ROOT = Path(__file__).parent.resolve()
PACKAGES = {"astrojax": "astrojax", "outofthisworldmodel-envs": "owm_envs", "outofthisworldmodel": "owm"}
RUFF = "ruff==0.17.6"
TOOLS = ROOT / ".github" / "tools.txt"
"""What builds the wheels, to the byte."""
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
"""Names that tests look for in the path, unless `OWM_CHROMIUM` says where it is."""
GUIDE = {"conjunction": ("--objects", "2000", "--hours", "0.5", "--threshold", "20")}
"""What examples are told for the guide, other than what they do unasked."""
CLIENTS = ("==0.34.0", ">=2")
"""Of the Hugging Face hub: the oldest that pyproject.toml allows, and the newest."""

TEST_ENVIRONMENT = {
    # Compiled programs outlive the test process, so a second run skips most of the waiting. Safe to delete.
    # Tests only: on some processors XLA refuses what it stored and says so at length, which pytest hides.
    "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".jax_cache"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    # Programs run briefly here, and most of the time goes into compiling them: without optimised machine code, made
    # by one thread (each more begins anew), XLA takes a quarter as long. `XLA_FLAGS= nox -s tests` tests what users
    # compile, and so does the demo.
    "XLA_FLAGS": "--xla_cpu_use_fusion_emitters=false --xla_llvm_disable_expensive_passes=true "
    "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1",
}
"""Of these a caller's own win."""

LEROBOT_ENVIRONMENT = """
fidelity = "iss-numerical"
noise = "cooperative"
observation = "state+pixels"
horizon = 10.0
ports = ["zvezda_aft", "harmony_forward"]

[camera]
width = 64
height = 48
every = 5
"""
"""What the dataset that LeRobot reads is recorded in: short flights before a small camera."""


def _test_environment(session: nox.Session) -> dict[str, str]:
    """What tests run in, less the flags that XLA no longer knows: it aborts and names them."""
    chosen = {name: os.environ.get(name, value) for name, value in TEST_ENVIRONMENT.items()}
    probe, any_code = ["python", "-c", "import jax; jax.devices()"], range(-128, 2**32)
    said = session.run(*probe, env=chosen, silent=True, log=False, success_codes=any_code)
    return chosen | {"XLA_FLAGS": " ".join(flag for flag in chosen["XLA_FLAGS"].split() if flag not in said)}


def _editable(extra: str = "", *packages: str) -> list[str]:
    """Pip's words for the named packages, or all three, straight from their sources."""
    suffix = f"[{extra}]" if extra else ""
    return [word for package in packages or PACKAGES for word in ("-e", f"./{package}{suffix}")]


def _install(session: nox.Session, *requirements: str) -> None:
    """Install unless the same requirements are already there, as a stamp in the environment tells.

    The local packages are named together in one command, so that no index answers for one of them.
    Sources are editable, so only a changed pyproject.toml calls for another install.
    """
    digest = hashlib.sha256(repr((sys.version, str(ROOT), requirements)).encode())
    for file in (TOOLS, *(ROOT / package / "pyproject.toml" for package in PACKAGES)):
        digest.update(file.read_bytes())
    stamp = Path(session.virtualenv.location) / "installed.sha256"
    if stamp.is_file() and stamp.read_text(encoding="ascii") == digest.hexdigest():
        session.log("environment is up to date")
        return
    stamp.unlink(missing_ok=True)
    session.log("installing; the first time this takes a minute or more, without a word")
    session.install(*requirements)
    stamp.write_text(digest.hexdigest(), encoding="ascii")


@nox.session
def lint(session: nox.Session) -> None:
    """Check style and formatting; `nox -s lint -- --fix` repairs what can be repaired."""
    _install(session, RUFF)
    if "--fix" in session.posargs:
        session.run("ruff", "check", "--fix", ".")
        session.run("ruff", "format", ".")
    else:
        session.run("ruff", "check", ".")
        session.run("ruff", "format", "--check", ".")


@nox.session
def tests(session: nox.Session) -> None:
    """Test the three packages but for what is slow; arguments after `--` go to pytest, `-- -m slow` tests the rest."""
    _install(session, *_editable("test"), "pytest-xdist>=3.6")
    workers = f"--numprocesses={min(4, os.cpu_count() or 1)}"
    asked = session.posargs or ("-m", "not slow")
    session.run("pytest", workers, "--dist=worksteal", *asked, env=_test_environment(session))


@nox.session
def demo(session: nox.Session) -> None:
    """Simulate, record, train, plan, fly, report into runs/demo; arguments after `--` go to `owm demo`."""
    _install(session, *_editable())
    session.run("owm", "demo", *session.posargs)


@nox.session
def build(session: nox.Session) -> None:
    """Build sdists and wheels into dist/, with nothing but the pinned tools beside them."""
    _install(session, "--require-hashes", "-r", str(TOOLS))
    dist = ROOT / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    for package in PACKAGES:
        # The wheel is built from the sdist, so this also shows that the sdist is complete.
        build = ["python", "-m", "build", "--no-isolation", "--outdir", str(dist), f"./{package}"]
        session.run(*build, silent=True)
    _check_contents(session, _built(session))


@nox.session
def wheels(session: nox.Session) -> None:
    """Try the wheels that `build` left in dist/ in a clean environment elsewhere."""
    _install(session, "--require-hashes", "-r", str(TOOLS))
    built = _built(session)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        session.run("python", "-m", "virtualenv", "--quiet", f"{folder}/venv")
        python = str(Path(folder, "venv", "Scripts/python.exe" if os.name == "nt" else "bin/python"))
        smoke = ROOT / "tests" / "wheels" / "smoke.py"
        with session.chdir(folder):
            # Files, not names: no index can offer something else under the same name and version.
            paths = [str(wheel) for wheel in built]
            session.run(python, "-m", "pip", "install", "--quiet", *paths, external=True)
            session.run(python, "-I", str(smoke), external=True, env={"PYTHONPATH": ""})


def _built(session: nox.Session) -> list[Path]:
    """The wheels in dist/."""
    built = sorted((ROOT / "dist").glob("*.whl"))
    if len(built) != len(PACKAGES):
        session.error(f"expected {len(PACKAGES)} wheels in dist/, found {[wheel.name for wheel in built]}")
    return built


def _check_contents(session: nox.Session, built: list[Path]) -> None:
    """Fail if a source file (code, data, py.typed) or the licence is missing from the wheels."""
    listings = {wheel.name: zipfile.ZipFile(wheel).namelist() for wheel in built}
    packed = {name for names in listings.values() for name in names}
    for package, module in PACKAGES.items():
        source = ROOT / package / "src"
        files = {path.relative_to(source) for path in (source / module).rglob("*") if path.is_file()}
        missing = sorted({path.as_posix() for path in files if "__pycache__" not in path.parts} - packed)
        if missing:
            session.error(f"{package}: the wheel lacks {missing}")
    for wheel, names in listings.items():
        if not any(name.endswith("/licenses/LICENSE") for name in names):
            session.error(f"{wheel}: no licence inside")


@nox.session
def lerobot(session: nox.Session) -> None:
    """Generate a small dataset with a camera, read it back with the real LeRobot, and lint it (brings torch: large)."""
    envs = _editable("lerobot,test", "outofthisworldmodel-envs")
    _install(session, *_editable("", "astrojax"), *envs, "lerobot-doctor>=0.2", "lerobot-lint>=0.1.1")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        config = Path(folder, "config.toml")
        config.write_text(LEROBOT_ENVIRONMENT, encoding="utf-8")
        dataset = str(Path(folder, "dataset"))
        arguments = ["--config", str(config), "--transitions", "2000", "--val-transitions", "400"]
        session.run("owm-envs", "generate", *arguments, "--out", dataset)
        session.run("owm-envs", "verify", dataset)
        offline = {"OWM_LEROBOT_DATASET": dataset, "HF_HUB_OFFLINE": "1"}
        session.run("pytest", "outofthisworldmodel-envs/tests_lerobot", *session.posargs, env=offline)


@nox.session
def browser(session: nox.Session) -> None:
    """Open the replay's page in Chromium, and its recording in Rerun (large); the system's Chromium if there is one."""
    _install(session, *_editable("", "astrojax"), *_editable("browser,rerun,test", "outofthisworldmodel-envs"))
    if not (os.environ.get("OWM_CHROMIUM") or any(map(shutil.which, CHROMIUM))):
        session.run("playwright", "install", "chromium")
    session.run("pytest", "outofthisworldmodel-envs/tests_browser", *session.posargs, env=_test_environment(session))


@nox.session
def docs(session: nox.Session) -> None:
    """Run the examples of astrojax's guide and build its site, astrojax/build/docs; a warning is an error."""
    _install(session, *_editable("docs", "astrojax"), RUFF)
    home = ROOT / "astrojax"
    guide = home / "docs" / "guide"
    (guide / "made").mkdir(exist_ok=True)
    # Compiled in haste, as in tests, but each time: what is printed of seconds should not be that of a cache.
    chosen = {"MPLBACKEND": "Agg", "XLA_FLAGS": _test_environment(session)["XLA_FLAGS"]}
    for page in sorted(guide.glob("*.md")):
        command = ["python", str(home / "examples" / f"{page.stem}.py"), *GUIDE.get(page.stem, ())]
        with (guide / "made" / f"{page.stem}.txt").open("w", encoding="utf-8") as said:
            session.run(*command, "--out", str(guide / "made"), stdout=said, stderr=sys.stderr, env=chosen)
    with session.chdir(home):
        session.run("zensical", "build", "--clean", "--strict", "--config-file", "mkdocs.yml")
        session.run("python", "tools/check_site.py")


@nox.session
@nox.parametrize("client", CLIENTS)
def hub(session: nox.Session, client: str) -> None:
    """Test push and download with the oldest and the newest client of the Hugging Face hub."""
    _install(session, *_editable("test"), f"huggingface-hub{client}")
    tests = ["outofthisworldmodel/tests/test_hub.py"]
    tests += [f"outofthisworldmodel-envs/tests/test_{name}.py" for name in ("dataset_hub", "endless")]
    session.run("pytest", *tests, *session.posargs, env=_test_environment(session))


@nox.session
def sb3(session: nox.Session) -> None:
    """Test adapter and PPO baseline with the real Stable-Baselines3, and video recorders (brings torch: large)."""
    envs = _editable("sb3,test", "outofthisworldmodel-envs")
    owm = _editable("ppo,test", "outofthisworldmodel")
    others = ("matplotlib>=3.8", "moviepy>=2", "array-api-compat>=1.11")
    _install(session, *_editable("", "astrojax"), *envs, *owm, *others)
    tests = ("outofthisworldmodel-envs/tests_sb3", "outofthisworldmodel/tests_ppo")
    session.run("pytest", *tests, *session.posargs, env=_test_environment(session))
