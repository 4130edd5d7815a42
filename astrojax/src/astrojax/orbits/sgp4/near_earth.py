"""What SGP4 prepares from mean elements at epoch, near-Earth part: mean motion, secular rates, drag series.

All in Earth radii and minutes. Names follow the report, so that equations can be found in it.
Source: Vallado et al., Revisiting Spacetrack Report #3, AIAA 2006-6753, appendix B; Hoots and Roehrich (1980),
Spacetrack Report No. 3, sec. 6.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.orbits.sgp4.gravity import Gravity

Number = Float[Array, "..."]

_CIRCULAR = 1e-4  # below this eccentricity the report drops the drag terms that divide by it
_RETROGRADE = 1.5e-12  # 1 + cos(inclination) does not go below this


class Mean(NamedTuple):
    """Mean elements at epoch, with the mean motion in Brouwer's sense, and their secular rates [rad/min]."""

    n: Number
    a: Number
    e: Number
    inc: Number
    raan: Number
    argp: Number
    m: Number
    sin_inc: Number
    cos_inc: Number
    m_dot: Number
    argp_dot: Number
    raan_dot: Number


class Drag(NamedTuple):
    """Coefficients of the drag series in time since epoch; those of high order are zero where the report drops them."""

    raan2: Number  # of t^2 in the node
    a1: Number  # of t in the semi-major axis: C1
    a2: Number
    a3: Number
    a4: Number
    e1: Number  # of t in the eccentricity: B* C4
    e_sin: Number  # of sin M in the eccentricity: B* C5
    l2: Number  # of t^2 in the mean longitude, by the mean motion
    l3: Number
    l4: Number
    l5: Number
    argp1: Number  # of t in the perigee
    m_cube: Number  # of (1 + eta cos M)^3 in anomaly and perigee
    eta: Number
    cube0: Number  # (1 + eta cos M)^3 at epoch
    sin_m0: Number


def mean_at_epoch(elements: Any, g: Gravity) -> Mean:
    """Mean elements with Kozai's correction taken out of the mean motion, and the secular rates of J2 and J4."""
    n0, e, inc = 60.0 * elements.mean_motion, elements.e, elements.inc
    sin_i, cos_i = jnp.sin(inc), jnp.cos(inc)
    c2 = cos_i * cos_i
    c4 = c2 * c2
    shape = 1.0 - e * e
    root = jnp.sqrt(shape)

    a1 = jnp.cbrt(g.ke / n0) ** 2
    d1 = 0.75 * g.j2 * (3.0 * c2 - 1.0) / (root * shape)
    first = d1 / (a1 * a1)
    a0 = a1 * (1.0 - first * first - first * (1.0 / 3.0 + 134.0 * first * first / 81.0))
    n = n0 / (1.0 + d1 / (a0 * a0))
    a = jnp.cbrt(g.ke / n) ** 2

    p = a * shape
    by_p2 = 1.0 / (p * p)
    k1 = 1.5 * g.j2 * by_p2 * n
    k2 = 0.5 * k1 * g.j2 * by_p2
    k4 = -0.46875 * g.j4 * by_p2 * by_p2 * n
    m_dot = n + 0.5 * k1 * root * (3.0 * c2 - 1.0) + 0.0625 * k2 * root * (13.0 - 78.0 * c2 + 137.0 * c4)
    argp_dot = (
        -0.5 * k1 * (1.0 - 5.0 * c2)
        + 0.0625 * k2 * (7.0 - 114.0 * c2 + 395.0 * c4)
        + k4 * (3.0 - 36.0 * c2 + 49.0 * c4)
    )
    raan_dot = -k1 * cos_i + (0.5 * k2 * (4.0 - 19.0 * c2) + 2.0 * k4 * (3.0 - 7.0 * c2)) * cos_i
    angles = elements.raan, elements.argp, elements.mean_anomaly
    return Mean(n, a, e, inc, *angles, sin_i, cos_i, m_dot, argp_dot, raan_dot)


def drag_series(mean: Mean, bstar: Number, deep: Array, g: Gravity) -> Drag:
    """The drag series of the report; `deep` satellites keep only its lowest terms, as do perigees below 220 km."""
    n, a, e, cos_i = mean.n, mean.a, mean.e, mean.cos_inc
    radius_km = 1e-3 * g.radius
    c2 = cos_i * cos_i
    con41, x1mth2 = 3.0 * c2 - 1.0, 1.0 - c2
    shape = 1.0 - e * e
    perigee = a * (1.0 - e)
    height = (perigee - 1.0) * radius_km
    s_km = jnp.where(height < 98.0, 20.0, jnp.where(height < 156.0, height - 78.0, 78.0))
    s = s_km / radius_km + 1.0
    q4 = ((120.0 - s_km) / radius_km) ** 4

    tsi = 1.0 / (a - s)
    eta = a * e * tsi
    eta2, e_eta = eta * eta, e * eta
    psi2 = jnp.abs(1.0 - eta2)
    coef = q4 * tsi**4
    coef1 = coef / (psi2 * psi2 * psi2 * jnp.sqrt(psi2))
    c2_ = (
        coef1
        * n
        * (
            a * (1.0 + 1.5 * eta2 + e_eta * (4.0 + eta2))
            + 0.375 * g.j2 * tsi / psi2 * con41 * (8.0 + 3.0 * eta2 * (8.0 + eta2))
        )
    )
    c1 = bstar * c2_
    eccentric = e > _CIRCULAR
    e_safe = jnp.where(eccentric, e, 1.0)
    c3 = jnp.where(eccentric, -2.0 * coef * tsi * (g.j3 / g.j2) * n * mean.sin_inc / e_safe, 0.0)
    j2_part = -3.0 * con41 * (1.0 - 2.0 * e_eta + eta2 * (1.5 - 0.5 * e_eta)) + 0.75 * x1mth2 * (
        2.0 * eta2 - e_eta * (1.0 + eta2)
    ) * jnp.cos(2.0 * mean.argp)
    c4_ = (2.0 * n * coef1 * a * shape) * (
        eta * (2.0 + 0.5 * eta2) + e * (0.5 + 2.0 * eta2) - g.j2 * tsi / (a * psi2) * j2_part
    )
    c5 = 2.0 * coef1 * a * shape * (1.0 + 2.75 * (eta2 + e_eta) + e_eta * eta2)
    eta_safe = jnp.where(eccentric, eta, 1.0)
    m_cube = jnp.where(eccentric, -(2.0 / 3.0) * coef * bstar / (e_safe * eta_safe), 0.0)

    c1_2 = c1 * c1
    d2 = 4.0 * a * tsi * c1_2
    step = d2 * tsi * c1 / 3.0
    d3 = (17.0 * a + s) * step
    d4 = 0.5 * step * a * tsi * (221.0 * a + 31.0 * s) * c1
    l3 = d2 + 2.0 * c1_2
    l4 = 0.25 * (3.0 * d3 + c1 * (12.0 * d2 + 10.0 * c1_2))
    l5 = 0.2 * (3.0 * d4 + 12.0 * c1 * d3 + 6.0 * d2 * d2 + 15.0 * c1_2 * (2.0 * d2 + c1_2))

    simple = deep | (perigee < 220.0 / radius_km + 1.0)
    high = [d2, d3, d4, bstar * c5, l3, l4, l5, bstar * c3 * jnp.cos(mean.argp), m_cube]
    d2, d3, d4, e_sin, l3, l4, l5, argp1, m_cube = (jnp.where(simple, 0.0, term) for term in high)
    raan_first = -1.5 * g.j2 / (a * shape) ** 2 * n * cos_i
    return Drag(
        raan2=3.5 * shape * raan_first * c1,
        a1=c1,
        a2=d2,
        a3=d3,
        a4=d4,
        e1=bstar * c4_,
        e_sin=e_sin,
        l2=1.5 * c1,
        l3=l3,
        l4=l4,
        l5=l5,
        argp1=argp1,
        m_cube=m_cube,
        eta=eta,
        cube0=(1.0 + eta * jnp.cos(mean.m)) ** 3,
        sin_m0=jnp.sin(mean.m),
    )


def long_period(sin_i: Number, cos_i: Number, g: Gravity) -> tuple[Number, Number]:
    """Coefficients of J3 in the mean longitude and in e sin(perigee): XLCOF, AYCOF."""
    j3_j2 = g.j3 / g.j2
    divisor = jnp.where(jnp.abs(cos_i + 1.0) > _RETROGRADE, 1.0 + cos_i, _RETROGRADE)
    return -0.25 * j3_j2 * sin_i * (3.0 + 5.0 * cos_i) / divisor, -0.5 * j3_j2 * sin_i
