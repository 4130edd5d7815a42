"""Exponential atmospheres: one scale height, or one for each layer of a table."""

import jax.numpy as jnp
import numpy as np

from astrojax._types import FloatScalar, Scalar, Vector3
from astrojax.frames import geodetic_height

# Base height [km], density there [kg/m^3], scale height [km].
_TABLE = np.array(
    [
        (0, 1.225, 7.249),
        (25, 3.899e-2, 6.349),
        (30, 1.774e-2, 6.682),
        (40, 3.972e-3, 7.554),
        (50, 1.057e-3, 8.382),
        (60, 3.206e-4, 7.714),
        (70, 8.770e-5, 6.549),
        (80, 1.905e-5, 5.799),
        (90, 3.396e-6, 5.382),
        (100, 5.297e-7, 5.877),
        (110, 9.661e-8, 7.263),
        (120, 2.438e-8, 9.473),
        (130, 8.484e-9, 12.636),
        (140, 3.845e-9, 16.149),
        (150, 2.070e-9, 22.523),
        (180, 5.464e-10, 29.740),
        (200, 2.789e-10, 37.105),
        (250, 7.248e-11, 45.546),
        (300, 2.418e-11, 53.628),
        (350, 9.518e-12, 53.298),
        (400, 3.725e-12, 58.515),
        (450, 1.585e-12, 60.828),
        (500, 6.967e-13, 63.822),
        (600, 1.454e-13, 71.835),
        (700, 3.614e-14, 88.667),
        (800, 1.170e-14, 124.64),
        (900, 5.245e-15, 181.05),
        (1000, 3.019e-15, 268.00),
    ]
)
_LOG_DENSITY = np.log(_TABLE[:, 1])


def density_exponential(r: Vector3, density: Scalar, height: Scalar, scale_height: Scalar) -> FloatScalar:
    """Atmospheric density that falls by e over each scale height [kg/m^3].

    Args:
        r: (3,) position [m], Earth-centred, z along the figure axis.
        density: at the reference height [kg/m^3].
        height: the reference, above the ellipsoid [m].
        scale_height: [m], positive.

    Validity: any height; held where the exponent passes 80, so that nothing overflows.
    """
    exponent = (height - geodetic_height(r)) / scale_height
    return density * jnp.exp(jnp.clip(exponent, -80.0, 80.0))


def density_layered(r: Vector3) -> FloatScalar:
    """Atmospheric density of 28 exponential layers [kg/m^3], of mean activity at all hours.

    Args:
        r: (3,) position [m], Earth-centred, z along the figure axis.

    Validity: 0 to 1000 km, with steps of up to 2 % between layers; held at the ground, and above 1000 km the last layer
        goes on. Gradients are those inside the layers.

    Source: Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., table 8-4.
    """
    km = jnp.maximum(geodetic_height(r), 0.0) * 1e-3
    bases, scales = jnp.asarray(_TABLE[:, 0], km.dtype), jnp.asarray(_TABLE[:, 2], km.dtype)
    row = jnp.clip(jnp.sum(km >= bases, dtype=jnp.int32) - 1, 0, len(_TABLE) - 1)
    exponent = (bases[row] - km) / scales[row]
    return jnp.exp(jnp.asarray(_LOG_DENSITY, km.dtype)[row] + exponent)
