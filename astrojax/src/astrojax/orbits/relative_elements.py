"""Quasi-nonsingular relative orbital elements [da, dl, dex, dey, dix, diy], and their drift under J2.

Of a deputy against a chief: relative semi-major axis and mean longitude, and the relative eccentricity and
inclination vectors. Without unit or in radians; times the chief's semi-major axis they are metres.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Scalar, Vector6
from astrojax.constants import GM_EARTH, J2, R_EARTH
from astrojax.orbits._angles import nearest, positive


def keplerian_to_roe(chief: Vector6, deputy: Vector6) -> Vector6:
    """Relative orbital elements of a deputy.

    Args:
        chief: (6,) [a, e, i, raan, argp, M], m and rad.
        deputy: (6,) likewise.

    Validity: any size, chief not equatorial. Singular where the chief's inclination is zero.

    Source: D'Amico (2010), Autonomous Formation Flying in Low Earth Orbit, eq. 2.2.
    """
    a, e, inc, raan, argp, m = chief
    a_d, e_d, inc_d, raan_d, argp_d, m_d = deputy
    node = nearest(raan_d - raan)
    return jnp.stack(
        [
            (a_d - a) / a,
            nearest(m_d - m + argp_d - argp + node * jnp.cos(inc)),
            e_d * jnp.cos(argp_d) - e * jnp.cos(argp),
            e_d * jnp.sin(argp_d) - e * jnp.sin(argp),
            inc_d - inc,
            node * jnp.sin(inc),
        ]
    )


def roe_to_keplerian(chief: Vector6, roe: Vector6) -> Vector6:
    """A deputy's [a, e, i, raan, argp, M] (6,), m and rad, angles in [0, 2 pi): the inverse of `keplerian_to_roe`.

    Args:
        chief: (6,) [a, e, i, raan, argp, M], m and rad, not equatorial.
        roe: (6,) relative orbital elements.

    Validity: the perigee of a circular deputy is taken at the node.
    """
    a, e, inc, raan, argp, m = chief
    da, dl, dex, dey, dix, diy = roe
    ex, ey = dex + e * jnp.cos(argp), dey + e * jnp.sin(argp)
    square = ex * ex + ey * ey
    eccentric = square > (8.0 * jnp.finfo(square.dtype).eps) ** 2
    e_d = jnp.where(eccentric, jnp.sqrt(jnp.where(eccentric, square, 1.0)), 0.0)
    argp_d = jnp.arctan2(jnp.where(eccentric, ey, 0.0), jnp.where(eccentric, ex, 1.0))
    node = diy / jnp.sin(inc)
    m_d = m + dl - (argp_d - argp) - node * jnp.cos(inc)
    angles = (positive(angle) for angle in (raan + node, argp_d, m_d))
    return jnp.stack([a * (1.0 + da), e_d, inc + dix, *angles])


def stm_roe_j2(chief: Vector6, dt: Scalar, gm: Scalar = GM_EARTH) -> Float[Array, "6 6"]:
    """State-transition matrix of relative orbital elements under two-body motion and secular J2.

    Args:
        chief: (6,) mean [a, e, i, raan, argp, M] at the start, m and rad; 0 <= e < 1.
        dt: seconds, either sign.
        gm: gravitational parameter [m^3/s^2].

    Validity: mean elements, small separations; first order in J2. Osculating elements differ by short-period terms.

    Source: Koenig, Guffanti, D'Amico (2017), J. Guidance, Control, and Dynamics 40(7), 1749, eq. A6.
    """
    a, e, inc, _, argp, _ = chief
    dt = jnp.asarray(dt, chief.dtype)
    n = jnp.sqrt(gm / a) / a
    shape = (1.0 - e) * (1.0 + e)
    eta = jnp.sqrt(shape)
    ratio = R_EARTH / (a * shape)
    k = 0.75 * J2 * ratio * ratio * n * dt
    sin_i, cos_i = jnp.sin(inc), jnp.cos(inc)
    big_e, big_f, big_g = 1.0 + eta, 4.0 + 3.0 * eta, 1.0 / shape
    p, q = 3.0 * cos_i * cos_i - 1.0, 5.0 * cos_i * cos_i - 1.0
    s, t = 2.0 * sin_i * cos_i, sin_i * sin_i
    turned = k * q
    x0, y0 = e * jnp.cos(argp), e * jnp.sin(argp)
    x1, y1 = e * jnp.cos(argp + turned), e * jnp.sin(argp + turned)
    c_w, s_w = jnp.cos(turned), jnp.sin(turned)
    zero, one = jnp.zeros_like(k), jnp.ones_like(k)
    g4q = 4.0 * k * big_g * q
    fgp = k * big_f * big_g * p
    rows = [
        [one, zero, zero, zero, zero, zero],
        [-1.5 * n * dt - 3.5 * k * big_e * p, one, x0 * fgp, y0 * fgp, -k * big_f * s, zero],
        [3.5 * k * y1 * q, zero, c_w - x0 * y1 * g4q, -s_w - y0 * y1 * g4q, 5.0 * k * y1 * s, zero],
        [-3.5 * k * x1 * q, zero, s_w + x0 * x1 * g4q, c_w + y0 * x1 * g4q, -5.0 * k * x1 * s, zero],
        [zero, zero, zero, zero, one, zero],
        [3.5 * k * s, zero, -4.0 * k * x0 * big_g * s, -4.0 * k * y0 * big_g * s, 2.0 * k * t, one],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])
