"""Earth gravity: the central term and the zonal harmonics."""

import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, inverse_norm
from astrojax.constants import GM_EARTH, R_EARTH, ZONALS

ZONAL_DEGREES = (0, 2, 3, 4, 5, 6)


def accel_two_body(r: Vector3, gm: Scalar = GM_EARTH) -> Vector3:
    """Point-mass gravitational acceleration [m/s^2], in the axes of `r`.

    Args:
        r: (3,) position from the attracting centre [m], not zero.
        gm: gravitational parameter [m^3/s^2].
    """
    inv_r = inverse_norm(r)
    return (-gm * inv_r * inv_r * inv_r) * r


def accel_zonal(r: Vector3, degree: int = 4) -> Vector3:
    """Acceleration [m/s^2] of Earth's zonal harmonics J2 to J`degree`, the two-body term left out.

    Args:
        r: (3,) position from Earth's centre [m], in axes whose z is Earth's figure axis (an inertial frame
            may stand in: zonal terms don't depend on longitude, and the pole of date is within 0.15 deg of
            the J2000 pole until 2026).
        degree: static; 0 (or 1) for none, else 2 to 6.

    Validity: outside the Earth.
    Raises: ValueError, `degree` is not an integer from 0 to 6.

    Source: gradient of U = -gm/r sum J_n (R/r)^n P_n(z/r) (Montenbruck and Gill, Satellite Orbits, sec. 3.2),
    with (n+1) P_n + u P'_n = P'_(n+1) and the recursion of the derivatives n P'_(n+1) = (2n+1) u P'_n -
    (n+1) P'_(n-1). Coefficients: see `constants`.
    """
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= 6:
        raise ValueError(f"degree: expected a static integer from 0 to 6, got {degree!r}")
    if degree < 2:
        return jnp.zeros_like(r)
    inv_r = inverse_norm(r)
    unit = r * inv_r
    u = unit[2]
    ratio = R_EARTH * inv_r
    scale = GM_EARTH * inv_r * inv_r * ratio
    radial, axial = 0.0, 0.0
    lower, current = 1.0, 3.0 * u  # P'_1 and P'_2
    for n in range(2, degree + 1):
        scale = scale * ratio
        upper = ((2 * n + 1) / n) * u * current - ((n + 1) / n) * lower
        weight = ZONALS[n - 2] * scale
        radial, axial = radial + weight * upper, axial + weight * current
        lower, current = current, upper
    return jnp.stack([radial * unit[0], radial * unit[1], radial * u - axial])
