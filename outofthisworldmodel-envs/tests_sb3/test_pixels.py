"""Pixels under the real Stable-Baselines3: its check, its image policies, and the example with few steps."""

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecTransposeImage

from owm_envs.adapters.gymnasium import DockingGymEnv
from owm_envs.sb3 import make_vec_env

EXAMPLE = Path(__file__).parents[2] / "examples" / "pixels_sb3.py"
SEEING = {"horizon": 3.0, "camera": {"width": 16, "height": 16, "every": 2}}  # three decisions an episode


@pytest.mark.parametrize("observation", ["pixels", "state+pixels"])
def test_the_scalar_environment_passes_their_check(observation):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*minimal resolution")  # theirs for their own network
        env = DockingGymEnv(fidelity="iss-hcw", preset="rl", normalize=True, observation=observation, **SEEING)
        check_env(env, skip_render_check=True)


def test_terminal_observations_have_their_pictures():
    venv = VecTransposeImage(make_vec_env("iss-hcw", 2, seed=5, observation="state+pixels", **SEEING))
    observation = venv.reset()
    assert observation["pixels"].shape == (2, 3, 16, 16) and observation["pixels"].dtype == np.uint8
    for _ in range(3):
        observation, _, done, infos = venv.step(np.zeros((2, 6), np.float32))
    assert done.all()
    for slot, info in enumerate(infos):
        last = info["terminal_observation"]
        assert last["pixels"].shape == (3, 16, 16) and info["pixels_age"] == 1
        assert not np.array_equal(last["pixels"], observation["pixels"][slot])


@pytest.mark.parametrize("observation", ["pixels", "state+pixels"])
def test_the_example_trains(observation, tmp_path):
    sizes = ["--steps", "32", "--envs", "2", "--size", "16", "--horizon", "8"]
    command = [sys.executable, str(EXAMPLE), "--observation", observation, *sizes, "--out", str(tmp_path)]
    said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=600).stdout
    assert "32 steps" in said and (tmp_path / f"{observation.replace('+', '_')}.zip").is_file()
