"""What Sun and Moon do to a deep-space satellite: secular rates, and periodic terms of their own motion.

Both bodies go through one function. Units are radians and minutes.
Source: Vallado et al., Revisiting Spacetrack Report #3, AIAA 2006-6753, appendix B (the deep-space common, periodic
and initialisation parts); Hujsak (1979), Spacetrack Report No. 1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from astrojax.orbits.sgp4.near_earth import Mean, Number
from astrojax.orbits.sgp4.trigonometry import sincos, within_a_turn

_PI = 3.141592653589793
_LYDDANE = 0.2  # inclination [rad] below which node and perigee are corrected together
_NEARLY_EQUATORIAL = 5.2359877e-2  # 3 deg: the secular node is left alone below it

# Eccentricity, mean motion [rad/min] and strength of each body as the theory holds them.
SUN_E, SUN_RATE, SUN_STRENGTH = 0.01675, 1.19459e-5, 2.9864797e-6
MOON_E, MOON_RATE, MOON_STRENGTH = 0.05490, 1.5835218e-4, 4.7968065e-7


class Body(NamedTuple):
    """Periodic terms of one body, by the three functions of its anomaly, and its mean anomaly at epoch."""

    m0: Number
    e2: Number
    e3: Number
    i2: Number
    i3: Number
    l2: Number
    l3: Number
    l4: Number
    g2: Number
    g3: Number
    g4: Number
    h2: Number
    h3: Number


class Rates(NamedTuple):
    """Secular rates of the mean elements by Sun and Moon [1/min, rad/min]."""

    e: Number
    inc: Number
    m: Number
    argp: Number
    raan: Number


def _orientation(day1900: Number) -> tuple:
    """Perigee, inclination and node of the Moon against the equator on a day since 1900, and both mean anomalies."""
    node = jax.lax.rem(4.5236020 - 9.2422029e-4 * day1900, jnp.full_like(day1900, 2.0 * _PI))
    sin_n, cos_n = jnp.sin(node), jnp.cos(node)
    cos_i = 0.91375164 - 0.03568096 * cos_n
    sin_i = jnp.sqrt(1.0 - cos_i * cos_i)
    sin_h = 0.089683511 * sin_n / sin_i
    cos_h = jnp.sqrt(1.0 - sin_h * sin_h)
    gamma = 5.8351514 + 0.0019443680 * day1900
    along = jnp.arctan2(0.39785416 * sin_n / sin_i, cos_h * cos_n + 0.91744867 * sin_h * sin_n)
    perigee = gamma + along - node
    turn = jnp.full_like(day1900, 2.0 * _PI)
    moon_m = jax.lax.rem(4.7199672 + 0.22997150 * day1900 - gamma, turn)
    sun_m = jax.lax.rem(6.2565837 + 0.017201977 * day1900, turn)
    return (jnp.cos(perigee), jnp.sin(perigee), cos_i, sin_i, cos_h, sin_h), sun_m, moon_m


def _body(mean: Mean, orientation, e_body: float, rate: float, strength: float, m0: Number):
    """Periodic terms and secular rates (e, i, M, perigee and node by parts) of one body."""
    cos_g, sin_g, zcos_i, zsin_i, cos_h, sin_h = orientation  # cos_h, sin_h: of the satellite's node from the body's
    e, sin_i, cos_i = mean.e, mean.sin_inc, mean.cos_inc
    sin_w, cos_w = jnp.sin(mean.argp), jnp.cos(mean.argp)
    e2 = e * e
    beta2 = 1.0 - e2
    root = jnp.sqrt(beta2)

    a1 = cos_g * cos_h + sin_g * zcos_i * sin_h
    a3 = -sin_g * cos_h + cos_g * zcos_i * sin_h
    a7 = -cos_g * sin_h + sin_g * zcos_i * cos_h
    a8 = sin_g * zsin_i
    a9 = sin_g * sin_h + cos_g * zcos_i * cos_h
    a10 = cos_g * zsin_i
    a2, a4 = cos_i * a7 + sin_i * a8, cos_i * a9 + sin_i * a10
    a5, a6 = -sin_i * a7 + cos_i * a8, -sin_i * a9 + cos_i * a10

    x1, x2 = a1 * cos_w + a2 * sin_w, a3 * cos_w + a4 * sin_w
    x3, x4 = -a1 * sin_w + a2 * cos_w, -a3 * sin_w + a4 * cos_w
    x5, x6, x7, x8 = a5 * sin_w, a6 * sin_w, a5 * cos_w, a6 * cos_w

    z31 = 12.0 * x1 * x1 - 3.0 * x3 * x3
    z32 = 24.0 * x1 * x2 - 6.0 * x3 * x4
    z33 = 12.0 * x2 * x2 - 3.0 * x4 * x4
    z1 = 6.0 * (a1 * a1 + a2 * a2) + (1.0 + e2) * z31
    z2 = 12.0 * (a1 * a3 + a2 * a4) + (1.0 + e2) * z32
    z3 = 6.0 * (a3 * a3 + a4 * a4) + (1.0 + e2) * z33
    z11 = -6.0 * a1 * a5 + e2 * (-24.0 * x1 * x7 - 6.0 * x3 * x5)
    z12 = -6.0 * (a1 * a6 + a3 * a5) + e2 * (-24.0 * (x2 * x7 + x1 * x8) - 6.0 * (x3 * x6 + x4 * x5))
    z13 = -6.0 * a3 * a6 + e2 * (-24.0 * x2 * x8 - 6.0 * x4 * x6)
    z21 = 6.0 * a2 * a5 + e2 * (24.0 * x1 * x5 - 6.0 * x3 * x7)
    z22 = 6.0 * (a4 * a5 + a2 * a6) + e2 * (24.0 * (x2 * x5 + x1 * x6) - 6.0 * (x4 * x7 + x3 * x8))
    z23 = 6.0 * a4 * a6 + e2 * (24.0 * x2 * x6 - 6.0 * x4 * x8)

    s3 = strength / mean.n
    s2 = -0.5 * s3 / root
    s4 = s3 * root
    s1 = -15.0 * e * s4
    s5, s6, s7 = x1 * x3 + x2 * x4, x2 * x3 + x1 * x4, x2 * x4 - x1 * x3

    periodic = Body(
        m0=m0,
        e2=2.0 * s1 * s6,
        e3=2.0 * s1 * s7,
        i2=2.0 * s2 * z12,
        i3=2.0 * s2 * (z13 - z11),
        l2=-2.0 * s3 * z2,
        l3=-2.0 * s3 * (z3 - z1),
        l4=-2.0 * s3 * (-21.0 - 9.0 * e2) * e_body,
        g2=2.0 * s4 * z32,
        g3=2.0 * s4 * (z33 - z31),
        g4=-18.0 * s4 * e_body,
        h2=-2.0 * s2 * z22,
        h3=-2.0 * s2 * (z23 - z21),
    )
    equatorial = (mean.inc < _NEARLY_EQUATORIAL) | (mean.inc > _PI - _NEARLY_EQUATORIAL)
    node = jnp.where(equatorial, 0.0, -rate * s2 * (z21 + z23) / jnp.where(equatorial, 1.0, sin_i))
    rates = Rates(
        e=rate * s1 * s5,
        inc=rate * s2 * (z11 + z13),
        m=-rate * s3 * (z1 + z3 - 14.0 - 6.0 * e2),
        argp=rate * s4 * (z31 + z33 - 6.0) - cos_i * node,
        raan=node,
    )
    return periodic, rates


def lunisolar(mean: Mean, day1900: Number) -> tuple[Body, Body, Rates]:
    """Periodic terms of the Sun and of the Moon, and the sum of their secular rates.

    Args:
        mean: elements at epoch.
        day1900: epoch in days since 1899 December 31.5.
    """
    (cos_g, sin_g, cos_i, sin_i, cos_h, sin_h), sun_m, moon_m = _orientation(day1900)
    sin_node, cos_node = jnp.sin(mean.raan), jnp.cos(mean.raan)
    one = jnp.ones_like(mean.n)
    sun_axes = (0.1945905 * one, -0.98088458 * one, 0.91744867 * one, 0.39785416 * one, cos_node, sin_node)
    moon_axes = (cos_g, sin_g, cos_i, sin_i, cos_h * cos_node + sin_h * sin_node, sin_node * cos_h - cos_node * sin_h)
    sun, sun_rates = _body(mean, sun_axes, SUN_E, SUN_RATE, SUN_STRENGTH, sun_m)
    moon, moon_rates = _body(mean, moon_axes, MOON_E, MOON_RATE, MOON_STRENGTH, moon_m)
    return sun, moon, jax.tree.map(jnp.add, sun_rates, moon_rates)


def _periodic(body: Body, e_body: float, rate: float, minutes: Number) -> tuple:
    zm = body.m0 + rate * minutes
    sin_f, cos_f = sincos(zm + 2.0 * e_body * sincos(zm)[0])
    f2, f3 = 0.5 * sin_f * sin_f - 0.25, -0.5 * sin_f * cos_f
    return (
        body.e2 * f2 + body.e3 * f3,
        body.i2 * f2 + body.i3 * f3,
        body.l2 * f2 + body.l3 * f3 + body.l4 * sin_f,
        body.g2 * f2 + body.g3 * f3 + body.g4 * sin_f,
        body.h2 * f2 + body.h3 * f3,
    )


def add_periodic(sun: Body, moon: Body, minutes: Number, elements: tuple, opsmode: str) -> tuple:
    """Elements (e, i, node, perigee, M) with the periodic terms of Sun and Moon.

    Below 0.2 rad of inclination node and perigee are ill defined one by one; Lyddane's form corrects their sum.
    """
    e, inc, raan, argp, m = elements
    de, di, dl, dg, dh = jax.tree.map(
        jnp.add, _periodic(sun, SUN_E, SUN_RATE, minutes), _periodic(moon, MOON_E, MOON_RATE, minutes)
    )
    inc, e = inc + di, e + de
    sin_i, cos_i = sincos(inc)
    high = inc >= _LYDDANE
    node = dh / jnp.where(high, sin_i, 1.0)
    plain = raan + node, argp + dg - cos_i * node, m + dl

    turn = jnp.full_like(raan, 2.0 * _PI)
    sin_n, cos_n = sincos(raan)
    alpha = sin_i * sin_n + dh * cos_n + di * cos_i * sin_n
    beta = sin_i * cos_n - dh * sin_n + di * cos_i * cos_n
    before = within_a_turn(raan)
    if opsmode == "afspc":
        before = jnp.where(before < 0.0, before + turn, before)
    longitude = within_a_turn(m + argp + cos_i * before + dl + dg - di * before * sin_i)
    undefined = (alpha == 0.0) & (beta == 0.0)
    after = jnp.arctan2(alpha, jnp.where(undefined, 1.0, beta))
    if opsmode == "afspc":
        after = jnp.where(after < 0.0, after + turn, after)
    far = jnp.abs(before - after) > _PI
    after = after + jnp.where(far, jnp.where(after < before, turn, -turn), 0.0)
    low = after, longitude - (m + dl) - cos_i * after, m + dl
    raan, argp, m = (jnp.where(high, a, b) for a, b in zip(plain, low))
    return e, inc, raan, argp, m
