"""Fixed-step integrators for any pytree."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from astrojax._types import FloatScalar, Scalar
from astrojax.compilation import stored


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
    return jax.tree.map(lambda a, b: a + b, y, rk4_increment(f, t, y, dt, *args))


def rk4_increment(f: Callable[..., PyTree], t: Scalar, y: PyTree, dt: Scalar, *args: Any) -> PyTree:
    """What `rk4_step` adds to the state, for sums that keep what rounding would lose; arguments as there."""

    def ahead(k: PyTree, h: Scalar) -> PyTree:
        return stored(jax.tree.map(lambda a, b: a + h * b, y, k))

    half = 0.5 * dt
    k1 = stored(f(t, y, *args))
    k2 = stored(f(t + half, ahead(k1, half), *args))
    k3 = stored(f(t + half, ahead(k2, half), *args))
    k4 = f(t + dt, ahead(k3, dt), *args)
    return _weighted(dt, k1, k2, k3, k4)


def _weighted(dt: Scalar, k1: PyTree, k2: PyTree, k3: PyTree, k4: PyTree) -> PyTree:
    sixth = dt / 6.0
    return jax.tree.map(lambda a, b, c, d: sixth * (a + 2.0 * (b + c) + d), k1, k2, k3, k4)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def rk4_increment_looped(f: Callable[..., PyTree], t: FloatScalar, y: PyTree, dt: FloatScalar, args: tuple) -> PyTree:
    """`rk4_increment` whose derivative is a loop over the stages: a long `f` then compiles once, not four times.

    Undifferentiated it is `rk4_increment` itself; differentiated, its value is that of the same sums in the loop.

    Args:
        f: as there; it closes over nothing that is traced.
        args: floating-point arrays, or pytrees of them, handed to `f`.
    """
    return rk4_increment(f, t, y, dt, *args)


@rk4_increment_looped.defjvp
def _rk4_increment_looped_jvp(f, primals, tangents):
    t, y, dt, args = primals
    *tangents, turned = tangents

    def stage(carry, part):
        k, pushed = carry

        def at(t, y, dt, k, args):
            h = part * dt
            return f(t + h, jax.tree.map(lambda a, b: a + h * b, y, k), *args)

        carry = jax.jvp(at, (t, y, dt, k, args), (*tangents, pushed, turned))
        return carry, carry

    none = jax.tree.map(jnp.zeros_like, y)
    _, (ks, pushed) = jax.lax.scan(stage, (none, none), jnp.asarray([0.0, 0.5, 0.5, 1.0], dt.dtype))
    stages, pushes = ([jax.tree.map(lambda x, i=i: x[i], tree) for i in range(4)] for tree in (ks, pushed))
    return jax.jvp(_weighted, (dt, *stages), (tangents[2], *pushes))


def compensated_add(y: PyTree, lost: PyTree, increment: PyTree) -> tuple[PyTree, PyTree]:
    """Add to a running sum, and what rounding has taken from it so far.

    Args:
        y: pytree of arrays, the sum.
        lost: the same structure; starts at zero, and is handed on from call to call.
        increment: the same structure.

    Returns:
        The new sum and the new `lost`; sum minus `lost` is accurate to twice the precision.

    Source: Kahan (1965), Communications of the ACM 8(1), 40.
    """
    due = jax.tree.map(lambda a, b: a - b, increment, lost)
    total = stored(jax.tree.map(lambda a, b: a + b, y, due))
    return total, jax.tree.map(lambda new, old, b: (new - old) - b, total, y, due)
