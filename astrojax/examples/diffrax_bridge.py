"""The same derivative under diffrax: for stiff equations, backsolve adjoints, or its many other solvers.

    pip install diffrax
    python astrojax/examples/diffrax_bridge.py

A derivative here is f(t, y, *args); diffrax asks for f(t, y, args). Nothing else is in between.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from astrojax import forces, orbits, propagate


def solve_with_diffrax(
    f: Callable, t0: Any, y0: Any, t1: Any, *args: Any, rtol: float = 1e-9, atol: float = 1e-9, max_steps: int = 4096
) -> tuple[Any, jax.Array]:
    """State at t1, and whether diffrax got there; arguments as for `propagate.integrate`."""
    import diffrax

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: f(t, y, *args)),
        diffrax.Dopri8(),
        t0=t0,
        t1=t1,
        dt0=None,
        y0=y0,
        args=args,
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol),
        max_steps=max_steps,
        throw=False,
    )
    return jax.tree.map(lambda leaf: leaf[-1], solution.ys), solution.result == diffrax.RESULTS.successful


def two_body(t: Any, y: jax.Array, gm: jax.Array) -> jax.Array:
    """Two-body motion."""
    return jnp.concatenate([y[3:], forces.accel_two_body(y[:3], gm)])


def main() -> None:
    with jax.enable_x64(True):
        y0, gm = orbits.keplerian_to_cartesian(jnp.array([7e6, 0.01, 1.0, 0.0, 0.0, 0.0])), jnp.asarray(3.986004415e14)
        theirs, reached = solve_with_diffrax(two_body, 0.0, y0, 6000.0, gm, atol=1e-6)
        ours = propagate.integrate(two_body, 0.0, y0, 6000.0, gm, atol=1e-6)
        apart = float(jnp.linalg.norm((theirs - ours.y)[:3]))
        print(f"reached: {bool(reached)}; apart after 6000 s: {apart:.1e} m")
        assert reached
        assert apart < 1.0


if __name__ == "__main__":
    main()
