"""Shapes and dtypes of every public annotation are checked while the tests run."""

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
