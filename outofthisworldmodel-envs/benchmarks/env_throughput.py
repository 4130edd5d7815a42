"""Steps per second of each fidelity, by adapter and batch: `python benchmarks/env_throughput.py [--json FILE]`.

Full steps: dynamics, swept collision, cooperative noise, observation with goal error, reward, automatic reset. Every
fidelity is measured in the same process, scalar and batched in turn; quote the ratios, absolute figures are this
machine's. Compilation is timed apart, as the first call.
"""

import argparse
import json
import time

import gymnasium
import numpy as np
from rich.console import Console
from rich.table import Table

import owm_envs  # noqa: F401 - registers the ids
from owm_envs.registration import IDS


def measure(name: str, batch: int | None, seconds: float) -> dict[str, float | str | dict]:
    """Throughput of one environment, the scalar one when `batch` is None."""
    began = time.perf_counter()
    if batch is None:
        env = gymnasium.make(name, noise="cooperative")
        action = np.zeros(6, np.float32)
    else:
        env = gymnasium.make_vec(name, num_envs=batch, noise="cooperative")
        action = np.zeros((batch, 6), np.float32)
    env.reset(seed=0)
    env.step(action)
    first = time.perf_counter() - began
    calls, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        env.step(action)
        calls += 1
    rate = calls * (batch or 1) / (time.perf_counter() - began)
    return {
        "id": name,
        "adapter": "scalar" if batch is None else "vector",
        "batch": batch or 1,
        "first_s": first,
        "steps_per_s": rate,
        "traces": env.unwrapped.traces,
    }


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", default="env_throughput.json")
    parser.add_argument("--seconds", type=float, default=3.0, help="of measurement per row")
    parser.add_argument("--batches", type=int, nargs="*", default=[1, 64, 1024])
    options = parser.parse_args()
    rows = []
    for name in [name for name in IDS if name.endswith("-v0")]:
        rows += [measure(name, batch, options.seconds) for batch in [None, *options.batches]]
    table = Table("id", "adapter", "batch", "steps/s", "of scalar", "first call s", "traces")
    for row in rows:
        scalar = next(r["steps_per_s"] for r in rows if r["id"] == row["id"])
        table.add_row(
            row["id"],
            row["adapter"],
            f"{row['batch']}",
            f"{row['steps_per_s']:,.0f}",
            f"{row['steps_per_s'] / scalar:.0f}x",
            f"{row['first_s']:.1f}",
            f"{row['traces']['reset']} + {row['traces']['step']}",
        )
    Console().print(table)
    with open(options.json, "w", encoding="utf-8") as file:
        json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
