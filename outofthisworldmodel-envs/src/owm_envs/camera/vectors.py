"""Vectors of many rays as three arrays, x, y and z: arithmetic on whole lanes, which compilers like best."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Vector = tuple[Array, Array, Array]
"""Components; they broadcast against one another."""


def dot(a: Vector, b: Vector) -> Array:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def plus(a: Vector, scale: Array | float, b: Vector) -> Vector:
    """a + scale b."""
    return (a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2])


def unit(a: Vector) -> Vector:
    """Same direction, length one; a vector of nearly no length stays as short."""
    inverse = jax.lax.rsqrt(jnp.maximum(dot(a, a), 1e-20))
    return (a[0] * inverse, a[1] * inverse, a[2] * inverse)


def components(a: Float[Array, "... 3"]) -> Vector:
    """The three components of an array."""
    return (a[..., 0], a[..., 1], a[..., 2])


def onto(axes: Float[Array, "... 3 3"], a: Vector) -> Vector:
    """Components along the columns of a rotation; its leading axes broadcast against the lanes."""
    return tuple(dot(components(axes[..., :, j]), a) for j in range(3))


def where(condition: Array, a: Vector, b: Vector) -> Vector:
    """a where the condition holds, else b."""
    return tuple(jnp.where(condition, p, q) for p, q in zip(a, b))
