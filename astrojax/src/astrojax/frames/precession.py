"""Precession and nutation of the equator, IAU 2006/2000A: angles, and the series they are summed from."""

import functools
import math
from importlib import resources
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax import constants as c
from astrojax._types import FloatScalar, Matrix3, Scalar, float_dtype
from astrojax.frames._turns import turn_x, turn_z

ALL_TERMS = 1322
"""Terms of the whole series: nutation IAU 2000A (1365) and the locator's, those of equal argument joined."""

_TURN = 2.0 * math.pi
# Delaunay's arguments l, l', F, D, Om [arcsec], powers of t. IERS Conventions (2010), eq. 5.43.
_DELAUNAY = np.array([
    [485868.249036, 1717915923.2178, 31.8792, 0.051635, -0.00024470],
    [1287104.793048, 129596581.0481, -0.5532, 0.000136, -0.00001149],
    [335779.526232, 1739527262.8478, -12.7512, -0.001037, 0.00000417],
    [1072260.703692, 1602961601.2090, -6.3706, 0.006593, -0.00003169],
    [450160.398036, -6962890.5431, 7.4722, 0.007702, -0.00005939],
])  # fmt: skip
# l, F, D, Om as the planetary part of IAU 2000A was fitted with, and the planets' longitudes Mercury to Neptune
# [rad, rad per century]. Mathews, Herring and Buffett 2002; IERS Conventions (2010), eq. 5.44.
_LINEAR = np.array([
    [2.35555598, 8328.6914269554], [1.627905234, 8433.466158131], [5.198466741, 7771.3771468121],
    [2.18243920, -33.757045],
    [4.402608842, 2608.7903141574], [3.176146697, 1021.3285546211], [1.753470314, 628.3075849991],
    [6.203480913, 334.0612426700], [0.599546497, 52.9690962641], [0.874016757, 21.3299104960],
    [5.481293872, 7.4781598567], [5.321159000, 3.8127774000],
])  # fmt: skip
# Fukushima-Williams angles and the mean obliquity [arcsec], powers of t. Hilton et al. 2006; IERS Conventions (2010),
# eq. 5.40, and the obliquity of P03 (Capitaine et al. 2003).
_FUKUSHIMA_WILLIAMS = np.array([
    [-0.052928, 10.556378, 0.4932044, -0.00031238, -0.000002788, 0.0000000260],
    [84381.412819, -46.811016, 0.0511268, 0.00053289, -0.000000440, -0.0000000176],
    [-0.041775, 5038.481484, 1.5584175, -0.00018522, -0.000026452, -0.0000000148],
    [84381.406, -46.836769, -0.0001831, 0.00200340, -0.000000576, -0.0000000434],
])  # fmt: skip
# s + XY/2 [microarcsec], powers of t. IERS Conventions (2010), table 5.2d.
_LOCATOR = (94.0e-6, 3808.65e-6, -122.68e-6, -72574.11e-6, 27.98e-6, 15.62e-6)


class Angles(NamedTuple):
    """Where the equator of date is in GCRF [rad].

    Attributes:
        gamma, phi, psi, epsilon: Fukushima-Williams angles of precession and bias.
        dpsi, depsilon: nutation in longitude and obliquity.
        locator: s + XY/2 of the celestial intermediate origin.
    """

    gamma: FloatScalar
    phi: FloatScalar
    psi: FloatScalar
    epsilon: FloatScalar
    dpsi: FloatScalar
    depsilon: FloatScalar
    locator: FloatScalar


@functools.cache
def _series() -> dict[str, np.ndarray]:
    with resources.files("astrojax.frames").joinpath("data/iau2006.npz").open("rb") as file:
        return {name: array.astype(np.float64) for name, array in np.load(file).items()}


def pole_angles(t: Scalar, terms: int = ALL_TERMS) -> Angles:
    """Precession, nutation and the origin's locator at an instant.

    Args:
        t: Julian centuries of TT since J2000.0.
        terms: how many of the series' terms to sum, largest first; static. `ALL_TERMS` is the model itself.

    Validity: ERFA `nut06a`, `pfw06` and `s06` to 1e-15 rad over 1962 to 2050; shorter series as `PoleSeries` says.

    Raises:
        ValueError: `terms` is not from 0 to `ALL_TERMS`.

    Source: IERS Conventions (2010), TN 36, ch. 5: eqs. 5.40 to 5.44, tables 5.2d, 5.3a and 5.3b; the adjustment of
    IAU 2000A to the precession of IAU 2006 after Wallace and Capitaine 2006, eq. 5.
    """
    if not 0 <= terms <= ALL_TERMS:
        raise ValueError(f"terms: expected 0 to {ALL_TERMS}, got {terms}")
    dtype = float_dtype(t)
    t = jnp.asarray(t, dtype)
    psi, psi_t, eps, eps_t, locator = _sums(t, terms)
    unit = 1e-7 * c.ARCSECOND
    dpsi, deps = (psi + psi_t * t) * unit, (eps + eps_t * t) * unit
    shrink = -2.7774e-6 * t
    dpsi, deps = dpsi + dpsi * (0.4697e-6 + shrink), deps + deps * shrink
    angles = [_polynomial(row, t) * c.ARCSECOND for row in _FUKUSHIMA_WILLIAMS]
    return Angles(*angles, dpsi, deps, _polynomial(_LOCATOR, t) * c.ARCSECOND + locator * unit)


def _polynomial(coefficients, t):
    return functools.reduce(lambda total, k: total * t + k, [float(k) for k in reversed(coefficients)])


def _arguments(t: FloatScalar) -> Float[Array, "18"]:
    """The 18 fundamental arguments [turns]: Delaunay's five, the planetary theory's four, the planets, p_A."""
    delaunay = jnp.stack([_polynomial(row, t) for row in _DELAUNAY / 1296000.0])
    linear = jnp.stack([_polynomial(row, t) for row in _LINEAR / _TURN])
    turns = jnp.concatenate([delaunay, linear])
    precession = (0.024381750 + 0.00000538691 * t) * (t / _TURN)
    return jnp.concatenate([turns - jnp.round(turns), precession[None]])


def _sums(t: FloatScalar, terms: int) -> tuple[FloatScalar, ...]:
    """Sums of the series: psi, psi t, eps, eps t, and the locator, in units of the table."""
    if terms == 0:
        return (jnp.zeros_like(t),) * 5
    series = {name: jnp.asarray(array[:terms], t.dtype) for name, array in _series().items()}

    def product(a, b):
        return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)

    sine, cosine = _sine_and_cosine(product(series["multipliers"], _arguments(t)))
    sines, cosines = product(sine, series["sine"]), product(cosine, series["cosine"])
    psi, psi_t, eps = sines[0] + cosines[0], sines[1], sines[2] + cosines[1]
    locator = functools.reduce(lambda total, k: total * t + k, [sines[i] + cosines[i] for i in range(7, 2, -1)])
    return psi, psi_t, eps, cosines[2], locator


def _sine_and_cosine(turns: Float[Array, "N"]) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Sine and cosine of angles in turns, to 5e-15: polynomials, which vectorise where a library's call does not."""
    half = math.pi * (turns - jnp.round(turns))  # half the angle, within a right angle of zero
    square = half * half
    sine = half * _polynomial([(-1.0) ** k / math.factorial(2 * k + 1) for k in range(10)], square)
    cosine = _polynomial([(-1.0) ** k / math.factorial(2 * k) for k in range(11)], square)
    return 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine


def equator_matrix(angles: Angles, nutation: bool = True) -> Matrix3:
    """Rotation matrix from GCRF to the equator and equinox of date: true, or mean without nutation.

    Args:
        angles: from `pole_angles`.
        nutation: whether nutation is in it; static.

    Source: Wallace and Capitaine 2006, A&A 459, 981, eq. 4.
    """
    psi, epsilon = angles.psi, angles.epsilon
    if nutation:
        psi, epsilon = psi + angles.dpsi, epsilon + angles.depsilon
    m = turn_z(angles.gamma, jnp.eye(3, dtype=angles.psi.dtype))
    return turn_x(-epsilon, turn_z(-psi, turn_x(angles.phi, m)))
