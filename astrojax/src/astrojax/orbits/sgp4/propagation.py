"""Position and velocity from a prepared satellite: the time-dependent half of SGP4 and SDP4."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from astrojax._types import Scalar, Vector3
from astrojax.orbits.sgp4.gravity import Gravity, gravity_of
from astrojax.orbits.sgp4.lunisolar import add_periodic
from astrojax.orbits.sgp4.near_earth import Number, long_period
from astrojax.orbits.sgp4.resonance import EARTH_RATE, resonant_motion
from astrojax.orbits.sgp4.satellite import Sgp4Satellite
from astrojax.orbits.sgp4.trigonometry import sincos, turned, within_a_turn

_PI = 3.141592653589793
_KEPLER_STEPS, _KEPLER_STEPS_NEAR = 5, 3  # quartic; to rounding at e = 0.99 and 0.9
_LEAST_E = 1e-6
_LEAST_A = 1e-6  # a semi-major axis that drag has brought to nothing, far inside the Earth

STATUS = {
    0: "in orbit",
    1: "mean eccentricity outside [0, 1)",
    2: "mean motion not positive",
    3: "perturbed eccentricity outside [0, 1]",
    4: "semi-latus rectum negative",
    5: "epoch elements below the ground (never given: the report's code gives 6)",
    6: "decayed: the position is below the Earth's surface",
    7: "more than 100 000 steps of 12 h from epoch, for an orbit in resonance",
    8: "a deep-space satellite in a near-Earth program",
}
"""What the status of `sgp4` says. 1 to 6 are the report's."""


def sgp4(satellite: Sgp4Satellite, minutes: Scalar) -> tuple[Vector3, Vector3, Int[Array, ""]]:
    """Position, velocity and status of a satellite in the true-equator, mean-equinox frame (TEME) of date.

    Args:
        satellite: of `sgp4_init`.
        minutes: since the epoch of the elements, either sign.

    Returns:
        position: (3,) [m], TEME. Where status is neither 0 nor 6, zero.
        velocity: (3,) [m/s], TEME. Likewise.
        status: 0, or why there is no orbit: see `STATUS`. A decayed satellite (6) has numbers, which mean little.

    Validity: elements serve some days about their epoch, with a kilometre of error or more. Gradients are finite,
    by time and by elements; velocity is the theory's, which differs from the derivative of position by 1e-3 relative.

    Source: Vallado et al., Revisiting Spacetrack Report #3, AIAA 2006-6753, appendix B.
    """
    g = gravity_of(satellite.gravity)
    mean, drag, deep = satellite.mean, satellite.drag, satellite.deep
    t = jnp.asarray(minutes, mean.n.dtype)
    t2 = t * t
    faults = [(satellite.status != 0, satellite.status)]

    # Secular motion by J2, J4 and drag.
    m = mean.m + mean.m_dot * t
    argp = mean.argp + mean.argp_dot * t
    raan = mean.raan + mean.raan_dot * t + drag.raan2 * t2
    cube = 1.0 + drag.eta * sincos(m)[1]
    moved = drag.argp1 * t + drag.m_cube * (cube * cube * cube - drag.cube0)
    m, argp = m + moved, argp - moved
    shrunk = 1.0 - t * (drag.a1 + t * (drag.a2 + t * (drag.a3 + t * drag.a4)))
    e_lost = drag.e1 * t + drag.e_sin * (sincos(m)[0] - drag.sin_m0)
    l_gained = t2 * (drag.l2 + t * (drag.l3 + t * (drag.l4 + t * drag.l5)))

    n, a, e, inc = mean.n, mean.a, mean.e, mean.inc
    if deep is not None:
        n, a, e, inc, raan, argp, m, far = _deep_secular(satellite, g, t, raan, argp, m)
        faults += [(far, 7), (n <= 0.0, 2)]
    a = a * shrunk * shrunk
    a = jnp.where(a > _LEAST_A, a, _LEAST_A)
    e = e - e_lost
    outside = (e >= 1.0) | (e < -0.001)
    faults.append((outside, 1))
    e = jnp.where(outside, 0.5, jnp.where(e < _LEAST_E, _LEAST_E, e))
    m = m + mean.n * l_gained

    sin_i, cos_i = mean.sin_inc, mean.cos_inc
    if deep is not None:
        # The report keeps angles within a turn; near the equator its deep-space part depends on that.
        longitude = within_a_turn(m + argp + raan)
        raan, argp = within_a_turn(raan), within_a_turn(argp)
        m = within_a_turn(longitude - argp - raan)
        periodic = add_periodic(deep.sun, deep.moon, t, (e, inc, raan, argp, m), satellite.opsmode)
        e, inc, raan, argp, m = (jnp.where(deep.active, x, y) for x, y in zip(periodic, (e, inc, raan, argp, m)))
        below = inc < 0.0
        inc = jnp.abs(inc)
        raan, argp = jnp.where(below, raan + _PI, raan), jnp.where(below, argp - _PI, argp)
        outside = (e < 0.0) | (e > 1.0)
        faults.append((outside, 3))
        e = jnp.where(outside, 0.5, e)
        sin_i, cos_i = sincos(inc)

    # Long-period terms of J3.
    xlcof, aycof = long_period(sin_i, cos_i, g)
    open_ = e < 1.0
    by_p = 1.0 / (a * jnp.where(open_, 1.0 - e * e, 1.0))
    sin_w, cos_w = sincos(argp)
    ax = e * cos_w
    ay = e * sin_w + by_p * aycof
    u = m + argp + by_p * xlcof * ax
    e2 = ax * ax + ay * ay
    outside = (e2 >= 1.0) | ~open_
    faults.append((outside, 4))
    ax, ay = jnp.where(outside, 0.1, ax), jnp.where(outside, 0.0, ay)

    steps = _KEPLER_STEPS if deep is not None else _KEPLER_STEPS_NEAR
    r, v, radius = _short_period(g, a, ax, ay, _eccentric_longitude(u, ax, ay, steps), raan, sin_i, cos_i)
    faults.append((radius < 1.0, 6))
    status = jnp.zeros_like(satellite.status)
    for bad, code in reversed(faults):
        status = jnp.where(bad, code, status)
    valid = (status == 0) | (status == 6)
    return jnp.where(valid, r, 0.0), jnp.where(valid, v, 0.0), status


def _deep_secular(satellite: Sgp4Satellite, g: Gravity, t: Number, raan: Number, argp: Number, m: Number) -> tuple:
    """Secular motion by Sun and Moon, and the resonance in place of mean motion and anomaly."""
    mean, rates, terms = satellite.mean, satellite.deep.rates, satellite.deep.resonance
    e, inc = mean.e + rates.e * t, mean.inc + rates.inc * t
    raan, argp, m = raan + rates.raan * t, argp + rates.argp * t, m + rates.m * t
    longitude, n, far = resonant_motion(terms, mean, t)
    theta = within_a_turn(satellite.deep.sidereal + EARTH_RATE * t)
    one_day = longitude - raan - argp + theta
    half_day = longitude - 2.0 * raan + 2.0 * theta
    resonant = terms.kind > 0
    m = jnp.where(resonant, jnp.where(terms.kind == 1, one_day, half_day), m)
    n = jnp.where(resonant, n, mean.n)
    positive = n > 0.0
    a = jnp.where(resonant, jnp.cbrt(g.ke / jnp.where(positive, n, 1.0)) ** 2, mean.a)
    return n, a, e, inc, raan, argp, m, far


def _short_period(g: Gravity, a, ax, ay, longitude, raan, sin_i, cos_i) -> tuple[Vector3, Vector3, Number]:
    """Cartesian state [m, m/s] with the short-period terms of J2, and the radius [Earth radii]."""
    sin_e, cos_e = sincos(longitude)
    e_cos, e_sin = ax * cos_e + ay * sin_e, ax * sin_e - ay * cos_e
    shape = 1.0 - (ax * ax + ay * ay)
    p = a * shape
    beta = jnp.sqrt(shape)
    r = a * (1.0 - e_cos)
    r_dot = jnp.sqrt(a) * e_sin / r
    rf_dot = jnp.sqrt(p) / r
    part = e_sin / (1.0 + beta)
    sin_u = a / r * (sin_e - ay - ax * part)
    cos_u = a / r * (cos_e - ax + ay * part)
    sin_2u, cos_2u = 2.0 * sin_u * cos_u, 1.0 - 2.0 * sin_u * sin_u

    k1 = 0.5 * g.j2 / p
    k2 = k1 / p
    c2 = cos_i * cos_i
    con41, x1mth2, x7thm1 = 3.0 * c2 - 1.0, 1.0 - c2, 7.0 * c2 - 1.0
    n = g.ke / (a * jnp.sqrt(a))
    radius = r * (1.0 - 1.5 * k2 * beta * con41) + 0.5 * k1 * x1mth2 * cos_2u
    d_argument = -0.25 * k2 * x7thm1 * sin_2u
    d_incline = 1.5 * k2 * cos_i * sin_i * cos_2u
    node = raan + 1.5 * k2 * cos_i * sin_2u
    radial = r_dot - n * k1 * x1mth2 * sin_2u / g.ke
    across = rf_dot + n * k1 * (x1mth2 * cos_2u + 1.5 * con41) / g.ke

    sin_a, cos_a = turned(sin_u, cos_u, d_argument)
    sin_t, cos_t = turned(sin_i, cos_i, d_incline)
    sin_n, cos_n = sincos(node)
    x, y = -sin_n * cos_t, cos_n * cos_t
    out = jnp.stack([x * sin_a + cos_n * cos_a, y * sin_a + sin_n * cos_a, sin_t * sin_a])
    along = jnp.stack([x * cos_a - cos_n * sin_a, y * cos_a - sin_n * sin_a, sin_t * cos_a])
    speed = g.radius * g.ke / 60.0
    return g.radius * radius * out, speed * (radial * out + across * along), radius


@functools.partial(jax.custom_jvp, nondiff_argnums=(3,))
def _eccentric_longitude(u: Number, ax: Number, ay: Number, steps: int) -> Number:
    """The angle E + perigee with E - e sin E = M, for e cos(perigee) and e sin(perigee)."""
    sin_u, cos_u = sincos(u)
    s, c = ax * sin_u - ay * cos_u, ax * cos_u + ay * sin_u  # e sin M, e cos M
    f = u + s * jax.lax.rsqrt(1.0 - 2.0 * c + ax * ax + ay * ay)  # off by O(e^3)
    for _ in range(steps):
        sin_f, cos_f = sincos(f)
        es, ec = ax * sin_f - ay * cos_f, ax * cos_f + ay * sin_f
        miss, slope = f - es - u, 1.0 - ec
        d1 = -miss / slope
        d2 = -miss / (slope + 0.5 * d1 * es)
        f = f - miss / (slope + 0.5 * d2 * es + d2 * d2 * ec / 6.0)
    return f


@_eccentric_longitude.defjvp
def _eccentric_longitude_jvp(steps, primals, tangents):
    u, ax, ay = primals
    du, dx, dy = tangents
    f = _eccentric_longitude(u, ax, ay, steps)
    s, c = sincos(f)
    return f, (du + s * dx - c * dy) / (1.0 - ax * c - ay * s)
