"""The examples in reduced form: they learn, gradients are right, what they save reads back; the tutorial runs."""

import importlib.util
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from owm_envs.config import load_config
from owm_envs.datasets import Request, generate
from owm_envs.env import DockingEnv

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def ppo():
    """The PPO example as a module."""
    spec = importlib.util.spec_from_file_location("train_jax_ppo", EXAMPLES / "train_jax_ppo.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(name: str, *options: str) -> str:
    """What an example prints, run as a program; compiled in haste, since it runs but once."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *options]
    done = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, timeout=300, env={**os.environ, "XLA_FLAGS": flags}
    )
    return done.stdout


@pytest.mark.slow
def test_the_tutorial_runs_and_is_kept_without_outputs(tmp_path):
    notebook = nbformat.read(EXAMPLES / "tutorial.ipynb", as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    here = {"metadata": {"path": str(tmp_path)}}
    # What must hold is asserted in its cells: one that fails raises here.
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=here).execute()
    pictures = [output for cell in code for output in cell.outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 2


@pytest.mark.slow
def test_shooting_docks_by_a_gradient_that_equals_finite_differences(tmp_path):
    said = run("shooting", "--fidelity", "iss", "--seconds", "45", "--iterations", "6", "--out", str(tmp_path))
    pairs = re.findall(r"reverse mode (\S+) +central difference (\S+)", said)
    assert len(pairs) == 3
    for ours, difference in pairs:
        assert float(ours) == pytest.approx(float(difference), rel=1e-5)
    costs = [float(row) for row in re.findall(r"^ +\d+ +(\S+)(?: +\S+){5}$", said, re.MULTILINE)]
    assert len(costs) >= 4 and (np.diff(costs) < 0).all() and costs[-1] < 1e-3 * costs[0]
    assert ": docked after" in said and "hull not touched" in said
    assert (tmp_path / "shooting.png").stat().st_size > 0


@pytest.mark.slow
def test_pilots_learn_side_by_side_and_read_back(tmp_path):
    options = ["--fidelity", "iss", "--updates", "8", "--chunk", "4", "--envs", "64", "--horizon", "30", "--seeds", "2"]
    said = run("train_jax_ppo", *options, "--out", str(tmp_path))
    figures = [line[27:] for line in said.splitlines() if "return" in line]
    returns = [float(re.search(r"return +(\S+)", text)[1]) for text in figures]
    assert len(figures) == 5  # no thrust, before, two calls of four updates, and read back from the file
    assert figures[-1] == figures[-2]
    assert returns[-1] > returns[1] + 1
    with np.load(tmp_path / "pilot.npz") as saved:
        assert {len(leaf) for leaf in saved.values()} == {2}
        assert all((leaf[0] != leaf[1]).any() for name, leaf in saved.items() if "actor" in name)
    assert (tmp_path / "learning_curve.png").stat().st_size > 0


def test_windows_stream_through_grain_and_are_taken_up_again(tmp_path):
    pytest.importorskip("grain")
    config = load_config(fidelity="iss", noise="none", horizon=6.0, ports=["zvezda_aft"])
    generate(tmp_path / "set", config, Request(200, 120, seed=1, episodes_per_batch=8))
    said = run("load_grain", str(tmp_path / "set"), "--batch", "4", "--batches", "3")
    assert "observation.state: (4, 24, 13) float32" in said and "action: (4, 23, 6) float32" in said
    assert "3 batches" in said and said.endswith("taken up again: the same\n")


@pytest.mark.slow
def test_a_pilot_bootstraps_from_where_the_horizon_cut_it_off(ppo):
    env = DockingEnv(fidelity="iss", precision="float32", normalize=True, horizon=0.1)  # two decisions
    params = env.default_params()
    begin = jax.jit(jax.vmap(partial(ppo.start, env, params)))
    agent = ppo.new_agent(*begin(jax.random.split(jax.random.key(0), 3)), jax.random.key(0))
    decide = partial(ppo.decide, env, params, agent.pilot)
    keys = jax.random.split(jax.random.key(1), 2)
    flown, rows = jax.jit(lambda slots: jax.lax.scan(decide, slots, keys))(agent.slots)
    np.testing.assert_array_equal(rows["done"], [[False] * 3, [True] * 3])
    assert not rows["terminated"].any()
    np.testing.assert_array_equal(rows["last"][0], rows["features"][1])
    jump = np.linalg.norm(rows["last"][1][:, :3] - flown.features[:, :3], axis=1)
    drift = np.linalg.norm(rows["last"][1][:, :3] - rows["last"][0][:, :3], axis=1)
    assert jump.min() > 20 * drift.max()  # the next episode starts elsewhere
    np.testing.assert_allclose(rows["episode"]["return"][1], rows["reward"].sum(0), rtol=1e-6)
    assert not flown.earned.any() and not flown.discounted.any()


def test_advantages_equal_their_definition(ppo):
    draws = np.random.default_rng(0)
    steps, slots = 12, 4
    values, following, reward = draws.normal(size=(3, steps, slots)).astype(np.float32)
    done = draws.uniform(size=(steps, slots)) < 0.3
    terminated = done & (draws.uniform(size=(steps, slots)) < 0.5)
    want = np.zeros((steps, slots))
    for slot in range(slots):
        for first in range(steps):  # the discounted sum of surprises up to the episode's end
            for step in range(first, steps):
                future = 0.0 if terminated[step, slot] else following[step, slot]
                surprise = reward[step, slot] + ppo.GAMMA * future - values[step, slot]
                want[first, slot] += (ppo.GAMMA * ppo.LAMBDA) ** (step - first) * surprise
                if done[step, slot]:
                    break
    ours = ppo.advantages(*map(jnp.asarray, (values, following, reward, terminated, done)))
    np.testing.assert_allclose(ours, want, rtol=1e-4, atol=1e-5)


def test_moments_in_parts_equal_those_of_the_whole(ppo):
    rows = np.random.default_rng(0).normal(3, 2, size=(100, 5)).astype(np.float32)
    moments = ppo.Moments(jnp.zeros(5), jnp.ones(5), jnp.float32(1e-6))
    for part in np.split(rows, [10, 45]):
        moments = moments.merge(jnp.asarray(part))
    np.testing.assert_allclose(moments.mean, rows.mean(0), rtol=1e-4)
    np.testing.assert_allclose(moments.variance, rows.var(0), rtol=1e-4)
