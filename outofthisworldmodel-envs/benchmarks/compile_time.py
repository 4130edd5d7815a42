"""Compile seconds of the environment's largest programs, nothing taken from a cache.

    python benchmarks/compile_time.py --fidelities iss iss-hcw iss-numerical

One line a program: fidelity, name, seconds to trace and lower, seconds to compile, and the seconds of processor time of
both, which a busy machine stretches less; then the ten largest.
"""

import argparse
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp

from owm_envs.config.docking import FIDELITIES
from owm_envs.env import DockingEnv

SLOTS, STEPS = 64, 20
PLAIN = {"noise": "cooperative"}
ALL = {
    "noise": {"position": 0.05, "velocity": 0.002, "bias": {"position": 0.02}},
    "chaser": {"actuation_delay": 2, "thruster_force": 5.0, "thruster_torque": 2.0},
    "randomization": {"mass_scale": (0.9, 1.1), "actuation_delay": (0, 2)},
    "obstacles": [[[30.0, 30.0, 30.0], [31.0, 31.0, 31.0]]],
    "normalize": True,
    "preset": "rl",
}
"""Every option on."""


def split(tree) -> tuple[list, Callable]:
    """The floating-point leaves of a tree, and what puts others in their place."""
    leaves, structure = jax.tree.flatten(tree)
    floating = [jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves]

    def join(numbers: list):
        numbers = iter(numbers)
        return structure.unflatten([next(numbers) if f else leaf for f, leaf in zip(floating, leaves)])

    return [leaf for f, leaf in zip(floating, leaves) if f], join


def programs(env: DockingEnv) -> dict:
    """Functions of (params, state, action), by name."""

    def after(params, state, action):
        return env.step(params, state, action)[0]

    def view_after(params, state, action):
        return after(params, state, action).view

    def chunk(params, state, action):
        states = jax.tree.map(lambda x: jnp.broadcast_to(x, (SLOTS, *x.shape)), state)
        step = jax.vmap(after, (None, 0, None))
        return jax.lax.scan(lambda s, _: (step(params, s, action), None), states, length=STEPS)[0]

    def physics(params, state, action):
        return env.dynamics.step(params, state.physics, action, params.dt)

    def of_physics(params, state, action):
        return jax.jacfwd(physics_floats, argnums=1)(params, state.physics.chaser, state, action)

    def physics_floats(params, chaser, state, action):
        moved = env.dynamics.step(params, state.physics._replace(chaser=chaser), action, params.dt)
        return env.dynamics.relative_state(params, moved)

    def of_params(params, state, action):
        def by_mass(mass):
            return view_after(params._replace(chaser=params.chaser._replace(mass=mass)), state, action)

        return jax.jacfwd(by_mass)(params.chaser.mass)

    def of_everything(derivative):
        def program(params, state, action):
            numbers, join = split((params, state))
            return derivative(lambda numbers: view_after(*join(numbers), action))(numbers)

        return program

    def gradient(params, state, action):
        numbers, join = split((params, state))
        return jax.grad(lambda numbers: env.step(*join(numbers), action)[1].reward)(numbers)

    def pulled_back(params, state, action):
        numbers, join = split((params, state))
        seen, back = jax.vjp(lambda numbers: view_after(*join(numbers), action), numbers)
        return back(jnp.ones_like(seen))

    return {
        "reset": lambda params, state, action: env.reset(params, key=jax.random.key(0)),
        "physics step": physics,
        "step": after,
        f"{STEPS} steps of {SLOTS} slots": chunk,
        "d step / d action, forward": jax.jacfwd(view_after, argnums=2),
        "d step / d action, reverse": jax.jacrev(view_after, argnums=2),
        "d step / d mass, forward": of_params,
        "d physics / d chaser, forward": of_physics,
        "d step / d state, params, forward": of_everything(jax.jacfwd),
        "d step / d state, params, reverse": of_everything(jax.jacrev),
        "d reward / d state, params, grad": gradient,
        "d step / d state, params, vjp": pulled_back,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelities", nargs="+", choices=FIDELITIES, default=FIDELITIES)
    parser.add_argument("--options", nargs="+", choices=["plain", "all"], default=["plain", "all"])
    parser.add_argument("--programs", nargs="+", help="names that contain one of these; all by default")
    options = parser.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)
    measured = []
    for fidelity in options.fidelities:
        for chosen in options.options:
            env = DockingEnv(fidelity=fidelity, precision="float32", **(ALL if chosen == "all" else PLAIN))
            params = env.default_params()
            state, _ = jax.eval_shape(env.reset, params, key=jax.random.key(0))
            for name, function in programs(env).items():
                if options.programs and not any(part in name for part in options.programs):
                    continue
                began, worked = time.perf_counter(), time.process_time()
                lowered = jax.jit(function).lower(params, state, jax.ShapeDtypeStruct((6,), jnp.float32))
                lowering = time.perf_counter() - began
                lowered.compile()
                compiling, work = time.perf_counter() - began - lowering, time.process_time() - worked
                line = f"{fidelity:14} {chosen:6} {name:34} {lowering:7.1f} {compiling:7.1f} {work:7.1f}"
                print(line, flush=True)
                measured.append((work, line))
    print("\nThe ten largest:")
    print("\n".join(line for _, line in sorted(measured, reverse=True)[:10]))


if __name__ == "__main__":
    main()
