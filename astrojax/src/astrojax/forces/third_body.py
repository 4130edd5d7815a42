"""Perturbing acceleration of a distant body."""

import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, dot, inverse_norm


def accel_third_body(r: Vector3, r_body: Vector3, gm_body: Scalar) -> Vector3:
    """Acceleration [m/s^2] a third body adds to motion about Earth's centre (direct minus indirect term).

    Args:
        r: (3,) position of the vehicle from Earth's centre [m].
        r_body: (3,) position of the body from Earth's centre [m], same axes, |r_body| > |r|.
        gm_body: its gravitational parameter [m^3/s^2].

    Validity: any |r| < |r_body|; the two terms, equal to four digits for the Sun, are never subtracted, so
    float32 keeps its full relative accuracy.

    Source: Battin, An Introduction to the Mathematics and Methods of Astrodynamics, rev. ed.,
    ch. 8 (the function f(q)).
    """
    inv_d = inverse_norm(r_body)
    # Scaled by the body's distance: the bare powers of 1.5e11 m leave the range of float32.
    x, u = r * inv_d, r_body * inv_d
    q = dot(x, x - 2.0 * u)
    root = jnp.sqrt(1.0 + q)
    cubed = (1.0 + q) * root
    f = q * (3.0 + q * (3.0 + q)) / (1.0 + cubed)
    return (-gm_body * inv_d * inv_d / cubed) * (x + f * u)
