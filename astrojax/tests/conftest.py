"""Shapes and dtypes of every public annotation are checked while the tests run."""

import functools
import sys

from jaxtyping import install_import_hook

# pytest's importlib mode names this file after its path, `astrojax.tests.conftest`, which has just put an
# empty namespace over the folder `astrojax` where the package belongs.
if getattr(sys.modules.get("astrojax"), "__file__", None) is None:
    sys.modules.pop("astrojax", None)

with install_import_hook("astrojax", "beartype.beartype"):
    import astrojax  # noqa: F401

import brahe
import jax
import numpy as np
import pytest


@pytest.fixture(scope="session", autouse=True)
def _no_downloads():
    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())


@pytest.fixture
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def rng():
    return np.random.default_rng(20260801)


def _jit(**options):
    """`jax.jit` with XLA's options, where it knows them."""
    try:
        jax.jit(lambda x: x, compiler_options=options)(1.0)
    except jax.errors.JaxRuntimeError:
        options = None
    return functools.partial(jax.jit, compiler_options=options)


@pytest.fixture(scope="session")
def quick():
    """`jax.jit` that skips optimisation: most of the time goes into compiling."""
    return _jit(xla_backend_optimization_level=0, xla_cpu_use_fusion_emitters=False)


@pytest.fixture(scope="session")
def optimised():
    """`jax.jit` as users have it, whatever the tests' flags."""
    return _jit(
        xla_backend_optimization_level=3, xla_llvm_disable_expensive_passes=False, xla_cpu_use_fusion_emitters=True
    )
