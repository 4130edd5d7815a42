"""Fly for a long time under random and extreme actions: `python benchmarks/soak.py [--steps 1e8] [--json FILE]`.

Steps are shared out between the fidelities. Starts lie anywhere within the escape radius, the hull's inside included,
fast and spinning; slots restart when their episode ends and now and then before; horizons run from 5 s to 360 s and
docking is made easy, so that every outcome occurs. Half of the slots take a fresh action each step, half hold one for
`HOLD` steps; components go beyond the limits and to the ends of the number line, and a few are not numbers.

Everything is checked inside the compiled rollout: finite observations, rewards and infos, unit quaternions, elapsed
time within the horizon, no diverged dynamics, steps after an end without reward. The exit code is 1 on a violation.
A step is counted only while its episode runs.
"""

import argparse
import json
import sys
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from astrojax.compilation import compiler_options
from owm_envs.config import FIDELITIES
from owm_envs.env import DockingEnv, EnvState, restart_where
from owm_envs.task.events import Outcome
from owm_envs.view import View

HARD = {
    "noise": "noncooperative",
    "reward": "rl",
    "reset": {"radius_min": 1.0, "radius_max": 740.0, "speed": 20.0, "rate": 1.0, "attitude_error_deg": 180.0},
    "docking": {"position": 20.0, "speed": 100.0, "attitude_deg": 180.0, "rate_deg": 180.0},
}
HOLD = 64
EXTREMES = [0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e300, -1e300, 1.7976931348623157e308]
UNUSABLE = [np.nan, np.inf, -np.inf, np.nan]
RESETS, STRIDE = 8, 16
"""A compiled call is so many resets, each followed by so many steps."""


class Slots(NamedTuple):
    """What the rollout carries from step to step."""

    state: EnvState
    horizon: jax.Array
    """Steps in an episode of each slot."""
    held: jax.Array
    key: jax.Array


class Tally(NamedTuple):
    """What a compiled call saw."""

    steps: jax.Array
    outcomes: jax.Array
    """Episodes ended, by `Outcome`."""
    restarts: jax.Array
    """Episodes abandoned."""
    not_finite: jax.Array
    """Steps with an observation, reward or info that is not finite."""
    late: jax.Array
    """Steps beyond the horizon."""
    paid_after_end: jax.Array
    quaternion: jax.Array
    """Largest departure of a true quaternion from unit length."""

    def add(self, other: "Tally") -> "Tally":
        summed = jax.tree.map(lambda a, b: a + b, self, other)
        return summed._replace(quaternion=jnp.maximum(self.quaternion, other.quaternion))


def zero() -> Tally:
    """Nothing seen yet."""
    count = jnp.zeros((), jnp.int64)
    return Tally(count, jnp.zeros(len(Outcome), jnp.int64), *[count] * 4, jnp.zeros(()))


def draw_actions(env: DockingEnv, slots: Slots) -> Slots:
    """The next action (B, 6) of every slot, held in half of them."""
    key, *keys = jax.random.split(slots.key, 4)
    batch = slots.held.shape[0]
    limit = jnp.asarray(env.layout.wrench_limit)
    action = jax.random.uniform(keys[0], (batch, 6), jnp.float32, -1.5, 1.5) * limit
    bits = jax.random.bits(keys[1], (batch, 6), jnp.uint8)
    action = jnp.where(bits < 32, jnp.asarray(EXTREMES)[bits % 8], action)
    lot = jax.random.bits(keys[2], (batch,), jnp.uint32)
    unusable = (lot >> 8) % 16_384 == 0
    action = action.at[:, 0].set(jnp.where(unusable, jnp.asarray(UNUSABLE)[lot % 4], action[:, 0]))
    fresh = (jnp.arange(batch) % 2 == 0) | (slots.state.count % HOLD == 0)
    return slots._replace(held=jnp.where(fresh[:, None], action, slots.held), key=key)


def all_finite(tree) -> jax.Array:
    """(B,) whether every number of each slot is."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.isfinite(leaf).reshape(leaf.shape[0], -1).all(1) for leaf in leaves]), axis=0)


def soak(env: DockingEnv, params, slots: Slots) -> tuple[Slots, Tally]:
    """One compiled call: `RESETS` x `STRIDE` steps of every slot."""

    def advance(horizon, state, action):
        return env.step(params._replace(horizon_steps=horizon), state, action)

    def step(carry, _):
        slots, tally = carry
        was_running = slots.state.outcome == Outcome.RUNNING
        slots = draw_actions(env, slots)
        state, result = jax.vmap(advance)(slots.horizon, slots.state, slots.held)
        info = jax.vmap(env.info, (None, 0))(params, state)
        ended = was_running & (state.outcome != Outcome.RUNNING)
        length = jnp.sqrt(jnp.sum(View.of(state.view).attitude ** 2, axis=1))
        seen = Tally(
            steps=jnp.sum(was_running),
            outcomes=jnp.sum(ended[:, None] & (state.outcome[:, None] == jnp.arange(len(Outcome))), axis=0),
            restarts=jnp.zeros((), jnp.int64),
            not_finite=jnp.sum(~all_finite((result, info))),
            late=jnp.sum(state.physics.elapsed > (slots.horizon + 0.5) * params.dt),
            paid_after_end=jnp.sum(~was_running & (result.reward != 0)),
            quaternion=jnp.max(jnp.where(jnp.isfinite(length), jnp.abs(length - 1), jnp.inf)),
        )
        return (slots._replace(state=state), tally.add(seen)), None

    def round_(carry, _):
        slots, tally = carry
        key, lots = jax.random.split(slots.key)
        bored = jax.random.bits(lots, slots.held.shape[:1], jnp.uint16) < 64
        running = slots.state.outcome == Outcome.RUNNING
        due = bored | ~running
        nothing = {name: jnp.zeros((*due.shape, *x.shape), x.dtype) for name, x in env.observation_parts.items()}
        state, _ = restart_where(env, params, due, slots.state, nothing)
        tally = tally._replace(restarts=tally.restarts + jnp.sum(bored & running))
        return jax.lax.scan(step, (slots._replace(state=state, key=key), tally), length=STRIDE)

    return jax.lax.scan(round_, (slots, zero()), length=RESETS)[0]


def violations(tally: Tally) -> list[str]:
    """What went wrong, in words."""
    counts = {
        "not finite": tally.not_finite,
        "beyond the horizon": tally.late,
        "rewarded after the end": tally.paid_after_end,
        "diverged": tally.outcomes[Outcome.DIVERGED],
    }
    found = [f"{int(count)} {name}" for name, count in counts.items() if count]
    return found + ([f"a quaternion off by {float(tally.quaternion):.1e}"] if tally.quaternion > 1e-9 else [])


def fly(fidelity: str, steps: int, batch: int, seed: int, progress: Progress) -> dict:
    """Soak one fidelity; stops at the first violation."""
    env = DockingEnv(fidelity=fidelity, **HARD)
    params = env.default_params()
    start, rest = jax.random.split(jax.random.key(seed))
    state, _ = jax.jit(jax.vmap(lambda key: env.reset(params, key=key)))(jax.random.split(start, batch))
    began = time.perf_counter()
    horizon = jnp.geomspace(100, 7200, batch).astype(jnp.int32)
    slots = Slots(state, horizon, jnp.zeros((batch, 6)), rest)
    program = jax.jit(soak, static_argnums=0, donate_argnums=2, compiler_options=compiler_options())
    compiled = program.lower(env, params, slots).compile()
    compile_seconds = time.perf_counter() - began
    bar = progress.add_task(fidelity, total=steps)
    total, calls, found, began = jax.device_get(zero()), 0, [], time.perf_counter()
    while total.steps < steps and not found:
        slots, seen = compiled(params, slots)
        total = jax.device_get(total.add(jax.device_get(seen)))
        calls += 1
        found = violations(total)
        progress.update(bar, completed=min(int(total.steps), steps))
    seconds = time.perf_counter() - began
    return {
        "fidelity": fidelity,
        "batch": batch,
        "seed": seed,
        "calls": calls,
        "steps": int(total.steps),
        "steps_per_s": int(total.steps) / seconds,
        "compile_s": compile_seconds,
        "outcomes": {o.name.lower(): int(total.outcomes[o]) for o in Outcome if o != Outcome.RUNNING},
        "abandoned": int(total.restarts),
        "quaternion_error": float(total.quaternion),
        "violations": found,
    }


def main(arguments: list[str] | None = None) -> int:
    """Soak, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=float, default=1e8, help="in all, shared between the fidelities")
    parser.add_argument("--fidelities", nargs="*", choices=FIDELITIES, default=list(FIDELITIES))
    parser.add_argument("--batch", type=int, default=4096)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", default="soak.json")
    options = parser.parse_args(arguments)
    share = int(np.ceil(options.steps / len(options.fidelities)))
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    with jax.enable_x64(True), Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as progress:
        rows = [fly(name, share, options.batch, options.seed, progress) for name in options.fidelities]
    table = Table("", *(row["fidelity"] for row in rows))
    for name in ("steps", "steps_per_s", "compile_s", "abandoned"):
        table.add_row(name, *(f"{row[name]:,.0f}" for row in rows))
    for name in rows[0]["outcomes"]:
        table.add_row(name, *(f"{row['outcomes'][name]:,}" for row in rows))
    table.add_row("quaternion error", *(f"{row['quaternion_error']:.0e}" for row in rows))
    table.add_row("violations", *("; ".join(row["violations"]) or "none" for row in rows))
    Console().print(table)
    with open(options.json, "w", encoding="utf-8") as file:
        json.dump(rows, file, indent=1)
    broken = [row for row in rows if row["violations"]]
    for row in broken:
        print(f"{row['fidelity']}: {'; '.join(row['violations'])} by call {row['calls']} of seed {row['seed']}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
