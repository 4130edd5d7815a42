"""Frames of the equinox: mean and true of date, sidereal time, and EME2000, the mean equator and equinox of J2000."""

import jax.numpy as jnp
import numpy as np

from astrojax import constants as c
from astrojax._types import FloatScalar, Matrix3, Scalar, Vector6, float_dtype
from astrojax.frames._turns import turn_z
from astrojax.frames.eop import EarthOrientation
from astrojax.frames.precession import _FUKUSHIMA_WILLIAMS, ALL_TERMS, equator_matrix, pole_angles
from astrojax.frames.terrestrial import orientation_in, rotation_tirs_to_itrf
from astrojax.time import centuries_tt, earth_rotation_angle


def _bias() -> np.ndarray:
    """Rotation from GCRF to EME2000: the precession of IAU 2006 at J2000.0 itself."""
    gamma, phi, psi, epsilon = _FUKUSHIMA_WILLIAMS[:, 0] * c.ARCSECOND

    def turn(axis, angle):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        m = np.eye(3)
        m[i, i] = m[j, j] = np.cos(angle)
        m[i, j], m[j, i] = np.sin(angle), -np.sin(angle)
        return m

    return turn(0, -epsilon) @ turn(2, -psi) @ turn(0, phi) @ turn(2, gamma)


GCRF_TO_EME2000 = _bias()
"""(3, 3) rotation from GCRF to EME2000, 0.02 arcsec (Wallace and Capitaine 2006, sec. 3; ERFA `bp06`)."""


def state_gcrf_to_eme2000(state: Vector6) -> Vector6:
    """State in EME2000, the mean equator and equinox of J2000, of one in GCRF.

    Args:
        state: (6,) position and velocity [m, m/s].

    Source: IERS Conventions (2010), TN 36, sec. 5.4.4; ERFA `bp06`.
    """
    bias = jnp.asarray(GCRF_TO_EME2000, state.dtype)
    return jnp.concatenate([bias @ state[:3], bias @ state[3:]])


def state_eme2000_to_gcrf(state: Vector6) -> Vector6:
    """State in GCRF of one in EME2000: the inverse of `state_gcrf_to_eme2000`.

    Args:
        state: (6,) position and velocity [m, m/s].
    """
    bias = jnp.asarray(GCRF_TO_EME2000.T, state.dtype)
    return jnp.concatenate([bias @ state[:3], bias @ state[3:]])


def rotation_gcrf_to_mod(day: Scalar, seconds: Scalar) -> Matrix3:
    """Rotation matrix from GCRF to the mean equator and equinox of date: bias and precession of IAU 2006.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.

    Validity: ERFA `pmat06` to 1e-15.

    Source: IERS Conventions (2010), TN 36, eq. 5.40 (Fukushima-Williams angles).
    """
    return equator_matrix(pole_angles(centuries_tt(day, seconds), 0), nutation=False)


def rotation_gcrf_to_tod(day: Scalar, seconds: Scalar, terms: int = ALL_TERMS) -> Matrix3:
    """Rotation matrix from GCRF to the true equator and equinox of date: bias, precession and nutation.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        terms: how many terms of the series, largest first; static.

    Validity: ERFA `pnm06a` to 2e-15.

    Source: IERS Conventions (2010), TN 36, sec. 5.4.5 and 5.5.4; Wallace and Capitaine 2006.
    """
    return equator_matrix(pole_angles(centuries_tt(day, seconds), terms))


def gast(
    day: Scalar, seconds: Scalar, orientation: EarthOrientation | None = None, terms: int = ALL_TERMS
) -> FloatScalar:
    """Greenwich apparent sidereal time of IAU 2006/2000A [rad, in [0, 2 pi)].

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        orientation: Earth orientation; of it only UT1 - UTC matters here.
        terms: how many terms of the series, largest first; static.

    Validity: ERFA `gst06a` to 1e-13 rad, which is the rounding of its rotation angle; float32 2e-6 rad.

    Source: Wallace and Capitaine 2006, A&A 459, 981, eq. 14 to 16.
    """
    dtype = float_dtype(day, seconds)
    angles = pole_angles(centuries_tt(day, seconds), terms)
    return _gast(day, jnp.asarray(seconds, dtype), orientation_in(orientation, dtype), angles, equator_matrix(angles))


def _gast(day, seconds, o: EarthOrientation, angles, m: Matrix3) -> FloatScalar:
    angle = earth_rotation_angle(day, seconds + o.ut1_minus_utc) - _equation_of_origins(angles, m)
    turns = angle / (2.0 * np.pi)
    return (2.0 * np.pi) * (turns - jnp.floor(turns))


def _equation_of_origins(angles, m: Matrix3) -> FloatScalar:
    """Distance of the celestial intermediate origin from the equinox along the equator [rad]."""
    x, y, z = m[2]
    a = x / (1.0 + z)
    origin = jnp.stack([1.0 - a * x, -a * y, -x])
    s = angles.locator - 0.5 * x * y
    return s - jnp.arctan2(m[1] @ origin, m[0] @ origin)


def rotation_gcrf_to_itrf_equinox(
    day: Scalar, seconds: Scalar, orientation: EarthOrientation | None = None, terms: int = ALL_TERMS
) -> Matrix3:
    """Rotation matrix from GCRF to ITRF by the equinox: the rotation of `rotation_gcrf_to_itrf` on the older path.

    The correction dX, dY of the pole, which belongs to the other path, is turned into one of the nutation's matrix.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        orientation: Earth orientation.
        terms: how many terms of the series, largest first; static.

    Validity: within 4e-15 of the other path; with dX, dY within 5e-12.

    Source: IERS Conventions (2010), TN 36, sec. 5.4.5.
    """
    dtype = float_dtype(day, seconds)
    o = orientation_in(orientation, dtype)
    t = centuries_tt(day, seconds)
    angles = pole_angles(t, terms)
    m = equator_matrix(angles)
    sidereal = _gast(day, jnp.asarray(seconds, dtype), o, angles, m)
    # A small turn that takes the pole from (X, Y) to (X + dX, Y + dY), in axes of date.
    shift = jnp.stack([o.dx, o.dy, -(m[2, 0] * o.dx + m[2, 1] * o.dy) / m[2, 2]])
    dx, dy = m[0] @ shift, m[1] @ shift
    m = jnp.stack([m[0] - dx * m[2], m[1] - dy * m[2], m[2] + dx * m[0] + dy * m[1]])
    return rotation_tirs_to_itrf(t, o.x, o.y) @ turn_z(sidereal, m)
