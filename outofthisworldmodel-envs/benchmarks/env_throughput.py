"""Steps per second, by fidelity, way of stepping and batch: `python benchmarks/env_throughput.py [--json FILE]`.

A full step is dynamics, attitude, swept collision with the 313 boxes, sensor noise, observation with goal error, reward
and automatic reset. "rollout" is a compiled loop of full steps, "physics" the same loop with the equations of motion
alone, "VectorEnv" and "Env" the Gymnasium environments stepped from Python, "AsyncVectorEnv" Gymnasium's own over the
scalar environment, a process each. Like `VectorEnv`, the loops fly a batch in pieces, one to a core. Rows of one
fidelity are measured in turns, several times, and the best turn counts: quote the ratios, absolute figures are this
machine's. Actions are a tenth of the limits, of random sign, held by each slot. Compilation is timed apart. With the
preset `rl` a step is a decision of 20 simulation steps.
"""

import argparse
import json
import resource
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AsyncVectorEnv
from rich.console import Console
from rich.table import Table

from astrojax.compilation import compiler_options
from owm_envs.adapters.batch import piece_count
from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.env import DockingEnv, restart_where

LOOP = 64
SHARE = 0.1


def actions_of(env: DockingEnv, batch: int) -> np.ndarray:
    """One action for each slot."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (batch, 6))
    return (SHARE * signs * np.asarray(env.layout.wrench_limit)).astype(env.config.precision)


class Loop:
    """A compiled loop over a batch, flown in pieces side by side."""

    def __init__(self, kind: str, batch: int, **config):
        with jax.enable_x64(True):
            env = DockingEnv(None, **config)
            params = env.default_params()
            pieces = piece_count(batch)
            size = batch // pieces
            keys = jax.random.split(jax.random.key(0), batch).reshape(pieces, size)
            reset = jax.jit(jax.vmap(lambda key: env.reset(params, key=key)))
            states = [reset(piece)[0] for piece in keys]
            actions = jnp.asarray(actions_of(env, batch)).reshape(pieces, size, 6)

            def physics(state, action):
                step = partial(env.dynamics.step, params)
                return state._replace(physics=jax.vmap(step, (0, 0, None))(state.physics, action, params.dt)), 0

            def full(state, action):
                state, result = jax.vmap(env.step, (None, 0, 0))(params, state, action)
                due = result.terminated | result.truncated
                state, observation = restart_where(env, params, due, state, result.observation)
                return state, (jnp.sum(observation["state"]), jnp.sum(result.reward))

            def loop(state, action):
                one = physics if kind == "physics" else full
                return jax.lax.scan(lambda state, _: one(state, action), state, length=LOOP)

            began = time.perf_counter()
            program = jax.jit(loop, compiler_options=compiler_options()).lower(states[0], actions[0]).compile()
            self.compile_s = time.perf_counter() - began
        self._program, self._states, self._actions = program, states, actions
        self._pool = ThreadPoolExecutor(pieces)
        self.steps = LOOP * batch
        self.traces = None

    def run(self) -> None:
        """Some steps of every slot."""

        def one(piece):
            with jax.enable_x64(True):
                return jax.block_until_ready(self._program(self._states[piece], self._actions[piece])[0])

        self._states = list(self._pool.map(one, range(len(self._states))))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


class Stepped:
    """An environment stepped from Python."""

    def __init__(self, kind: str, batch: int, **config):
        began = time.perf_counter()
        self._scalar = kind == "Env"
        if self._scalar:
            self._env = DockingGymEnv(None, **config)
        elif kind == "VectorEnv":
            self._env = DockingVectorEnv(batch, autoreset_mode="same_step", **config)
        else:
            self._env = AsyncVectorEnv([partial(DockingGymEnv, None, **config)] * batch, context="spawn")
        actions = actions_of(DockingEnv(None, **config), batch).astype(np.float32)
        self._action = actions[0] if self._scalar else actions
        self._env.reset(seed=0)
        self._env.step(self._action)
        self.compile_s = time.perf_counter() - began
        self._calls = 200 if self._scalar else max(4, 16_384 // batch)
        self.steps = self._calls * batch
        self.traces = None if kind == "AsyncVectorEnv" else self._env.traces

    def run(self) -> None:
        """Some steps of every slot."""
        for _ in range(self._calls):
            ended = self._env.step(self._action)
            if self._scalar and (ended[2] or ended[3]):
                self._env.reset()

    def close(self) -> None:
        """Close the environment."""
        self._env.close()


def measure(rows: list[tuple[str, int, dict]], turns: int, console: Console) -> list[dict]:
    """Throughput of each row (kind, batch, configuration), measured in turns."""
    running = []
    for kind, batch, config in rows:
        console.print(f"compiling {kind}, {batch} ...")
        running.append((Loop if kind in ("physics", "rollout") else Stepped)(kind, batch, **config))
    best = [float("inf")] * len(rows)
    for turn in range(turns + 1):
        for index, runner in enumerate(running):
            began = time.perf_counter()
            runner.run()
            if turn:  # the first one warms up
                best[index] = min(best[index], (time.perf_counter() - began) / runner.steps)
    for runner in running:
        runner.close()
    return [
        {
            "fidelity": config["fidelity"],
            "precision": config.get("precision", "float64"),
            "noise": config.get("noise", "none"),
            "preset": config.get("preset", "data"),
            "kind": kind,
            "batch": batch,
            "steps_per_s": 1 / seconds,
            "compile_s": runner.compile_s,
            "traces": runner.traces,
        }
        for (kind, batch, config), seconds, runner in zip(rows, best, running)
    ]


def plan(batch: int, batches: list[int], processes: list[int], quick: bool) -> list[list[tuple[str, int, dict]]]:
    """The rows, in groups whose figures are compared with each other."""
    noisy = {"fidelity": "iss-numerical", "noise": "cooperative"}
    groups = [
        [
            ("physics", batch, noisy),
            ("rollout", batch, noisy | {"noise": "none"}),
            ("rollout", batch, noisy),
            ("VectorEnv", batch, noisy),
            ("physics", batch, noisy | {"precision": "float32"}),
            ("rollout", batch, noisy | {"precision": "float32"}),
        ]
    ]
    if quick:
        return groups
    for fidelity in ("iss-hcw", "iss"):
        config = noisy | {"fidelity": fidelity}
        groups.append([(kind, batch, config) for kind in ("physics", "rollout", "VectorEnv")])
    groups.append([("Env", 1, noisy), *(("AsyncVectorEnv", n, noisy) for n in processes), ("VectorEnv", batch, noisy)])
    decisions = noisy | {"preset": "rl"}
    groups += [[("rollout", n, noisy), ("VectorEnv", n, noisy)] for n in batches]
    groups += [[("rollout", n, decisions), ("VectorEnv", n, decisions)] for n in (256, 1024, 4096)]
    return groups


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", default="env_throughput.json")
    parser.add_argument("--turns", type=int, default=8, help="measurements of each row")
    parser.add_argument("--batch", type=int, default=1024)
    parser.add_argument(
        "--batches", type=int, nargs="*", default=[1, 16, 128, 1024, 4096, 16_384], help="of the scaling"
    )
    parser.add_argument("--processes", type=int, nargs="*", default=[2, 8], help="environments of AsyncVectorEnv")
    parser.add_argument("--quick", action="store_true", help="iss-numerical alone, at one batch")
    options = parser.parse_args()
    console = Console(stderr=True)
    groups = [
        measure(group, options.turns, console)
        for group in plan(options.batch, options.batches, options.processes, options.quick)
    ]
    table = Table("fidelity", "precision", "noise", "preset", "way", "batch", "steps/s", "of first", "compile s")
    for rows in groups:
        for row in rows:
            row["ratio"] = row["steps_per_s"] / rows[0]["steps_per_s"]
            table.add_row(
                *(row[name] for name in ("fidelity", "precision", "noise", "preset", "kind")),
                f"{row['batch']}",
                f"{row['steps_per_s']:,.0f}",
                f"{row['ratio']:.2f}",
                f"{row['compile_s']:.1f}",
            )
        table.add_section()
    Console(width=110).print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of this process: {peak:,.0f} MiB; 'of first' compares with the first row of each block")
    with open(options.json, "w", encoding="utf-8") as file:
        json.dump({"rows": [row for rows in groups for row in rows], "peak_mib": peak}, file, indent=1)


if __name__ == "__main__":
    main()
