"""Resonance of half-day and one-day orbits with the Earth's rotation: amplitudes, and the 720-minute integrator.

Both kinds are one sum of ten sines, sum of amplitude * sin(k perigee + l longitude - phase); the one-day kind uses
three of them. The integrator starts at epoch at every call, so a result does not depend on the calls before.
Source: Vallado et al., Revisiting Spacetrack Report #3, AIAA 2006-6753, appendix B; Hujsak (1979).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from astrojax.orbits.sgp4.lunisolar import Rates
from astrojax.orbits.sgp4.near_earth import Mean, Number
from astrojax.orbits.sgp4.trigonometry import sincos

EARTH_RATE = 4.37526908801129966e-3  # [rad/min], of the theory
STEP = 720.0  # [min]
MAX_STEPS = 100_000  # 137 years
_TURN = 6.283185307179586

_G22, _G32, _G44, _G52, _G54 = 5.7686396, 0.95240898, 1.8014998, 1.0508330, 4.4108898
_HALF_DAY = np.array(
    [  # times of the perigee, times of the longitude, phase
        [2, 1, _G22],
        [0, 1, _G22],
        [1, 1, _G32],
        [-1, 1, _G32],
        [2, 2, _G44],
        [0, 2, _G44],
        [1, 1, _G52],
        [-1, 1, _G52],
        [1, 2, _G54],
        [-1, 2, _G54],
    ]
)
_ONE_DAY = np.zeros((10, 3))
_ONE_DAY[:3] = [[0, 1, 0.13130908], [0, 2, 2 * 2.8843198], [0, 3, 3 * 0.37448087]]

# Coefficients of the eccentricity functions G, lowest power first, and where each holds.
_G_LOW = {  # e <= 0.65
    "211": (3.616, -13.2470, 16.2900, 0.0),
    "310": (-19.302, 117.3900, -228.4190, 156.5910),
    "322": (-18.9068, 109.7927, -214.6334, 146.5816),
    "410": (-41.122, 242.6940, -471.0940, 313.9530),
    "422": (-146.407, 841.8800, -1629.014, 1083.4350),
    "520": (-532.114, 3017.977, -5740.032, 3708.2760),
}
_G_HIGH = {
    "211": (-72.099, 331.819, -508.738, 266.724),
    "310": (-346.844, 1582.851, -2415.925, 1246.113),
    "322": (-342.585, 1554.908, -2366.899, 1215.972),
    "410": (-1052.797, 4758.686, -7193.992, 3651.957),
    "422": (-3581.690, 16178.110, -24462.770, 12422.520),
    "520": (1464.74, -4664.75, 3763.64, 0.0),
}
_G520_HIGHEST = (-5149.66, 29936.92, -54087.36, 31324.56)  # e > 0.715
_G5_LOW = {  # e < 0.7
    "533": (-919.22770, 4988.6100, -9064.7700, 5542.21),
    "521": (-822.71072, 4568.6173, -8491.4146, 5337.524),
    "532": (-853.66600, 4690.2500, -8624.7700, 5341.4),
}
_G5_HIGH = {
    "533": (-37995.780, 161616.52, -229838.20, 109377.94),
    "521": (-51752.104, 218913.95, -309468.16, 146349.42),
    "532": (-40023.880, 170470.89, -242699.48, 115605.82),
}


class Resonance(NamedTuple):
    """Which resonance a satellite is in (0 none, 1 one day, 2 half a day), and the terms of it."""

    kind: Int[Array, "..."]
    longitude0: Number
    drift: Number  # rate of the resonance longitude less the mean motion [rad/min]
    amplitude: Float[Array, "... 10"]


def _cubic(coefficients, e):
    c0, c1, c2, c3 = coefficients
    return c0 + e * (c1 + e * (c2 + e * c3))


def _half_day(mean: Mean, a_inverse: Number) -> tuple:
    e, s, c = mean.e, mean.sin_inc, mean.cos_inc
    c2, s2 = c * c, s * s
    g = {k: jnp.where(e <= 0.65, _cubic(_G_LOW[k], e), _cubic(_G_HIGH[k], e)) for k in _G_LOW}
    g |= {k: jnp.where(e < 0.7, _cubic(_G5_LOW[k], e), _cubic(_G5_HIGH[k], e)) for k in _G5_LOW}
    g["520"] = jnp.where(e > 0.715, _cubic(_G520_HIGHEST, e), g["520"])
    g["201"] = -0.306 - (e - 0.64) * 0.440
    f220 = 0.75 * (1.0 + 2.0 * c + c2)
    f221 = 1.5 * s2
    f321 = 1.875 * s * (1.0 - 2.0 * c - 3.0 * c2)
    f322 = -1.875 * s * (1.0 + 2.0 * c - 3.0 * c2)
    f441 = 35.0 * s2 * f220
    f442 = 39.3750 * s2 * s2
    f522 = 9.84375 * s * (s2 * (1.0 - 2.0 * c - 5.0 * c2) + 0.33333333 * (-2.0 + 4.0 * c + 6.0 * c2))
    f523 = s * (4.92187512 * s2 * (-2.0 - 4.0 * c + 10.0 * c2) + 6.56250012 * (1.0 + 2.0 * c - 3.0 * c2))
    f542 = 29.53125 * s * (2.0 - 8.0 * c + c2 * (-12.0 + 8.0 * c + 10.0 * c2))
    f543 = 29.53125 * s * (-2.0 - 8.0 * c + c2 * (12.0 + 8.0 * c - 10.0 * c2))
    t2 = 3.0 * mean.n * mean.n * a_inverse * a_inverse
    t3 = t2 * a_inverse
    t4 = t3 * a_inverse
    t5 = t4 * a_inverse
    return (
        t2 * 1.7891679e-6 * f220 * g["201"],
        t2 * 1.7891679e-6 * f221 * g["211"],
        t3 * 3.7393792e-7 * f321 * g["310"],
        t3 * 3.7393792e-7 * f322 * g["322"],
        2.0 * t4 * 7.3636953e-9 * f441 * g["410"],
        2.0 * t4 * 7.3636953e-9 * f442 * g["422"],
        t5 * 1.1428639e-7 * f522 * g["520"],
        t5 * 1.1428639e-7 * f523 * g["532"],
        2.0 * t5 * 2.1765803e-9 * f542 * g["521"],
        2.0 * t5 * 2.1765803e-9 * f543 * g["533"],
    )


def _one_day(mean: Mean, a_inverse: Number) -> tuple:
    e2, s, c = mean.e * mean.e, mean.sin_inc, mean.cos_inc
    g200 = 1.0 + e2 * (-2.5 + 0.8125 * e2)
    g310 = 1.0 + 2.0 * e2
    g300 = 1.0 + e2 * (-6.0 + 6.60937 * e2)
    up = 1.0 + c
    f220 = 0.75 * up * up
    f311 = 0.9375 * s * s * (1.0 + 3.0 * c) - 0.75 * up
    f330 = 1.875 * up * up * up
    base = 3.0 * mean.n * mean.n * a_inverse * a_inverse
    del1 = base * f311 * g310 * 2.1460748e-6 * a_inverse
    del2 = 2.0 * base * f220 * g200 * 1.7891679e-6
    del3 = 3.0 * base * f330 * g300 * 2.2123015e-7 * a_inverse
    return (del1, del2, del3, *(jnp.zeros_like(del1),) * 7)


def resonance_terms(mean: Mean, rates: Rates, sidereal: Number, deep: Array) -> Resonance:
    """The resonance of a deep-space satellite at epoch; `sidereal` is Greenwich sidereal time then."""
    n = mean.n
    one_day = deep & (n > 0.0034906585) & (n < 0.0052359877)
    half_day = deep & (n >= 8.26e-3) & (n <= 9.24e-3) & (mean.e >= 0.5)
    kind = jnp.where(one_day, 1, jnp.where(half_day, 2, 0)).astype(jnp.int32)
    a_inverse = 1.0 / mean.a
    pairs = zip(_one_day(mean, a_inverse), _half_day(mean, a_inverse))
    amplitude = jnp.stack([jnp.where(one_day, a, jnp.where(half_day, b, 0.0)) for a, b in pairs], axis=-1)
    theta = jax.lax.rem(sidereal, jnp.full_like(sidereal, _TURN))
    longitude = jnp.where(one_day, mean.m + mean.raan + mean.argp - theta, mean.m + 2.0 * mean.raan - 2.0 * theta)
    node = mean.raan_dot + rates.raan - EARTH_RATE
    perigee = mean.argp_dot + rates.argp
    drift = mean.m_dot + rates.m - n + jnp.where(one_day, node + perigee, 2.0 * node)
    return Resonance(kind, jax.lax.rem(longitude, jnp.full_like(longitude, _TURN)), drift, amplitude)


def _slopes(kind, amplitude, argp, longitude, n, drift):
    """Rate of the longitude, and first and second rate of the mean motion."""
    dtype = amplitude.dtype
    one_day, half_day = jnp.asarray(_ONE_DAY, dtype), jnp.asarray(_HALF_DAY, dtype)
    k_argp, k_long, phase = jnp.moveaxis(jnp.where(kind == 1, one_day, half_day), -1, 0)
    angle = k_argp * argp + k_long * longitude - phase
    rate = n + drift
    sine, cosine = sincos(angle)
    n_dot = jnp.sum(amplitude * sine)
    n_ddot = jnp.sum(amplitude * k_long * cosine) * rate
    return rate, n_dot, n_ddot


def _steps(kind, steps, sign, start):
    """Longitude and mean motion after `steps` whole steps. `start`: longitude, n, drift, perigee, its rate, terms."""
    longitude, n, drift, argp, argp_dot, amplitude = start

    def step(i, state):
        longitude, n = state
        h = sign * STEP
        here = argp + argp_dot * (h * i.astype(h.dtype))
        rate, n_dot, n_ddot = _slopes(kind, amplitude, here, longitude, n, drift)
        half = 0.5 * h * h
        return longitude + rate * h + n_dot * half, n + n_dot * h + n_ddot * half

    return jax.lax.fori_loop(0, steps, step, (longitude, n))


_march = jax.custom_jvp(_steps)


@_march.defjvp
def _march_jvp(primals, tangents):
    # A loop of unknown length has no reverse mode. Its Jacobian by forward mode, 2 by 15, has both.
    kind, steps, sign, start = primals
    flat, unravel = ravel_pytree(start)

    def flat_steps(flat):
        return jnp.stack(_steps(kind, steps, sign, unravel(flat)))

    jacobian = jax.jacfwd(flat_steps)(flat)
    moved = jacobian @ ravel_pytree(tangents[3])[0]
    return _march(*primals), (moved[0], moved[1])


def resonant_motion(terms: Resonance, mean: Mean, minutes: Number) -> tuple[Number, Number, Array]:
    """Resonance longitude and mean motion at `minutes` from epoch, and whether that is too far to integrate."""
    span = jnp.abs(minutes) / STEP
    far = (terms.kind > 0) & ~(span < MAX_STEPS)
    active = (terms.kind > 0) & ~far
    steps = jnp.floor(jnp.where(active, span, 0.0)).astype(jnp.int32)
    sign = jnp.where(minutes < 0, -1.0, 1.0).astype(minutes.dtype)
    start = (terms.longitude0, mean.n, terms.drift, mean.argp, mean.argp_dot, terms.amplitude)
    longitude, n = _march(terms.kind, steps, sign, start)
    done = sign * STEP * steps.astype(minutes.dtype)
    left = minutes - done
    rate, n_dot, n_ddot = _slopes(
        terms.kind, terms.amplitude, mean.argp + mean.argp_dot * done, longitude, n, terms.drift
    )
    half = 0.5 * left * left
    return longitude + rate * left + n_dot * half, n + n_dot * left + n_ddot * half, far
