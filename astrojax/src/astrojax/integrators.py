"""Fixed-step integrators for any pytree."""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import PyTree

from astrojax._types import Scalar


def rk4_step(f: Callable[..., PyTree], t: Scalar, y: PyTree, dt: Scalar, *args: Any) -> PyTree:
    """State after one classical fourth-order Runge-Kutta step of dy/dt = f(t, y, *args).

    Args:
        f: derivative, returning the structure of `y`.
        t: time at the start of the step [s].
        y: pytree of arrays.
        dt: step [s], either sign.
        args: handed to `f` unchanged.

    Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, sec. II.1.
    """

    def ahead(k: PyTree, h: Scalar) -> PyTree:
        return jax.tree.map(lambda a, b: a + h * b, y, k)

    half = 0.5 * dt
    k1 = f(t, y, *args)
    k2 = f(t + half, ahead(k1, half), *args)
    k3 = f(t + half, ahead(k2, half), *args)
    k4 = f(t + dt, ahead(k3, dt), *args)
    sixth = dt / 6.0
    return jax.tree.map(lambda y0, a, b, c, d: y0 + sixth * (a + 2.0 * (b + c) + d), y, k1, k2, k3, k4)
