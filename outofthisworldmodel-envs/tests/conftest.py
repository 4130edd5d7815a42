import functools
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

# Tests are imported by path, not from a package, so what they share has to be made findable.
sys.path.insert(0, str(Path(__file__).parent))

import seeing

from owm_envs.config import FIDELITIES
from owm_envs.datasets.generate import generate
from owm_envs.env import DockingEnv


@pytest.fixture(params=FIDELITIES)
def fidelity(request):
    return request.param


@pytest.fixture
def x64():
    """JAX's 64-bit mode for the length of a test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def docking():
    """Builds (env, params, jitted reset, jitted step), compiled once a structure and session; use within `x64`."""

    @functools.cache
    def programs(env):
        return jax.jit(env.reset), jax.jit(env.step)

    def build(**overrides):
        env = DockingEnv(None, **overrides)
        return env, env.default_params(), *programs(env)

    return build


@pytest.fixture(scope="session")
def place():
    """Puts a docking state at a relative view at rest with respect to its bookkeeping."""

    def placed(env, params, state, view):
        return env.relocate(params, state, jax.numpy.asarray(np.asarray(view, np.float64)))

    return placed


@pytest.fixture(scope="session")
def seeing_run(tmp_path_factory):
    """The folder of a small recording with video; not to be written to."""
    folder = tmp_path_factory.mktemp("seeing") / "set"
    generate(folder, seeing.CONFIG, seeing.REQUEST)
    return folder
