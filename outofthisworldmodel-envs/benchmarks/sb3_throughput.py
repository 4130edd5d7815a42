"""Frames a second under Stable-Baselines3: our `VecEnv` against its own over the scalar environment.

`python benchmarks/sb3_throughput.py [--json FILE]`. A frame is one decision of one environment: under the preset "rl",
20 simulation steps with swept collision, noise, observation, reward and automatic reset. All rows run in one go, on
the same actions; quote the ratios, absolute figures are this machine's. Starting the processes and compiling are
timed apart, up to the end of the first step.
"""

import argparse
import json
import time
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from owm_envs.adapters.gymnasium import DockingGymEnv
from owm_envs.sb3 import make_vec_env


def build(kind: str, fidelity: str, count: int) -> VecEnv:
    """One of the three kinds of `VecEnv`, all of the same task."""
    if kind == "ours":
        return make_vec_env(fidelity, count, noise="cooperative")
    if kind == "ours, infos=all":
        return make_vec_env(fidelity, count, noise="cooperative", infos="all")
    scalar = partial(DockingGymEnv, fidelity=fidelity, preset="rl", normalize=True, noise="cooperative")
    return DummyVecEnv([scalar] * count) if kind == "DummyVecEnv" else SubprocVecEnv([scalar] * count, "spawn")


def measure(kind: str, fidelity: str, count: int, seconds: float) -> dict[str, float | str]:
    """Frames a second of one kind."""
    actions = np.random.default_rng(0).uniform(-1, 1, (64, count, 6)).astype(np.float32)
    began = time.perf_counter()
    venv = build(kind, fidelity, count)
    venv.seed(0)
    venv.reset()
    venv.step(actions[0])
    first = time.perf_counter() - began
    calls, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        venv.step(actions[calls % 64])
        calls += 1
    rate = calls * count / (time.perf_counter() - began)
    venv.close()
    return {"fidelity": fidelity, "kind": kind, "n_envs": count, "first_s": first, "frames_per_s": rate}


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", default="sb3_throughput.json")
    parser.add_argument("--seconds", type=float, default=3.0, help="of measurement per row")
    parser.add_argument("--fidelities", nargs="*", default=["iss-hcw", "iss-numerical"])
    parser.add_argument("--processes", type=int, nargs="*", default=[2, 8], help="environments of SubprocVecEnv")
    parser.add_argument("--batches", type=int, nargs="*", default=[8, 256, 1024], help="environments of ours")
    options = parser.parse_args()
    rows = []
    for fidelity in options.fidelities:
        rows.append(measure("DummyVecEnv", fidelity, max(options.processes), options.seconds))
        rows += [measure("SubprocVecEnv", fidelity, count, options.seconds) for count in options.processes]
        rows += [measure("ours", fidelity, count, options.seconds) for count in options.batches]
        rows.append(measure("ours, infos=all", fidelity, max(options.batches), options.seconds))
    table = Table("fidelity", "VecEnv", "n_envs", "frames/s", "of best SubprocVecEnv", "first step s")
    for row in rows:
        peers = [r for r in rows if r["fidelity"] == row["fidelity"] and r["kind"] == "SubprocVecEnv"]
        row["ratio"] = row["frames_per_s"] / max(peer["frames_per_s"] for peer in peers)
        table.add_row(
            row["fidelity"],
            row["kind"],
            f"{row['n_envs']}",
            f"{row['frames_per_s']:,.0f}",
            f"{row['ratio']:.2f}x",
            f"{row['first_s']:.1f}",
        )
    Console().print(table)
    with open(options.json, "w", encoding="utf-8") as file:
        json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
