"""Height above the ellipsoid."""

from astrojax._types import FloatScalar, Vector3, dot, inverse_norm
from astrojax.constants import WGS84_A, WGS84_F


def geodetic_height(r: Vector3) -> FloatScalar:
    """Height [m] above the WGS84 ellipsoid, by its expansion to second order in the flattening.

    Args:
        r: (3,) position from Earth's centre [m], z along the figure axis.

    Validity: within 0.1 m from the ground to 2000 km; smooth at the poles, no iteration, no trigonometry.

    Source: the ellipsoid's radius at the geocentric latitude, r - a (1 - f s^2 - ...), and the foot point's
    offset from it, expanded in f; the tests hold it against brahe's iterative conversion.
    """
    inv_r = inverse_norm(r)
    s2 = (r[2] * inv_r) ** 2
    bend = 2.0 * WGS84_F * s2 * (1.0 - s2) * (WGS84_A * inv_r - 0.25)  # sin^2(2 phi) / 2 = 2 s2 (1 - s2)
    return dot(r, r) * inv_r - WGS84_A * (1.0 - WGS84_F * (s2 + bend))
