"""Try the installed wheels from an empty folder: `python -I smoke.py`, run by `nox -s wheels`.

Everything must come from the environment's own site-packages, and the three environments must fly.
"""

import importlib
import math
import shutil
import subprocess
import sys
import sysconfig
from importlib.metadata import files, version
from pathlib import Path

DISTRIBUTIONS = {
    "outofthisworldmodel-astrojax": "astrojax",
    "outofthisworldmodel-envs": "owm_envs",
    "outofthisworldmodel": "owm",
}
IDS = ["ISS-v0", "ISSHCW-v0", "ISSNumerical-v0"]


def check(condition: bool, message: str) -> None:
    """Like `assert`, also under `python -O`."""
    if not condition:
        raise SystemExit(f"smoke test failed: {message}")


def check_light_import() -> None:
    """`import owm_envs` only registers the ids: it must stay quick."""
    import owm_envs  # noqa: F401

    loaded = {"jax", "torch"} & set(sys.modules)
    check(not loaded, f"import owm_envs also imported {sorted(loaded)}")


def check_files() -> None:
    site = Path(sysconfig.get_path("purelib")).resolve()
    versions = {name: version(name) for name in DISTRIBUTIONS}
    check(len(set(versions.values())) == 1, f"versions differ: {versions}")
    for distribution, module in DISTRIBUTIONS.items():
        found = Path(importlib.import_module(module).__file__).resolve()
        check(site in found.parents, f"{module} was imported from {found}, not from {site}")
        check((found.parent / "py.typed").is_file(), f"{module} has no py.typed")
        absent = [str(entry) for entry in files(distribution) if not Path(entry.locate()).is_file()]
        check(not absent, f"{distribution} lists files that are not there: {absent}")


def check_environments() -> None:
    import gymnasium
    import numpy as np

    for name in IDS:
        env = gymnasium.make(f"owm_envs:{name}")
        observation, _ = env.reset(seed=0)
        check(observation in env.observation_space, f"{name}: the reset observation is outside its space")
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        check(observation in env.observation_space, f"{name}: the step observation is outside its space")
        check(bool(np.isfinite(observation).all()), f"{name}: the observation is not finite: {observation}")
        check(math.isfinite(float(reward)), f"{name}: the reward is {reward}")
        check(not (terminated or truncated), f"{name}: the episode ended on its first step")
        env.close()
        print(f"{name}: flies", flush=True)

    envs = gymnasium.make_vec("owm_envs:ISS-v0", num_envs=2)
    observations, _ = envs.reset(seed=0)
    check(observations.shape[0] == 2, f"the vector environment returned shape {observations.shape}")
    _, rewards, *_ = envs.step(envs.action_space.sample())
    check(np.shape(rewards) == (2,), f"the vector environment returned rewards of shape {np.shape(rewards)}")
    envs.close()
    print("vector environment: flies", flush=True)


def check_commands() -> None:
    scripts = sysconfig.get_path("scripts")
    for name in ("owm", "owm-envs"):
        command = shutil.which(name, path=scripts)
        check(command is not None, f"no command {name} in {scripts}")
        result = subprocess.run([command, "--help"], capture_output=True, text=True, timeout=120)
        check(result.returncode == 0, f"{name} --help ended with {result.returncode}: {result.stderr}")
        check("usage" in result.stdout.lower(), f"{name} --help shows no usage: {result.stdout!r}")
        print(f"{name} --help: works", flush=True)


if __name__ == "__main__":
    check_light_import()
    check_files()
    check_environments()
    check_commands()
    print(f"wheels work on Python {sys.version.split()[0]}")
