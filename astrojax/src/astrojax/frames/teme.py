"""TEME, the true equator and mean equinox of date that SGP4's states are in.

It is defined by the sidereal time of 1982: turned by that angle about the pole, it becomes the Earth-fixed frame.
"""

import jax.numpy as jnp

from astrojax._types import Matrix3, Scalar, Vector6, float_dtype
from astrojax.frames._turns import into_turning, out_of_turning, turn_x, turn_y, turn_z, with_rate
from astrojax.frames.eop import EarthOrientation
from astrojax.frames.pole import PoleModel, PoleSeries
from astrojax.frames.terrestrial import orientation_in, rotation_gcrf_to_cirs
from astrojax.time import gmst82, gmst82_minus_era

_SERIES = PoleSeries()


def rotation_teme_to_itrf(day: Scalar, seconds: Scalar, orientation: EarthOrientation | None = None) -> Matrix3:
    """Rotation matrix from TEME to ITRF at a UTC epoch.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        orientation: Earth orientation; dX and dY do not matter here.

    Validity: astropy's TEME to ITRS to 1e-12 rad; float32 2e-6 rad. The terrestrial locator s' is left out, as it was
    when the frame was defined.

    Source: Vallado et al. 2006, AIAA 2006-6753, app. C.
    """
    dtype = float_dtype(day, seconds)
    o = orientation_in(orientation, dtype)
    angle = gmst82(day, jnp.asarray(seconds, dtype) + o.ut1_minus_utc)
    return turn_x(-o.y, turn_y(-o.x, turn_z(angle, jnp.eye(3, dtype=dtype))))


def state_teme_to_itrf(
    day: Scalar, seconds: Scalar, state: Vector6, orientation: EarthOrientation | None = None
) -> Vector6:
    """Position and velocity in ITRF, which turns, of a state in TEME.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        state: (6,) position and velocity [m, m/s], TEME.
        orientation: Earth orientation.
    """
    rotation, rate = _rotation_and_rate(day, seconds, orientation)
    return into_turning(rotation, rate, state)


def state_itrf_to_teme(
    day: Scalar, seconds: Scalar, state: Vector6, orientation: EarthOrientation | None = None
) -> Vector6:
    """Position and velocity in TEME of a state in ITRF: the inverse of `state_teme_to_itrf`.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        state: (6,) position and velocity as seen from the turning Earth [m, m/s], ITRF.
        orientation: Earth orientation.
    """
    rotation, rate = _rotation_and_rate(day, seconds, orientation)
    return out_of_turning(rotation, rate, state)


def _rotation_and_rate(day, seconds, orientation):
    dtype = float_dtype(day, seconds)
    o = orientation_in(orientation, dtype)

    def at(seconds, ut1_minus_utc):
        return rotation_teme_to_itrf(day, seconds, o._replace(ut1_minus_utc=ut1_minus_utc))

    return with_rate(at, seconds, o.ut1_minus_utc, o.lod)


def rotation_teme_to_gcrf(
    day: Scalar, seconds: Scalar, orientation: EarthOrientation | None = None, pole: PoleModel = _SERIES
) -> Matrix3:
    """Rotation matrix from TEME to GCRF: the way over ITRF, on which the Earth's rotation cancels.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        orientation: Earth orientation; polar motion does not matter here, UT1 hardly.
        pole: how the celestial pole is found.

    Validity: within 2e-10 rad of the way over ITRF (its locator s'); float32 1e-7 rad.

    Source: Vallado et al. 2006, AIAA 2006-6753, app. C, with the pole of IAU 2006/2000A.
    """
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype)
    o = orientation_in(orientation, dtype)
    at = pole.at(day, seconds)
    cirs = rotation_gcrf_to_cirs(at._replace(x=at.x + o.dx, y=at.y + o.dy))
    return turn_z(-gmst82_minus_era(day, seconds + o.ut1_minus_utc), cirs).T


def state_teme_to_gcrf(
    day: Scalar,
    seconds: Scalar,
    state: Vector6,
    orientation: EarthOrientation | None = None,
    pole: PoleModel = _SERIES,
) -> Vector6:
    """Position and velocity in GCRF of a state in TEME, whose axes are taken at rest (they drift 8e-12 rad/s).

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        state: (6,) position and velocity [m, m/s], TEME.
        orientation, pole: as in `rotation_teme_to_gcrf`.
    """
    rotation = rotation_teme_to_gcrf(day, seconds, orientation, pole)
    return jnp.concatenate([rotation @ state[:3], rotation @ state[3:]])


def state_gcrf_to_teme(
    day: Scalar,
    seconds: Scalar,
    state: Vector6,
    orientation: EarthOrientation | None = None,
    pole: PoleModel = _SERIES,
) -> Vector6:
    """Position and velocity in TEME of a state in GCRF: the inverse of `state_teme_to_gcrf`.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        state: (6,) position and velocity [m, m/s], GCRF.
        orientation, pole: as in `rotation_teme_to_gcrf`.
    """
    rotation = rotation_teme_to_gcrf(day, seconds, orientation, pole).T
    return jnp.concatenate([rotation @ state[:3], rotation @ state[3:]])
