"""Array types of the public functions, and the few vector helpers every module needs."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

Scalar = Real[ArrayLike, ""]
"""A number of any real type: of Python, of NumPy, or an array without axes."""
FloatScalar = Float[Array, ""]
"""A floating-point array without axes."""
Vector3 = Float[Array, "3"]
"""A vector."""
Vector6 = Float[Array, "6"]
"""Position and velocity, or six elements of an orbit."""
Quaternion = Float[Array, "4"]
"""A quaternion, scalar first."""
Matrix3 = Float[Array, "3 3"]
"""A rotation or another matrix; times a vector of the old axes it gives that of the new."""


def float_dtype(*args: ArrayLike) -> jnp.dtype:
    """The floating dtype that holds all arguments, by JAX's usual rules whatever the caller's are."""
    with jax.numpy_dtype_promotion("standard"):
        return jnp.result_type(*args, 1.0)


def dot(a: Array, b: Array) -> Array:
    """Inner product written out, which XLA fuses where a batched `dot` call would not."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Array, b: Array) -> Array:
    """Cross product of two 3-vectors, without the axis handling of `jnp.cross`."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def inverse_norm(a: Array) -> Array:
    """1 / |a|. Powers are built from this: r**3 in a denominator overflows float32 when differentiated."""
    return jax.lax.rsqrt(dot(a, a))


def safe_sqrt(x: Array) -> Array:
    """Square root whose gradient at x <= 0 is zero instead of infinite."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)
