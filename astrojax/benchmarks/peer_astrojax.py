"""The LEO force model in the other project named astrojax (PyPI), for `forces.py --peer-python`.

Written from that project's public documentation. Runs in an environment of its own, without ours; prints one line of
JSON. It has no switch that leaves out precession and nutation, which it computes for every orbit and stage.

    python peer_astrojax.py states.npy --degree 20 --steps 100 --dt 10 --dtype float64
"""

import argparse
import json
import time
from importlib import metadata

import jax
import jax.numpy as jnp
import numpy as np

import astrojax


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("states")
    parser.add_argument("--degree", type=int, default=20)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--dt", type=float, default=10.0)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--dtype", default="float64")
    options = parser.parse_args()

    dtype = getattr(jnp, options.dtype)
    jax.config.update("jax_enable_x64", options.dtype == "float64")
    astrojax.set_dtype(dtype)
    states = jnp.asarray(np.load(options.states), dtype)
    config = astrojax.ForceModelConfig(
        gravity_type="spherical_harmonics",
        gravity_model=astrojax.GravityModel.from_type("EGM2008_360"),
        gravity_degree=options.degree,
        gravity_order=options.degree,
        drag=True,
        srp=True,
        third_body_sun=True,
        third_body_moon=True,
        spacecraft=astrojax.SpacecraftParams(mass=1000.0, drag_area=10.0, srp_area=10.0, cd=2.2, cr=1.3),
    )
    dynamics = astrojax.create_orbit_dynamics(astrojax.zero_eop(), astrojax.Epoch(2026, 8, 1), config)

    def fly(state):
        def step(state, i):
            return astrojax.rk4_step(dynamics, i * options.dt, state, options.dt).state, None

        return jax.lax.scan(step, state, jnp.arange(options.steps, dtype=dtype))[0]

    begin = time.perf_counter()
    program = jax.jit(jax.vmap(fly)).lower(states).compile()
    compiled = time.perf_counter() - begin
    seconds = []
    for _ in range(options.repeat):
        begin = time.perf_counter()
        end = program(states).block_until_ready()
        seconds.append(time.perf_counter() - begin)
    report = {"version": metadata.version("astrojax"), "seconds": seconds, "compile_seconds": compiled}
    print(json.dumps(report | {"end": np.asarray(end, float)[:, :3].tolist()}))


if __name__ == "__main__":
    main()
