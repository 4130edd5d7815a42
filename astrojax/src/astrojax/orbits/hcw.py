"""Relative motion about a circular orbit: the Hill-Clohessy-Wiltshire equations, in RTN axes (`frames.rtn`)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Scalar, Vector3, Vector6, float_dtype


def accel_hcw(state: Vector6, n: Scalar) -> Vector3:
    """Relative acceleration [m/s^2] of the Hill-Clohessy-Wiltshire equations, in RTN axes.

    Args:
        state: (6,) relative position and velocity in the rotating RTN frame [m, m/s].
        n: mean motion of the circular chief orbit [rad/s].

    Validity: circular chief, two-body gravity, separations small against the orbit radius.

    Source: Clohessy and Wiltshire (1960), J. Aerospace Sci. 27(9), 653, here in RTN order.
    """
    x, _, z, vx, vy, _ = state
    return jnp.stack([n * (3.0 * n * x + 2.0 * vy), -2.0 * n * vx, -(n * n) * z])


def stm_hcw(n: Scalar, dt: Scalar) -> Float[Array, "6 6"]:
    """State-transition matrix of `accel_hcw` over `dt` seconds.

    Args:
        n: mean motion [rad/s]; zero gives free drift, with finite gradients.
        dt: seconds, either sign.

    Source: closed-form solution, Alfriend et al., Spacecraft Formation Flying (2010), ch. 5; its differences such
    as n t - sin(n t), which cancel for short steps, are summed as series.
    """
    dtype = float_dtype(n, dt)
    n, t = jnp.asarray(n, dtype), jnp.asarray(dt, dtype)
    x = n * t
    s, c = jnp.sin(x), jnp.cos(x)
    c1, c2, c3 = _stumpff(x)
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    along = 2.0 * x * c2 * t
    rows = [
        [one + 3.0 * x * x * c2, zero, zero, c1 * t, along, zero],
        [-6.0 * x * x * x * c3, one, zero, -along, (4.0 * c1 - 3.0) * t, zero],
        [zero, zero, c, zero, zero, c1 * t],
        [3.0 * n * s, zero, zero, c, 2.0 * s, zero],
        [-6.0 * n * x * x * c2, zero, zero, -2.0 * s, 4.0 * c - 3.0, zero],
        [zero, zero, -n * s, zero, zero, c],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def _stumpff(x):
    """sin(x) / x, (1 - cos x) / x^2 and (x - sin x) / x^3, smooth through zero."""
    small = jnp.abs(x) < 0.5
    y = jnp.where(small, x * x, 0.0)
    big = jnp.where(small, 1.0, x)

    def series(first):  # sum of (-y)^k / (first + 2 k)! * first!, to rounding level below x = 0.5
        total = 1.0
        for k in range(5, 0, -1):
            total = 1.0 - y / ((first + 2 * k - 1) * (first + 2 * k)) * total
        return total

    c1 = jnp.where(small, series(1), jnp.sin(big) / big)
    c2 = jnp.where(small, 0.5 * series(2), 2.0 * (jnp.sin(0.5 * big) / big) ** 2)
    c3 = jnp.where(small, series(3) / 6.0, (big - jnp.sin(big)) / big**3)
    return c1, c2, c3
