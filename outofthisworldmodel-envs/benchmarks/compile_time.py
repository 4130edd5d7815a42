"""Compile seconds of the environment's largest programs, nothing taken from a cache.

    python benchmarks/compile_time.py --fidelities iss iss-hcw iss-numerical

One line a program: fidelity, name, seconds to trace and lower, seconds to compile.
"""

import argparse
import time

import jax
import jax.numpy as jnp

from owm_envs.config.docking import FIDELITIES
from owm_envs.env import DockingEnv

SLOTS, STEPS = 64, 20


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

    return {
        "reset": lambda params, state, action: env.reset(params, key=jax.random.key(0)),
        "physics step": physics,
        "step": after,
        f"{STEPS} steps of {SLOTS} slots": chunk,
        "d step / d action, forward": jax.jacfwd(view_after, argnums=2),
        "d step / d action, reverse": jax.jacrev(view_after, argnums=2),
        "d step / d mass, forward": of_params,
        "d physics / d chaser, forward": of_physics,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelities", nargs="+", choices=FIDELITIES, default=FIDELITIES)
    parser.add_argument("--programs", nargs="+", help="names that contain one of these; all by default")
    options = parser.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)
    for fidelity in options.fidelities:
        env = DockingEnv(fidelity=fidelity, precision="float32", noise="cooperative")
        params = env.default_params()
        state, _ = jax.eval_shape(env.reset, params, key=jax.random.key(0))
        for name, function in programs(env).items():
            if options.programs and not any(part in name for part in options.programs):
                continue
            began = time.perf_counter()
            lowered = jax.jit(function).lower(params, state, jax.ShapeDtypeStruct((6,), jnp.float32))
            lowering = time.perf_counter() - began
            lowered.compile()
            print(f"{fidelity:14} {name:32} {lowering:6.1f} {time.perf_counter() - began - lowering:6.1f}", flush=True)


if __name__ == "__main__":
    main()
