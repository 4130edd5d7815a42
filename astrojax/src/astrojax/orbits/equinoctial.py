"""Elements without singularities, and elements of any conic.

Modified equinoctial elements are [p, f, g, h, k, L]: semi-latus rectum, e cos and sin of the longitude of perigee,
tan(i/2) cos and sin of the node, true longitude. Source: Walker, Ireland, Owens (1985), Celestial Mechanics 36, 409.
"""

import jax
import jax.numpy as jnp

from astrojax._types import Scalar, Vector6, cross, dot, inverse_norm, safe_sqrt
from astrojax.constants import GM_EARTH
from astrojax.orbits._angles import positive, unsigned
from astrojax.orbits.anomalies import mean_to_true, true_to_mean


def cartesian_to_equinoctial(state: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Modified equinoctial elements [m, -, -, -, -, rad] of an inertial state; any conic.

    Args:
        state: (6,) position and velocity [m, m/s], not rectilinear.
        gm: gravitational parameter [m^3/s^2].

    Validity: every inclination but 180 deg, where h and k are infinite.
    """
    r, v = state[:3], state[3:]
    inv_r = inverse_norm(r)
    w_h = cross(r, v)
    h2 = dot(w_h, w_h)
    w = w_h * jax.lax.rsqrt(h2)
    up = 1.0 + w[2]
    h, k = -w[1] / up, w[0] / up
    f_axis, g_axis = _axes(h, k)
    ecc = cross(v, w_h) / gm - r * inv_r
    u = r * inv_r
    longitude = jnp.arctan2(dot(g_axis, u), dot(f_axis, u))
    return jnp.stack([h2 / gm, dot(ecc, f_axis), dot(ecc, g_axis), h, k, unsigned(longitude)])


def equinoctial_to_cartesian(elements: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Inertial position and velocity [m, m/s] of modified equinoctial elements (6,) [p, f, g, h, k, L]; any conic."""
    p, f, g, h, k, longitude = elements
    f_axis, g_axis = _axes(h, k)
    c, s = jnp.cos(longitude), jnp.sin(longitude)
    r = p / (1.0 + f * c + g * s)
    speed = jnp.sqrt(gm / p)
    position = r * (c * f_axis + s * g_axis)
    velocity = speed * (-(g + s) * f_axis + (f + c) * g_axis)
    return jnp.concatenate([position, velocity])


def keplerian_to_equinoctial(elements: Vector6) -> Vector6:
    """Modified equinoctial elements of an ellipse's [a, e, i, raan, argp, M] (6,), m and rad; e <= 0.9999."""
    a, e, inc, raan, argp, m = elements
    perigee = raan + argp
    half = jnp.tan(0.5 * inc)
    longitude = perigee + mean_to_true(m, e)
    return jnp.stack(
        [
            a * (1.0 - e) * (1.0 + e),
            e * jnp.cos(perigee),
            e * jnp.sin(perigee),
            half * jnp.cos(raan),
            half * jnp.sin(raan),
            positive(longitude),
        ]
    )


def equinoctial_to_keplerian(elements: Vector6) -> Vector6:
    """[a, e, i, raan, argp, M], m and rad, angles in [0, 2 pi), of modified equinoctial elements (6,) of an ellipse.

    Validity: as `cartesian_to_keplerian`: the node of an equatorial orbit is taken along +x, the perigee of a
    circular one at the node.
    """
    p, f, g, h, k, longitude = elements
    tiny = (8.0 * jnp.finfo(elements.dtype).eps) ** 2
    e2, t2 = f * f + g * g, h * h + k * k
    eccentric, inclined = e2 > tiny, t2 > tiny
    e = safe_sqrt(jnp.where(eccentric, e2, 0.0))
    inc = 2.0 * jnp.arctan(safe_sqrt(jnp.where(inclined, t2, 0.0)))
    raan = jnp.arctan2(jnp.where(inclined, k, 0.0), jnp.where(inclined, h, 1.0))
    perigee = jnp.where(eccentric, jnp.arctan2(jnp.where(eccentric, g, 0.0), jnp.where(eccentric, f, 1.0)), raan)
    m = true_to_mean(longitude - perigee, e)
    angles = (positive(angle) for angle in (raan, perigee - raan, m))
    return jnp.stack([p / ((1.0 - e) * (1.0 + e)), e, inc, *angles])


def cartesian_to_conic(state: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Osculating [p, e, i, raan, argp, nu] of an inertial state: ellipse, parabola or hyperbola.

    Args:
        state: (6,) position and velocity [m, m/s], not rectilinear.
        gm: gravitational parameter [m^3/s^2].

    Returns:
        (6,) semi-latus rectum [m], eccentricity, inclination, node, argument of perigee, true anomaly [rad, [0, 2 pi)].

    Validity: every eccentricity. The semi-major axis, p/(1 - e^2), is negative on a hyperbola and has no value on a
    parabola, hence p. Node and perigee of equatorial and circular orbits as in `cartesian_to_keplerian`; inclination
    below 180 deg.
    """
    p, f, g, h, k, longitude = cartesian_to_equinoctial(state, gm)
    tiny = (8.0 * jnp.finfo(state.dtype).eps) ** 2
    e2, t2 = f * f + g * g, h * h + k * k
    eccentric, inclined = e2 > tiny, t2 > tiny
    e = safe_sqrt(jnp.where(eccentric, e2, 0.0))
    inc = 2.0 * jnp.arctan(safe_sqrt(jnp.where(inclined, t2, 0.0)))
    raan = jnp.arctan2(jnp.where(inclined, k, 0.0), jnp.where(inclined, h, 1.0))
    perigee = jnp.where(eccentric, jnp.arctan2(jnp.where(eccentric, g, 0.0), jnp.where(eccentric, f, 1.0)), raan)
    angles = (positive(angle) for angle in (raan, perigee - raan, longitude - perigee))
    return jnp.stack([p, e, inc, *angles])


def conic_to_cartesian(elements: Vector6, gm: Scalar = GM_EARTH) -> Vector6:
    """Inertial position and velocity [m, m/s] of [p, e, i, raan, argp, nu] (6,), m and rad; any eccentricity."""
    p, e, inc, raan, argp, nu = elements
    perigee = raan + argp
    half = jnp.tan(0.5 * inc)
    parts = e * jnp.cos(perigee), e * jnp.sin(perigee), half * jnp.cos(raan), half * jnp.sin(raan)
    return equinoctial_to_cartesian(jnp.stack([p, *parts, perigee + nu]), gm)


def _axes(h, k):
    """The equinoctial frame's first two axes."""
    s = 1.0 + h * h + k * k
    f_axis = jnp.stack([1.0 - k * k + h * h, 2.0 * h * k, -2.0 * k]) / s
    g_axis = jnp.stack([2.0 * h * k, 1.0 + k * k - h * h, 2.0 * h]) / s
    return f_axis, g_axis
