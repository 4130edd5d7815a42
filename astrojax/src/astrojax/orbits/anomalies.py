"""Anomalies of ellipse, parabola and hyperbola, and Kepler's equation for each.

Named for what they lead from and to. Angles in radians; the hyperbolic anomaly H is no angle. True and eccentric
anomalies of a half turn or less keep their turn; gradients of every solution are implicit, hence exact.
Source: Battin, An Introduction to the Mathematics and Methods of Astrodynamics, revised ed., secs. 4.2 to 4.5.
"""

import jax
import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.orbits._angles import TURN

_STEPS = 10


def _floats(*values):
    dtype = float_dtype(*values)
    return tuple(jnp.asarray(value, dtype) for value in values)


def true_to_eccentric(nu: Scalar, e: Scalar) -> FloatScalar:
    """Eccentric anomaly [rad] of a true anomaly [rad], 0 <= e < 1; within half a turn of it, any number of turns."""
    nu, e = _floats(nu, e)
    beta = e / (1.0 + jnp.sqrt((1.0 - e) * (1.0 + e)))
    return nu - 2.0 * jnp.arctan2(beta * jnp.sin(nu), 1.0 + beta * jnp.cos(nu))


def eccentric_to_true(ecc: Scalar, e: Scalar) -> FloatScalar:
    """True anomaly [rad] of an eccentric anomaly [rad], 0 <= e < 1; within half a turn of it, any number of turns."""
    ecc, e = _floats(ecc, e)
    beta = e / (1.0 + jnp.sqrt((1.0 - e) * (1.0 + e)))
    return ecc + 2.0 * jnp.arctan2(beta * jnp.sin(ecc), 1.0 - beta * jnp.cos(ecc))


def eccentric_to_mean(ecc: Scalar, e: Scalar) -> FloatScalar:
    """Mean anomaly [rad] of an eccentric anomaly [rad]: Kepler's equation, 0 <= e <= 1."""
    ecc, e = _floats(ecc, e)
    # E - e sin E = (1 - e) sin E + (E - sin E): no digits are lost near the perigee of a long ellipse.
    return (1.0 - e) * jnp.sin(ecc) + _minus_sine(ecc)


def _minus_sine(x):
    """x - sin x, by its series for small x."""
    small = jnp.abs(x) < 0.5
    y = jnp.where(small, x * x, 0.0)
    total = 1.0
    for k in range(6, 0, -1):
        total = 1.0 - y / ((2 * k + 2) * (2 * k + 3)) * total
    return jnp.where(small, x * y / 6.0 * total, x - jnp.sin(x))


def _minus_sinh(x):
    """sinh x - x, by its series for small x."""
    small = jnp.abs(x) < 0.5
    y = jnp.where(small, x * x, 0.0)
    total = 1.0
    for k in range(6, 0, -1):
        total = 1.0 + y / ((2 * k + 2) * (2 * k + 3)) * total
    return jnp.where(small, x * y / 6.0 * total, jnp.sinh(x) - x)


def _cubic_root(a, b):
    """Real root of a x + x^3 / 6 = b for a >= 0, which is Kepler's equation about the perigee."""
    # As -p/w + w with w^3 = |q| + sqrt(q^2 + p^3): no cancellation, and both zero gives zero.
    p, q = 2.0 * a, 3.0 * jnp.abs(b)
    w = jnp.cbrt(q + jnp.sqrt(q * q + p * p * p))
    w = jnp.where(w > 0.0, w, 1.0)
    root = 2.0 * q / (w * w + p + (p / w) ** 2)
    return jnp.sign(b) * root


@jax.custom_jvp
def _eccentric(m, e):
    turns = jnp.round(m / TURN)
    m = m - TURN * turns
    near = _cubic_root(1.0 - e, m)  # exact about the perigee of a long ellipse, and never too small by much
    far = m + e * jnp.sin(m) * jax.lax.rsqrt(1.0 - 2.0 * e * jnp.cos(m) + e * e + 1e-9)
    ecc = jnp.where((e > 0.8) & (jnp.abs(m) < 1.0), near, far)

    def step(_, ecc):
        s, c = jnp.sin(ecc), jnp.cos(ecc)
        miss = (1.0 - e) * s + _minus_sine(ecc) - m
        slope = (1.0 - e) + e * 2.0 * jnp.sin(0.5 * ecc) ** 2
        d1 = -miss / slope
        d2 = -miss / (slope + 0.5 * d1 * e * s)
        return ecc - miss / (slope + 0.5 * d2 * e * s + d2 * d2 * e * c / 6.0)

    return jax.lax.fori_loop(0, _STEPS, step, ecc) + TURN * turns


@_eccentric.defjvp
def _eccentric_jvp(primals, tangents):
    (m, e), (dm, de) = primals, tangents
    ecc = _eccentric(m, e)
    return ecc, (dm + jnp.sin(ecc) * de) / ((1.0 - e) + e * 2.0 * jnp.sin(0.5 * ecc) ** 2)


def mean_to_eccentric(m: Scalar, e: Scalar) -> FloatScalar:
    """Eccentric anomaly [rad] of a mean anomaly [rad], any number of turns, which it keeps.

    Args:
        m: [rad].
        e: 0 <= e <= 0.9999.

    Source: Danby, Fundamentals of Celestial Mechanics, 2nd ed., sec. 6.6 (quartic steps), from the cubic that Kepler's
    equation is near the perigee of a long ellipse.
    """
    return _eccentric(*_floats(m, e))


def true_to_mean(nu: Scalar, e: Scalar) -> FloatScalar:
    """Mean anomaly [rad] of a true anomaly [rad], 0 <= e < 1."""
    return eccentric_to_mean(true_to_eccentric(nu, e), e)


def mean_to_true(m: Scalar, e: Scalar) -> FloatScalar:
    """True anomaly [rad] of a mean anomaly [rad], 0 <= e <= 0.9999."""
    return eccentric_to_true(mean_to_eccentric(m, e), e)


def true_to_parabolic_mean(nu: Scalar) -> FloatScalar:
    """Parabolic mean anomaly D + D^3/3 with D = tan(nu/2), which grows by sqrt(gm/(2 q^3)) a second (Barker)."""
    (nu,) = _floats(nu)
    d = jnp.tan(0.5 * nu)
    return d + d * d * d / 3.0


def parabolic_mean_to_true(m: Scalar) -> FloatScalar:
    """True anomaly [rad] of a parabolic mean anomaly, any size: the closed form of Barker's equation."""
    (m,) = _floats(m)
    w = jnp.arcsinh(1.5 * m) / 3.0
    return 2.0 * jnp.arctan(2.0 * jnp.sinh(w))


def true_to_hyperbolic(nu: Scalar, e: Scalar) -> FloatScalar:
    """Hyperbolic anomaly H of a true anomaly [rad] inside the asymptotes, e > 1."""
    nu, e = _floats(nu, e)
    return 2.0 * jnp.arctanh(jnp.sqrt((e - 1.0) / (e + 1.0)) * jnp.tan(0.5 * nu))


def hyperbolic_to_true(h: Scalar, e: Scalar) -> FloatScalar:
    """True anomaly [rad] of a hyperbolic anomaly H, e > 1."""
    h, e = _floats(h, e)
    return 2.0 * jnp.arctan(jnp.sqrt((e + 1.0) / (e - 1.0)) * jnp.tanh(0.5 * h))


def hyperbolic_to_mean(h: Scalar, e: Scalar) -> FloatScalar:
    """Hyperbolic mean anomaly e sinh H - H, which grows by sqrt(gm/(-a)^3) a second; e >= 1."""
    h, e = _floats(h, e)
    return (e - 1.0) * jnp.sinh(h) + _minus_sinh(h)


@jax.custom_jvp
def _hyperbolic(m, e):
    # The cubic overestimates |H|, and so does the asymptote from m = e sinh H - H; the smaller is near enough.
    size = jnp.abs(m)
    near = jnp.abs(_cubic_root(e - 1.0, m))
    far = jnp.arcsinh(size / e) + jnp.log1p(size / e)
    for _ in range(2):  # e sinh H = m + H
        far = jnp.arcsinh((size + far) / e)
    h = jnp.minimum(near, far)

    def step(_, h):
        s, c = jnp.sinh(h), 2.0 * jnp.sinh(0.5 * h) ** 2
        miss = (e - 1.0) * s + _minus_sinh(h) - size
        slope = (e - 1.0) + e * c
        slope = jnp.where(slope > 0.0, slope, 1.0)
        d1 = -miss / slope
        d2 = -miss / (slope + 0.5 * d1 * e * s)
        return h - miss / (slope + 0.5 * d2 * e * s + d2 * d2 * e * (1.0 + c) / 6.0)

    return jnp.sign(m) * jax.lax.fori_loop(0, _STEPS, step, h)


@_hyperbolic.defjvp
def _hyperbolic_jvp(primals, tangents):
    (m, e), (dm, de) = primals, tangents
    h = _hyperbolic(m, e)
    return h, (dm - jnp.sinh(h) * de) / ((e - 1.0) + e * 2.0 * jnp.sinh(0.5 * h) ** 2)


def mean_to_hyperbolic(m: Scalar, e: Scalar) -> FloatScalar:
    """Hyperbolic anomaly H with e sinh H - H = m.

    Args:
        m: hyperbolic mean anomaly, either sign, up to 1e12.
        e: 1.0001 and more.
    """
    return _hyperbolic(*_floats(m, e))
