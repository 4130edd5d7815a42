"""Mean and osculating elements under J2: the first-order theory of Brouwer in Lyddane's variables.

Source: Brouwer (1959), Astronomical Journal 64, 378, secs. 4 and 5; Lyddane (1963), Astronomical Journal 68, 555;
as arranged by Schaub and Junkins, Analytical Mechanics of Space Systems, 4th ed., appendix F, plus the terms in
e^2 of the longitude that it leaves out.
"""

import jax
import jax.numpy as jnp

from astrojax._types import Vector6, safe_sqrt
from astrojax.constants import J2, R_EARTH
from astrojax.orbits._angles import nearest, positive
from astrojax.orbits.anomalies import mean_to_true

_CRITICAL = 0.02  # of 1 - 5 cos^2 i: within some 0.3 deg of the critical inclination the divisors mean nothing
_STEPS = 6


def mean_to_osculating(mean: Vector6) -> Vector6:
    """Osculating elements of mean ones, by the periodic terms of J2.

    Args:
        mean: (6,) mean [a, e, i, raan, argp, M], m and rad; 0 <= e < 1, 0 <= i < pi.

    Returns:
        (6,) osculating, angles in [0, 2 pi).

    Validity: first order in J2, some 10 m in a low orbit. Within 0.3 deg of the critical inclination (63.43 deg and its
    supplement) the long-period terms are left out: their divisor vanishes there.
    """
    return _lyddane(mean)


def osculating_to_mean(osculating: Vector6) -> Vector6:
    """Mean elements of osculating ones: the inverse of `mean_to_osculating`, by fixed-point iteration.

    Args:
        osculating: (6,) [a, e, i, raan, argp, M], m and rad; 0 <= e < 1, 0 < i < pi.

    Returns:
        (6,) mean, angles in [0, 2 pi).

    Validity: as `mean_to_osculating`, which it inverts to rounding (six steps, each a thousand times nearer).
    """
    target = _nonsingular(osculating)

    def step(_, guess):
        miss = target - _nonsingular(_lyddane(_singular(guess)))
        return guess + jnp.concatenate([miss[:5], nearest(miss[5])[None]])

    return _singular(jax.lax.fori_loop(0, _STEPS, step, target))


def _lyddane(elements: Vector6) -> Vector6:
    a, e, inc, raan, argp, m = elements
    s_i, c_i = jnp.sin(inc), jnp.cos(inc)
    c2, s2 = c_i * c_i, s_i * s_i
    eta2 = (1.0 - e) * (1.0 + e)
    eta = jnp.sqrt(eta2)
    ratio = R_EARTH / a
    g2 = 0.5 * J2 * ratio * ratio
    g2p = g2 / (eta2 * eta2)
    nu = mean_to_true(m, e)
    cos_f, sin_f = jnp.cos(nu), jnp.sin(nu)
    by_r = (1.0 + e * cos_f) / eta2  # a / r
    by_r3 = by_r * by_r * by_r
    centre = nu - m + e * sin_f

    cos_1, sin_1 = jnp.cos(2.0 * argp + nu), jnp.sin(2.0 * argp + nu)
    cos_2, sin_2 = jnp.cos(2.0 * argp + 2.0 * nu), jnp.sin(2.0 * argp + 2.0 * nu)
    cos_3, sin_3 = jnp.cos(2.0 * argp + 3.0 * nu), jnp.sin(2.0 * argp + 3.0 * nu)
    cos_w, sin_w = jnp.cos(2.0 * argp), jnp.sin(2.0 * argp)
    waves_s = 3.0 * sin_2 + 3.0 * e * sin_1 + e * sin_3
    waves_c = 3.0 * cos_2 + 3.0 * e * cos_1 + e * cos_3

    divisor = 1.0 - 5.0 * c2
    away = jnp.abs(divisor) > _CRITICAL
    inv = jnp.where(away, 1.0 / jnp.where(away, divisor, 1.0), 0.0)
    sin_w, cos_w = jnp.where(away, sin_w, 0.0), jnp.where(away, cos_w, 0.0)
    long_e = (1.0 - 15.0 * c2) * inv  # (1 - 11 c^2 - 40 c^4 / (1 - 5 c^2)) / sin^2 i
    long_h = 11.0 + 80.0 * c2 * inv + 200.0 * c2 * c2 * inv * inv

    a_new = a + a * g2 * ((3.0 * c2 - 1.0) * (by_r3 - 1.0 / (eta2 * eta)) + 3.0 * s2 * by_r3 * cos_2)

    poly = 3.0 * cos_f + 3.0 * e * cos_f * cos_f + e * e * cos_f * cos_f * cos_f
    de = g2p / 8.0 * e * eta2 * s2 * long_e * cos_w + 0.5 * eta2 * (
        g2
        / (eta2 * eta2 * eta2)
        * ((3.0 * c2 - 1.0) * (e * eta + e / (1.0 + eta) + poly) + 3.0 * s2 * (e + poly) * cos_2)
        - g2p * s2 * (3.0 * cos_1 + cos_3)
    )
    di = -e * e * g2p / 8.0 * s_i * c_i * long_e * cos_w + 0.5 * g2p * c_i * s_i * waves_c

    u2 = eta2 * by_r * by_r + by_r
    brace = 2.0 * (3.0 * c2 - 1.0) * (u2 + 1.0) * sin_f + 3.0 * s2 * ((1.0 - u2) * sin_1 + (u2 + 1.0 / 3.0) * sin_3)
    e_dm = g2p / 8.0 * e * eta2 * eta * s2 * long_e * sin_w - g2p / 4.0 * eta2 * eta * brace
    e2 = e * e
    long_g = (
        2.0 + e2 - 11.0 * (2.0 + 3.0 * e2) * c2 - 40.0 * (2.0 + 5.0 * e2) * c2 * c2 * inv
        - 400.0 * e2 * c2 * c2 * c2 * inv * inv
    )  # fmt: skip
    d_node = -0.125 * g2p * e2 * c_i * long_h * sin_w - 0.5 * g2p * c_i * (6.0 * centre - waves_s)
    d_sum = (
        g2p / 8.0 * eta2 * eta * s2 * long_e * sin_w
        - g2p / 16.0 * long_g * sin_w
        + 0.25 * g2p * (-6.0 * divisor * centre + (3.0 - 5.0 * c2) * waves_s)
        + 0.25 * g2p * eta2 * e / (1.0 + eta) * brace
        + d_node
    )

    sin_m, cos_m = jnp.sin(m), jnp.cos(m)
    d1, d2 = (e + de) * sin_m + e_dm * cos_m, (e + de) * cos_m - e_dm * sin_m
    half_s, half_c = jnp.sin(0.5 * inc), jnp.cos(0.5 * inc)
    tilt = half_s + 0.5 * half_c * di
    # sin(i/2) d_node keeps a zero inclination regular.
    d3 = tilt * jnp.sin(raan) + half_s * d_node * jnp.cos(raan)
    d4 = tilt * jnp.cos(raan) - half_s * d_node * jnp.sin(raan)
    m_new, e_new = _polar(d1, d2)
    raan_new, half = _polar(d3, d4)
    inc_new = 2.0 * jnp.arctan2(half, safe_sqrt(1.0 - half * half))
    argp_new = m + argp + raan + d_sum - m_new - raan_new
    return jnp.stack([a_new, e_new, inc_new, positive(raan_new), positive(argp_new), positive(m_new)])


def _polar(y, x):
    """Angle and length, with a finite gradient at zero."""
    square = x * x + y * y
    apart = square > 0.0
    return jnp.arctan2(jnp.where(apart, y, 0.0), jnp.where(apart, x, 1.0)), safe_sqrt(square)


def _nonsingular(elements: Vector6) -> Vector6:
    """[a, e cos M, e sin M, sin(i/2) cos raan, sin(i/2) sin raan, raan + argp + M], which move little and smoothly."""
    a, e, inc, raan, argp, m = elements
    half = jnp.sin(0.5 * inc)
    parts = e * jnp.cos(m), e * jnp.sin(m), half * jnp.cos(raan), half * jnp.sin(raan)
    return jnp.stack([a, *parts, raan + argp + m])


def _singular(elements: Vector6) -> Vector6:
    a, x, y, z, w, total = elements
    m, e = _polar(y, x)
    raan, half = _polar(w, z)
    inc = 2.0 * jnp.arctan2(half, safe_sqrt(1.0 - half * half))
    return jnp.stack([a, e, inc, *(positive(angle) for angle in (raan, total - m - raan, m))])
