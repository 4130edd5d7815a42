"""What the tests of all three packages share: JAX's strictness flags, how hard XLA tries, a local hub."""

import contextlib
import functools
import gc
import os
import sys
from pathlib import Path

import jax
import pytest

# Tests are imported by path, not from a package, so their common helper has to be made findable.
sys.path.insert(0, str(Path(__file__).parent / "tests"))

from local_hub import LocalHub

pytest_plugins = ["costs"]

# Tracing makes objects by the million, few of them in circles: by default the collector takes a tenth of the time.
gc.set_threshold(100_000, 50, 50)
# To wait for the disk costs more than all else that writes; `test_files.py` sees to it that it is waited for.
os.fsync = lambda descriptor: None

STRICT = {
    "numpy_dtype_promotion": "strict",
    "numpy_rank_promotion": "raise",
    "legacy_prng_key": "error",
    "check_static_indices": True,
}
"""Of these each raises an error of its own while a program is traced, so they can be tried together."""


@pytest.fixture(scope="session")
def jax_flags():
    """A context manager that sets flags of JAX's for every thread; `strict` stands for all of `STRICT`."""

    @contextlib.contextmanager
    def flags(*, strict: bool = False, **values):
        values = {**(STRICT if strict else {}), **values}
        before = {name: jax.config.values[f"jax_{name}"] for name in values}
        try:
            for name, value in values.items():
                jax.config.update(f"jax_{name}", value)
            yield
        finally:
            for name, value in before.items():
                jax.config.update(f"jax_{name}", value)

    return flags


@pytest.fixture(scope="module", autouse=True)
def room_for_programs():
    """Forget compiled programs before Linux runs out of the areas of memory that it lets a process map (65 530)."""
    yield
    areas = Path("/proc/self/maps")
    if areas.exists() and areas.read_bytes().count(b"\n") > 30_000:
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def said_by(capsys):
    """Runs a command; gives its exit code, and what it printed or the line that says why not."""

    def run(main, *arguments):
        code = 0
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as stop:
            code = stop.code
        said = capsys.readouterr()
        return code, said.out.strip() if code == 0 else said.err.splitlines()[-1]

    return run


@pytest.fixture
def local_hub(tmp_path, monkeypatch):
    """A hub on this machine, which the real client takes for the hub; its cache is the test's own."""
    constants = pytest.importorskip("huggingface_hub.constants")
    hub = LocalHub()
    # The client reads its settings when it is imported; these are where it keeps them.
    monkeypatch.setattr(constants, "ENDPOINT", hub.address)
    template = hub.address + "/{repo_id}/resolve/{revision}/{filename}"
    for module in (constants, pytest.importorskip("huggingface_hub.file_download")):  # older clients copy it
        monkeypatch.setattr(module, "HUGGINGFACE_CO_URL_TEMPLATE", template, raising=False)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache" / "hub"))
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "token"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    # Newer clients send large files by Xet alone, where its package is installed and not switched off.
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.delenv("HF_TOKEN", raising=False)
    yield hub
    hub.close()


def _jit(**options):
    """`jax.jit` with XLA's options, where it knows them."""
    try:
        jax.jit(lambda x: x, compiler_options=options)(1.0)
    except jax.errors.JaxRuntimeError:
        options = None
    return functools.partial(jax.jit, compiler_options=options)


@pytest.fixture(scope="session")
def quick():
    """`jax.jit` that skips optimisation: for programs that run once."""
    return _jit(xla_backend_optimization_level=0, xla_cpu_use_fusion_emitters=False)


@pytest.fixture(scope="session")
def optimised():
    """`jax.jit` as users have it, whatever the tests' flags: for roundings, and for programs that run long."""
    return _jit(
        xla_backend_optimization_level=3, xla_llvm_disable_expensive_passes=False, xla_cpu_use_fusion_emitters=True
    )


@pytest.fixture(scope="session")
def quick_fields(optimised):
    """Fields of the station are solved by optimised code, whatever the tests' flags: five times as fast."""
    from owm_envs.field import eikonal, geodesic

    statics = {"grid_clearance": ("grid",), "solve_fine": ("grid", "config"), "_least_sum": ()}
    with pytest.MonkeyPatch.context() as patch:
        for name, static in statics.items():
            made = optimised(getattr(eikonal, name).__wrapped__, static_argnames=static)
            for module in (eikonal, geodesic):
                if hasattr(module, name):
                    patch.setattr(module, name, made)
        yield


@pytest.fixture(scope="module")
def quick_drifts(optimised):
    """Policies that look at thousands of free drifts act by optimised code, whatever the tests' flags."""
    from owm_envs.policies import vector

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vector, "_advance", optimised(vector._advance.__wrapped__))
        yield
