"""Two-body motion in universal variables: ellipse, parabola and hyperbola by one formula.

Source: Battin, An Introduction to the Mathematics and Methods of Astrodynamics, revised ed., secs. 4.5 and 4.6;
Conway (1986), Celestial Mechanics 39, 199 (Laguerre's iteration for Kepler's equation).
"""

import jax
import jax.numpy as jnp

from astrojax._types import Scalar, Vector6, dot, inverse_norm
from astrojax.constants import GM_EARTH
from astrojax.orbits._angles import TURN

_STEPS = 14
_LONGEST = 80.0  # of sqrt(-alpha) x: beyond, float32 overflows


def _functions(x, alpha):
    """Universal functions U0 to U3 of x, for the inverse semi-major axis alpha."""
    z = jnp.maximum(alpha * x * x, -(_LONGEST**2))
    small = jnp.abs(z) < 0.5
    y = jnp.where(small, z, 0.0)

    def series(first):
        total = 1.0
        for k in range(7, 0, -1):
            total = 1.0 - y / ((first + 2 * k - 1) * (first + 2 * k)) * total
        return total

    up = jnp.where(small | (z < 0.0), 1.0, z)
    down = jnp.where(small | (z > 0.0), 1.0, -z)
    a, b = jnp.sqrt(up), jnp.sqrt(down)
    sin_a, sinh_b = jnp.sin(a), jnp.sinh(b)
    half_a, half_b = jnp.sin(0.5 * a) / a, jnp.sinh(0.5 * b) / b
    positive = z > 0.0
    c1 = jnp.where(small, series(1), jnp.where(positive, sin_a / a, sinh_b / b))
    c2 = jnp.where(small, 0.5 * series(2), 2.0 * jnp.where(positive, half_a * half_a, half_b * half_b))
    c3 = jnp.where(small, series(3) / 6.0, jnp.where(positive, (a - sin_a) / (a * up), (sinh_b - b) / (b * down)))
    return 1.0 - z * c2, x * c1, x * x * c2, x * x * x * c3


def _start(sigma, alpha, tau):
    """First guess of x for a positive tau, and a number it does not exceed."""
    # Parabola: x + sigma x^2 / 2 + x^3 / 6 = tau, a cubic in x + sigma with one real root.
    p = jnp.maximum(2.0 - sigma * sigma, 1e-6)
    q = 3.0 * tau + 3.0 * sigma - sigma * sigma * sigma
    w = jnp.cbrt(jnp.abs(q) + jnp.sqrt(q * q + p * p * p))
    parabola = jnp.sign(q) * (w - p / w) - sigma
    parabola = jnp.where(parabola > 0.0, parabola, tau)
    # Hyperbola, late. The scale (1 - alpha) / b + sigma cancels on the way in; with the other sign it makes (e / b)^2.
    open_ = alpha < 0.0
    b = jnp.sqrt(jnp.where(open_, -alpha, 1.0))
    h2 = jnp.maximum(2.0 - alpha - sigma * sigma, 0.0)
    sum_ = (1.0 - alpha) / b + jnp.abs(sigma)
    scale = jnp.where(sigma < 0.0, (1.0 + b * b * h2) / (b * b * jnp.where(open_, sum_, 1.0)), sum_)
    asymptote = jnp.log(2.0 + 2.0 * tau * b * b / jnp.where(open_, scale, 1.0)) / b

    closed = alpha > 1e-3
    root = jnp.sqrt(jnp.where(closed, alpha, 1.0))
    guess = jnp.where(closed, alpha * tau, jnp.where(open_, jnp.minimum(parabola, asymptote), parabola))
    # dx = dt / r, and r is not below the perigee; half a revolution of M is less than pi + 2 of E.
    e = jnp.sqrt(jnp.maximum(1.0 - alpha * h2, 0.0))
    most = 1.01 * tau * (1.0 + e) / jnp.maximum(h2, 1e-12)
    most = jnp.minimum(most, jnp.where(closed, 5.2 / root, jnp.where(open_, _LONGEST / b, most)))
    return jnp.minimum(guess, most), most


@jax.custom_jvp
def _solve(sigma, alpha, tau):
    """x with tau = U1 + sigma U2 + U3, where the starting radius and gm are one."""
    way = jnp.where(tau < 0.0, -1.0, 1.0).astype(tau.dtype)
    sigma, tau = way * sigma, way * tau
    x, high = _start(sigma, alpha, tau)

    def step(_, state):  # Laguerre's, which hardly ever leaves the bracket
        x, low, high = state
        u0, u1, u2, u3 = _functions(x, alpha)
        miss = u1 + sigma * u2 + u3 - tau
        r = u0 + sigma * u1 + u2
        bend = sigma * u0 + (1.0 - alpha) * u1
        low, high = jnp.where(miss < 0.0, x, low), jnp.where(miss > 0.0, x, high)
        nearer = x - 5.0 * miss / (r + jnp.sqrt(jnp.abs(16.0 * r * r - 20.0 * miss * bend)))
        inside = (nearer >= low) & (nearer <= high) | (jnp.abs(nearer - x) < 1e-3 * x)  # about the root, by rounding
        return jnp.where(inside, nearer, 0.5 * (low + high)), low, high

    x, _, _ = jax.lax.fori_loop(0, _STEPS, step, (x, jnp.zeros_like(x), high))
    return way * x


@_solve.defjvp
def _solve_jvp(primals, tangents):
    sigma, alpha, tau = primals
    d_sigma, d_alpha, d_tau = tangents
    x = _solve(sigma, alpha, tau)
    _, by_alpha = jax.jvp(lambda a: _time(x, sigma, a), (alpha,), (d_alpha,))
    u0, u1, u2, _ = _functions(x, alpha)
    return x, (d_tau - u2 * d_sigma - by_alpha) / (u0 + sigma * u1 + u2)


def _time(x, sigma, alpha):
    _, u1, u2, u3 = _functions(x, alpha)
    return u1 + sigma * u2 + u3


def propagate_universal(state: Vector6, dt: Scalar, gm: Scalar = GM_EARTH) -> Vector6:
    """Position and velocity after `dt` seconds of two-body motion, on any conic.

    Args:
        state: (6,) inertial position and velocity [m, m/s].
        dt: seconds, either sign; whole revolutions of an ellipse are taken out first.
        gm: gravitational parameter [m^3/s^2].

    Validity: every eccentricity, not rectilinear. Fourteen fixed steps reach rounding level on orbits with e from 0 to
    10 (tested to 0.9999 below one); a passage closer than 1e-4 of the starting radius loses digits in proportion.
    """
    gm = jnp.asarray(gm, state.dtype)
    r0, v0 = state[:3], state[3:]
    inv_r = inverse_norm(r0)
    radius = 1.0 / inv_r
    speed = jnp.sqrt(gm * inv_r)
    r, v = r0 * inv_r, v0 / speed  # radius and gm are one from here
    sigma, alpha = dot(r, v), 2.0 - dot(v, v)
    tau = jnp.asarray(dt, state.dtype) * (speed * inv_r)

    closed = alpha > 1e-6
    a = jnp.where(closed, alpha, 1.0)
    period = TURN / (a * jnp.sqrt(a))
    turns = jax.lax.stop_gradient(jnp.round(tau / period))
    tau = tau - jnp.where(closed, turns * period, 0.0)

    x = _solve(sigma, alpha, tau)
    u0, u1, u2, _ = _functions(x, alpha)
    now = u0 + sigma * u1 + u2
    f, g = 1.0 - u2, u1 + sigma * u2
    f_dot, g_dot = -u1 / now, 1.0 - u2 / now
    return jnp.concatenate([radius * (f * r + g * v), speed * (f_dot * r + g_dot * v)])
