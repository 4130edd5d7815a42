"""Environments in forked processes: they fly if the parent has not used JAX, and say so at once if it has."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
FLY = """
import multiprocessing, sys
import gymnasium, owm_envs

if __name__ == "__main__":
    multiprocessing.set_start_method("fork", force=True)  # what Linux does by itself before Python 3.14
    used = sys.argv[1] == "used"
    if used:
        import jax
        jax.numpy.zeros(3).block_until_ready()
    if sys.argv[2] == "AsyncVectorEnv":
        envs = gymnasium.vector.AsyncVectorEnv([lambda: gymnasium.make("ISS-v0", horizon=0.2)] * 2)
    else:
        module = gymnasium if sys.argv[2] == "gymnasium.make_vec" else owm_envs
        envs = module.make_vec("ISS-v0", num_envs=1, vectorization_mode="async", horizon=0.2)
    try:
        observation, _ = envs.reset(seed=0)
        observation, *_ = envs.step(envs.action_space.sample())
        print("flew", observation.shape[0])
    except RuntimeError as error:
        print("refused", 'context="spawn"' in str(error))
    finally:
        envs.close(terminate=True)
"""


@pytest.mark.parametrize(
    ("parent", "made", "expected"),
    [
        ("fresh", "owm_envs.make_vec", "flew 1"),
        ("used", "AsyncVectorEnv", "refused True"),
        ("used", "gymnasium.make_vec", "refused True"),
    ],
)
def test_a_forked_environment_flies_or_says_why_not(tmp_path, parent, made, expected):
    script = tmp_path / "fly.py"
    script.write_text(FLY, encoding="utf-8")
    command = [sys.executable, str(script), parent, made]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.stdout.split("\n")[0] == expected, done.stderr[-2000:]


def test_no_constructor_starts_jax():
    code = (
        "import gymnasium, owm_envs, jax\n"
        "from owm_envs.pettingzoo import parallel_env\n"
        "from owm_envs.registration import IDS\n"
        "for name in ('ISS-v0', 'ISSHCW-v0', 'ISSNumerical-v0'):\n"
        "    gymnasium.make(name), gymnasium.make_vec(name, num_envs=2), parallel_env(2, fidelity=IDS[name])\n"
        "from jax._src import xla_bridge\n"
        "print(len(xla_bridge._backends))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "0\n", done.stderr[-2000:]
