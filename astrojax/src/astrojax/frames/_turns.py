"""Rotations about the axes, applied to a vector or to each column of a matrix: without a product of matrices."""

import jax.numpy as jnp
from jaxtyping import Array

from astrojax._types import FloatScalar


def turn_x(angle: FloatScalar, m: Array) -> Array:
    """What `m` is in axes that are turned by `angle` [rad] about x."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([m[0], cos * m[1] + sin * m[2], cos * m[2] - sin * m[1]])


def turn_y(angle: FloatScalar, m: Array) -> Array:
    """What `m` is in axes that are turned by `angle` [rad] about y."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * m[0] - sin * m[2], m[1], sin * m[0] + cos * m[2]])


def turn_z(angle: FloatScalar, m: Array) -> Array:
    """What `m` is in axes that are turned by `angle` [rad] about z."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * m[0] + sin * m[1], cos * m[1] - sin * m[0], m[2]])
