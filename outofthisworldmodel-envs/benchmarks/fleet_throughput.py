"""Chaser-steps per second of the fleet against lone chasers: `python benchmarks/fleet_throughput.py [--json FILE]`.

Compiled rollouts of full steps (dynamics, swept collision, cooperative noise, observation, reward), the same number of
chasers in every row of a fidelity: alone, then three and eight to a station. A fleet adds contact between chasers and
what they measure of each other, and propagates the station once for all. Compilation is timed apart; quote the ratios.
"""

import argparse
import json
import time

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from owm_envs.config import FIDELITIES
from owm_envs.env import DockingEnv, FleetEnv

STEPS = 50


def measure(fidelity: str, per_station: int, seen: bool, chasers: int, seconds: float) -> dict[str, float | int | str]:
    """Throughput of `chasers` chasers, `per_station` to an episode; 1 is `DockingEnv`."""
    task = {"fidelity": fidelity, "noise": "cooperative"}
    env = DockingEnv(**task) if per_station == 1 else FleetEnv(per_station, observe_others=seen, **task)
    episodes = chasers // per_station
    params = env.default_params()
    states, _ = jax.jit(jax.vmap(lambda key: env.reset(params, key=key)))(jax.random.split(jax.random.key(0), episodes))
    actions = jnp.zeros((episodes, 6) if per_station == 1 else (episodes, per_station, 6))

    @jax.jit
    def rollout(params, states):
        def step(states, _):
            states, result = jax.vmap(env.step, (None, 0, 0))(params, states, actions)
            return states, jnp.sum(result.reward) + jnp.sum(result.observation["state"])

        return jax.lax.scan(step, states, length=STEPS)

    began = time.perf_counter()
    jax.block_until_ready(rollout(params, states))
    first = time.perf_counter() - began
    calls, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        jax.block_until_ready(rollout(params, states))
        calls += 1
    rate = calls * STEPS * episodes * per_station / (time.perf_counter() - began)
    return {
        "fidelity": fidelity,
        "chasers_per_station": per_station,
        "others_seen": seen,
        "chasers": episodes * per_station,
        "first_s": first,
        "chaser_steps_per_s": rate,
    }


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", default="fleet_throughput.json")
    parser.add_argument("--seconds", type=float, default=2.0, help="of measurement per row")
    parser.add_argument("--fidelities", nargs="*", default=FIDELITIES)
    parser.add_argument("--per-station", type=int, nargs="*", default=[3, 8])
    parser.add_argument("--chasers", type=int, default=1536)
    options = parser.parse_args()
    rows = []
    with jax.enable_x64(True):
        for fidelity in options.fidelities:
            kinds = [(1, False)] + [(count, seen) for count in options.per_station for seen in (False, True)]
            alone, *fleets = [measure(fidelity, *kind, options.chasers, options.seconds) for kind in kinds]
            for row in [alone, *fleets]:
                rows.append({**row, "ratio": row["chaser_steps_per_s"] / alone["chaser_steps_per_s"]})
    table = Table("fidelity", "per station", "others seen", "chasers", "chaser-steps/s", "of alone", "first call s")
    for row in rows:
        table.add_row(
            row["fidelity"],
            f"{row['chasers_per_station']}",
            "yes" if row["others_seen"] else "no",
            f"{row['chasers']}",
            f"{row['chaser_steps_per_s']:,.0f}",
            f"{row['ratio']:.2f}",
            f"{row['first_s']:.1f}",
        )
    Console().print(table)
    with open(options.json, "w", encoding="utf-8") as file:
        json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
