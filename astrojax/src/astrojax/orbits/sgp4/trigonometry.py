"""Sine and cosine together, in operations a CPU does for many satellites at once.

In double precision XLA calls the C library for each number on a CPU, which takes most of SGP4's time.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Number = Float[Array, "..."]

# A quarter turn in three parts, of which the first two have 33 bits: their products with small integers are exact.
_QUARTER_1 = 1.57079632673412561417e00
_QUARTER_2 = 6.07710050630396597660e-11
_QUARTER_3 = 2.02226624879595063154e-21
_TURN = 6.283185307179586


@jax.custom_jvp
def sincos(x: Number) -> tuple[Number, Number]:
    """Sine and cosine to 2e-16 of an angle below a million radians; float32 takes JAX's own."""
    if x.dtype != jnp.float64:
        return jnp.sin(x), jnp.cos(x)
    k = jnp.round(x * (2.0 / math.pi))
    r = ((x - k * _QUARTER_1) - k * _QUARTER_2) - k * _QUARTER_3
    s, c = _taylor(r)
    # The quadrant by arithmetic on k, all in float64.
    quadrant = k - 4.0 * jnp.floor(0.25 * k)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    sine, cosine = jnp.where(odd, c, s), jnp.where(odd, s, c)
    return jnp.where(quadrant >= 2.0, -sine, sine), jnp.where((quadrant == 1.0) | (quadrant == 2.0), -cosine, cosine)


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    s, c = sincos(primals[0])
    return (s, c), (c * tangents[0], -s * tangents[0])


def turned(s: Number, c: Number, more: Number) -> tuple[Number, Number]:
    """Sine and cosine of an angle that is more by some, from its own."""
    ds, dc = sincos(more)
    return s * dc + c * ds, c * dc - s * ds


def _taylor(x: Number) -> tuple[Number, Number]:
    """Sine and cosine of at most an eighth of a turn, by their series."""
    y = x * x
    s = c = jnp.ones_like(x)
    for k in range(8, 0, -1):
        s = 1.0 - y * s * (1.0 / ((2 * k) * (2 * k + 1)))
        c = 1.0 - y * c * (1.0 / ((2 * k - 1) * (2 * k)))
    return x * s, c


def within_a_turn(x: Number) -> Number:
    """The remainder of an angle by a turn, of its own sign, as C's fmod gives it."""
    return x - _TURN * jnp.trunc(x * (1.0 / _TURN))
