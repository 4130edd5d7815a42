"""Numbers kept in two parts: the second holds what rounding takes from the first."""

import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar


def two_part_sum(high: FloatScalar, low: FloatScalar, more: Scalar) -> tuple[FloatScalar, FloatScalar]:
    """Sum of a number in two parts and another, in two parts again.

    Source: Knuth, The Art of Computer Programming, vol. 2, sec. 4.2.2, theorem B.
    """
    more = jnp.asarray(more, high.dtype)
    total = high + more
    part = total - high
    low = low + ((high - (total - part)) + (more - part))
    whole = total + low
    return whole, low - (whole - total)
