"""Keplerian elements [a, e, i, raan, argp, M] and their two-body motion.

Elliptic orbits only (0 <= e < 1). Lengths in metres, angles in radians, `gm` in m^3/s^2.
"""

import jax
import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar, Vector6, cross, dot, float_dtype, inverse_norm, safe_sqrt
from astrojax.constants import GM_EARTH, J2, R_EARTH
from astrojax.orbits._angles import TURN, nearest, unsigned

_KEPLER_STEPS = 5


def mean_motion(a: Scalar, gm: Scalar = GM_EARTH) -> FloatScalar:
    """Mean motion [rad/s] of an orbit of semi-major axis `a` [m]."""
    a = jnp.asarray(a)
    return jnp.sqrt(gm / a) / a  # a**3 would overflow float32 when differentiated


@jax.custom_jvp
def _solve_kepler(mean_anomaly: FloatScalar, e: FloatScalar) -> FloatScalar:
    m = nearest(mean_anomaly)
    ecc = m + 0.85 * e * jnp.where(m < 0, -1.0, 1.0)
    for _ in range(_KEPLER_STEPS):
        es, ec = e * jnp.sin(ecc), e * jnp.cos(ecc)
        f, df = ecc - es - m, 1.0 - ec
        d1 = -f / df
        d2 = -f / (df + 0.5 * d1 * es)
        ecc = ecc - f / (df + 0.5 * d2 * es + d2 * d2 * ec / 6.0)
    return ecc


@_solve_kepler.defjvp
def _solve_kepler_jvp(primals, tangents):
    # Implicit differentiation of E - e sin E = M: exact at every order, whatever the iteration did.
    mean_anomaly, e = primals
    dm, de = tangents
    ecc = _solve_kepler(mean_anomaly, e)
    return ecc, (dm + jnp.sin(ecc) * de) / (1.0 - e * jnp.cos(ecc))


def solve_kepler(mean_anomaly: Scalar, e: Scalar) -> FloatScalar:
    """Eccentric anomaly E [rad, in [-pi, pi]] with E - e sin E = M (modulo a turn).

    Args:
        mean_anomaly: M [rad], any number of turns.
        e: eccentricity, 0 <= e <= 0.99 (five fixed quartic steps reach rounding level there).

    Source: Danby, Fundamentals of Celestial Mechanics, 2nd ed., sec. 6.6 (quartic iteration and starting value).
    """
    dtype = float_dtype(mean_anomaly, e)
    return _solve_kepler(jnp.asarray(mean_anomaly, dtype), jnp.asarray(e, dtype))


def propagate_keplerian(elements: Vector6, dt: Scalar, gm: Scalar = GM_EARTH) -> Vector6:
    """Elements after `dt` seconds of two-body motion; the mean anomaly comes back in [0, 2 pi).

    Args:
        elements: (6,) [a, e, i, raan, argp, M], m and rad.
        dt: seconds, either sign. In float32 a week costs about 4e-5 rad.
    """
    anomaly = elements[5] + mean_motion(elements[0], gm) * dt
    return elements.at[5].set(anomaly - TURN * jnp.floor(anomaly / TURN))


def secular_rates_j2(elements: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Mean rates by which the Earth's oblateness turns an orbit: zero, zero, zero, node, perigee, anomaly [rad/s].

    The last is what J2 adds to the mean motion.

    Args:
        elements: (6,) mean [a, e, i, raan, argp, M], m and rad; 0 <= e < 1.

    Validity: first order in J2, averaged over a revolution. Osculating elements differ from mean ones by 1e-3 or so,
    and the rates in proportion.

    Source: Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., sec. 9.6.1.
    """
    a, e, cos_i = elements[0], elements[1], jnp.cos(elements[2])
    shape = (1.0 - e) * (1.0 + e)
    ratio = R_EARTH / (a * shape)
    scale = 0.75 * J2 * mean_motion(a, gm) * ratio * ratio
    node = -2.0 * scale * cos_i
    perigee = scale * (5.0 * cos_i * cos_i - 1.0)
    anomaly = scale * jnp.sqrt(shape) * (3.0 * cos_i * cos_i - 1.0)
    zero = jnp.zeros_like(node)
    return jnp.stack([zero, zero, zero, node, perigee, anomaly])


def keplerian_to_cartesian(elements: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Inertial position and velocity [m, m/s] of osculating elements.

    Args:
        elements: (6,) [a, e, i, raan, argp, M], m and rad; 0 <= e <= 0.99.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 2.2.3.
    """
    a, e, inc, raan, argp, m = elements
    ecc = solve_kepler(m, e)
    sin_e, cos_e = jnp.sin(ecc), jnp.cos(ecc)
    root = jnp.sqrt((1.0 - e) * (1.0 + e))
    sin_i, cos_i = jnp.sin(inc), jnp.cos(inc)
    sin_o, cos_o = jnp.sin(raan), jnp.cos(raan)
    sin_w, cos_w = jnp.sin(argp), jnp.cos(argp)
    p = jnp.stack([cos_w * cos_o - sin_w * cos_i * sin_o, cos_w * sin_o + sin_w * cos_i * cos_o, sin_w * sin_i])
    q = jnp.stack([-sin_w * cos_o - cos_w * cos_i * sin_o, -sin_w * sin_o + cos_w * cos_i * cos_o, cos_w * sin_i])
    speed = jnp.sqrt(gm / a) / (1.0 - e * cos_e)
    position = a * (cos_e - e) * p + a * root * sin_e * q
    velocity = -speed * sin_e * p + speed * root * cos_e * q
    return jnp.concatenate([position, velocity])


def cartesian_to_keplerian(state: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Osculating elements [a, e, i, raan, argp, M] of an inertial state; angles in [0, 2 pi).

    Args:
        state: (6,) position and velocity [m, m/s], inertial, of an elliptic orbit (not rectilinear).

    Validity: for an equatorial orbit the node is taken along +x, for a circular one the perigee at the node,
    so every orbit has finite elements and gradients. The thresholds are the rounding level of the dtype.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 2.2.4, in vector form.
    """
    r, v = state[:3], state[3:]
    inv_r = inverse_norm(r)
    h = cross(r, v)
    inv_h = inverse_norm(h)
    w = h * inv_h
    a = 1.0 / (2.0 * inv_r - dot(v, v) / gm)
    tiny = (8.0 * jnp.finfo(state.dtype).eps) ** 2

    node_sq = w[0] * w[0] + w[1] * w[1]
    inclined = node_sq > tiny
    inv_node = jax.lax.rsqrt(jnp.where(inclined, node_sq, 1.0))
    zero, one = jnp.zeros_like(a), jnp.ones_like(a)
    node = jnp.where(inclined, jnp.stack([-w[1], w[0], zero]) * inv_node, jnp.stack([one, zero, zero]))
    inc = jnp.arctan2(jnp.where(inclined, safe_sqrt(node_sq), 0.0), w[2])

    ecc_vector = cross(v, h) / gm - r * inv_r
    ecc_sq = dot(ecc_vector, ecc_vector)
    eccentric = ecc_sq > tiny
    e = jnp.where(eccentric, safe_sqrt(ecc_sq), 0.0)
    apse = jnp.where(eccentric, ecc_vector * jax.lax.rsqrt(jnp.where(eccentric, ecc_sq, 1.0)), node)

    raan = jnp.arctan2(node[1], node[0])
    argp = jnp.arctan2(dot(cross(w, node), apse), dot(node, apse))
    u = r * inv_r
    sin_nu, cos_nu = dot(cross(w, apse), u), dot(apse, u)
    ecc = jnp.arctan2(safe_sqrt((1.0 - e) * (1.0 + e)) * sin_nu, e + cos_nu)
    m = ecc - e * jnp.sin(ecc)
    return jnp.stack([a, e, inc, unsigned(raan), unsigned(argp), unsigned(m)])
