"""Relative motion about an elliptic orbit: the Yamanaka-Ankersen transition matrix, in RTN axes.

Source: Yamanaka and Ankersen (2002), J. Guidance, Control, and Dynamics 25(1), 60, with z = -R, x = T, y = -N.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Scalar, Vector6
from astrojax.constants import GM_EARTH
from astrojax.orbits.anomalies import mean_to_true


def stm_yamanaka_ankersen(chief: Vector6, dt: Scalar, gm: Scalar = GM_EARTH) -> Float[Array, "6 6"]:
    """State-transition matrix of a deputy's relative position and velocity over `dt` seconds.

    Args:
        chief: (6,) [a, e, i, raan, argp, M] at the start, m and rad; 0 <= e < 1.
        dt: seconds, either sign.
        gm: gravitational parameter [m^3/s^2].

    Returns:
        (6, 6) for states in the chief's rotating RTN frame [m, m/s], as `frames.state_eci_to_rtn` gives them.

    Validity: two-body, separations small against the orbit radius. At e = 0 it is the Hill-Clohessy-Wiltshire matrix.
    """
    a, e, m = chief[0], chief[1], chief[5]
    dt = jnp.asarray(dt, chief.dtype)
    gm = jnp.asarray(gm, chief.dtype)
    n = jnp.sqrt(gm / a) / a
    shape = (1.0 - e) * (1.0 + e)
    k2 = n / (shape * jnp.sqrt(shape))  # the true anomaly turns by k2 rho^2
    start, end = mean_to_true(m, e), mean_to_true(m + n * dt, e)
    j = k2 * dt

    last = _solution(e, end, j)
    plane = last @ _inverse(e, start)
    c, s = jnp.cos(end - start), jnp.sin(end - start)
    zero = jnp.zeros_like(c)
    # Rows and columns (R, T, R', T') and (N, N') brought into the order R, T, N, R', T', N'.
    p = plane
    scaled = jnp.stack(
        [
            jnp.stack([p[0, 0], p[0, 1], zero, p[0, 2], p[0, 3], zero]),
            jnp.stack([p[1, 0], p[1, 1], zero, p[1, 2], p[1, 3], zero]),
            jnp.stack([zero, zero, c, zero, zero, s]),
            jnp.stack([p[2, 0], p[2, 1], zero, p[2, 2], p[2, 3], zero]),
            jnp.stack([p[3, 0], p[3, 1], zero, p[3, 2], p[3, 3], zero]),
            jnp.stack([zero, zero, -s, zero, zero, c]),
        ]
    )
    return _from_scaled(e, end, k2) @ scaled @ _to_scaled(e, start, k2)


def _solution(e, theta, j):
    """Four independent solutions, columns, of R, T and their derivatives by true anomaly, times rho."""
    rho = 1.0 + e * jnp.cos(theta)
    s, c = rho * jnp.sin(theta), rho * jnp.cos(theta)
    s1, c1 = jnp.cos(theta) + e * jnp.cos(2.0 * theta), -(jnp.sin(theta) + e * jnp.sin(2.0 * theta))
    zero, one = jnp.zeros_like(s), jnp.ones_like(s)
    rows = [
        [zero, -s, -c, 3.0 * e * s * j - 2.0],
        [one, -c * (1.0 + 1.0 / rho), s * (1.0 + 1.0 / rho), 3.0 * rho * rho * j],
        [zero, -s1, -c1, 3.0 * e * (s1 * j + s / (rho * rho))],
        [zero, 2.0 * s, 2.0 * c - e, 3.0 * (1.0 - 2.0 * e * s * j)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def _inverse(e, theta):
    """The inverse of `_solution` at the start, j = 0."""
    rho = 1.0 + e * jnp.cos(theta)
    s, c = rho * jnp.sin(theta), rho * jnp.cos(theta)
    shape = (1.0 - e) * (1.0 + e)
    by = 1.0 / rho
    zero = jnp.zeros_like(s)
    rows = [
        [-3.0 * e * s * (by + by * by), shape, e * c - 2.0, -e * s * (1.0 + by)],
        [3.0 * s * (by + e * e * by * by), zero, -(c - 2.0 * e), s * (1.0 + by)],
        [3.0 * (c * by + e), zero, s, c * (1.0 + by) + e],
        [-(3.0 * rho + e * e - 1.0), zero, -e * s, -rho * rho],
    ]
    return jnp.stack([jnp.stack(row) for row in rows]) / shape


def _to_scaled(e, theta, k2):
    """From [r, v] to rho r and its derivative by true anomaly."""
    rho = 1.0 + e * jnp.cos(theta)
    eye = jnp.eye(3, dtype=rho.dtype)
    top = jnp.concatenate([rho * eye, 0.0 * eye], axis=1)
    return jnp.concatenate([top, jnp.concatenate([-e * jnp.sin(theta) * eye, eye / (k2 * rho)], axis=1)])


def _from_scaled(e, theta, k2):
    rho = 1.0 + e * jnp.cos(theta)
    eye = jnp.eye(3, dtype=rho.dtype)
    top = jnp.concatenate([eye / rho, 0.0 * eye], axis=1)
    return jnp.concatenate([top, jnp.concatenate([k2 * e * jnp.sin(theta) * eye, k2 * rho * eye], axis=1)])
