"""Harris-Priester density: a static profile with the diurnal bulge behind the Sun."""

import math

import jax.numpy as jnp
import numpy as np

from astrojax._types import FloatScalar, Scalar, Vector3, dot, inverse_norm
from astrojax.frames import geodetic_height

# Height [km], antapex (minimum) and apex (maximum) density [g/km^3], mean solar activity.
_TABLE = np.array(
    [
        (100, 497400.0, 497400.0),
        (120, 24900.0, 24900.0),
        (130, 8377.0, 8710.0),
        (140, 3899.0, 4059.0),
        (150, 2122.0, 2215.0),
        (160, 1263.0, 1344.0),
        (170, 800.8, 875.8),
        (180, 528.3, 601.0),
        (190, 361.7, 429.7),
        (200, 255.7, 316.2),
        (210, 183.9, 239.6),
        (220, 134.1, 185.3),
        (230, 99.49, 145.5),
        (240, 74.88, 115.7),
        (250, 57.09, 93.08),
        (260, 44.03, 75.55),
        (270, 34.30, 61.82),
        (280, 26.97, 50.95),
        (290, 21.39, 42.26),
        (300, 17.08, 35.26),
        (320, 10.99, 25.11),
        (340, 7.214, 18.19),
        (360, 4.824, 13.37),
        (380, 3.274, 9.955),
        (400, 2.249, 7.492),
        (420, 1.558, 5.684),
        (440, 1.091, 4.355),
        (460, 0.7701, 3.362),
        (480, 0.5474, 2.612),
        (500, 0.3916, 2.042),
        (520, 0.2819, 1.605),
        (540, 0.2042, 1.267),
        (560, 0.1488, 1.005),
        (580, 0.1092, 0.7997),
        (600, 0.08070, 0.6390),
        (620, 0.06012, 0.5123),
        (640, 0.04519, 0.4121),
        (660, 0.03430, 0.3325),
        (680, 0.02632, 0.2691),
        (700, 0.02043, 0.2185),
        (720, 0.01607, 0.1779),
        (740, 0.01281, 0.1452),
        (760, 0.01036, 0.1190),
        (780, 0.008496, 0.09776),
        (800, 0.007069, 0.08059),
        (840, 0.004680, 0.05741),
        (880, 0.003200, 0.04210),
        (920, 0.002210, 0.03130),
        (960, 0.001560, 0.02360),
        (1000, 0.001150, 0.01810),
    ]
)
_FLOOR, _CEILING, _LAYER = 100e3, 1000e3, 10e3
# Every height is a multiple of 10 km and density is exponential within a layer, so an even 10 km grid holds
# the same function and finds its layer by one division: columns ln(min), its slope, ln(max), its slope.
_GRID = np.arange(100, 1001, 10)
_LOG_MIN = np.interp(_GRID, _TABLE[:, 0], np.log(_TABLE[:, 1] * 1e-12))
_LOG_MAX = np.interp(_GRID, _TABLE[:, 0], np.log(_TABLE[:, 2] * 1e-12))
_LAYERS = np.stack([_LOG_MIN[:-1], np.diff(_LOG_MIN), _LOG_MAX[:-1], np.diff(_LOG_MAX)], axis=1)

_LAG_COS, _LAG_SIN = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))


def density_harris_priester(r: Vector3, r_sun: Vector3, exponent: Scalar = 6) -> FloatScalar:
    """Atmospheric density [kg/m^3] for mean solar activity.

    Args:
        r: (3,) position of the vehicle [m], Earth-centred, z along the figure axis.
        r_sun: (3,) position of the Sun [m], same axes.
        exponent: of the cosine of half the angle from the bulge, from 2 (low inclination) to 6 (polar orbit).
            An even Python integer costs products only; anything else, a traced array too, costs a power.

    Validity: tabulated from 100 km to 1000 km; exactly zero above; below 100 km the lowest layer's
    exponential goes on to sea level and stays there (1.7 kg/m^3, against 1.2 in truth), so that a descending
    vehicle always brakes. Gradients are finite everywhere.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.5.2 and its table of coefficients.
    """
    height = geodetic_height(r)
    layer_float = (height - _FLOOR) / _LAYER
    index = jnp.clip(jnp.floor(layer_float), 0, len(_LAYERS) - 1).astype(jnp.int32)
    inside = layer_float < (_CEILING - _FLOOR) / _LAYER
    # Held at sea level below and at the ceiling above, before the exponential sees it.
    fraction = jnp.clip(layer_float, -_FLOOR / _LAYER, (_CEILING - _FLOOR) / _LAYER) - index.astype(r.dtype)
    row = jnp.asarray(_LAYERS, dtype=r.dtype)[index]
    low = jnp.exp(row[0] + row[1] * fraction)
    high = jnp.exp(row[2] + row[3] * fraction)
    # The bulge's apex is the subsolar direction turned 30 degrees (two hours) east about the pole.
    apex = jnp.stack([_LAG_COS * r_sun[0] - _LAG_SIN * r_sun[1], _LAG_SIN * r_sun[0] + _LAG_COS * r_sun[1], r_sun[2]])
    cosine = dot(r * inverse_norm(r), apex * inverse_norm(r_sun))
    half = 0.5 + 0.5 * cosine  # cos^2(psi / 2)
    if isinstance(exponent, int) and exponent % 2 == 0:
        bulge = half ** (exponent // 2)
    else:
        bulge = jnp.maximum(half, jnp.finfo(r.dtype).eps) ** (0.5 * exponent)
    return jnp.where(inside, low + (high - low) * bulge, 0.0)
