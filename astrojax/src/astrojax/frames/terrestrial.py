"""GCRF to ITRF by the celestial intermediate origin, IAU 2006/2000A: rotations, and states with the Earth's turning.

`orientation` is what `EOP.at` gives; without it the pole of the model and UT1 = UTC are taken, up to 0.9 s of rotation
and 0.5 arcsec of the pole off. `pole` says how the celestial pole is found: the whole series unless told otherwise.
"""

import jax.numpy as jnp

from astrojax import constants as c
from astrojax._types import FloatScalar, Matrix3, Scalar, Vector6, float_dtype
from astrojax.frames._turns import into_turning, out_of_turning, turn_x, turn_y, turn_z, with_rate
from astrojax.frames.eop import EarthOrientation
from astrojax.frames.pole import CelestialPole, PoleModel, PoleSeries
from astrojax.time import centuries_tt, earth_rotation_angle

_SERIES = PoleSeries()


def orientation_in(orientation: EarthOrientation | None, dtype: jnp.dtype) -> EarthOrientation:
    """The orientation in a dtype; all zero if there is none."""
    if orientation is None:
        zero = jnp.zeros((), dtype)
        return EarthOrientation(zero, zero, zero, zero, zero, zero, jnp.zeros((), jnp.int32))
    numbers = (jnp.asarray(value, dtype) for value in orientation[:-1])
    return EarthOrientation(*numbers, orientation.status)


def rotation_gcrf_to_cirs(pole: CelestialPole) -> Matrix3:
    """Rotation matrix from GCRF to the celestial intermediate frame of date.

    Args:
        pole: X, Y and s.

    Source: IERS Conventions (2010), TN 36, eq. 5.6 and 5.10.
    """
    x, y = pole.x, pole.y
    z = jnp.sqrt(1.0 - (x * x + y * y))
    a = 1.0 / (1.0 + z)
    m = jnp.stack([
        jnp.stack([1.0 - a * x * x, -a * x * y, -x]),
        jnp.stack([-a * x * y, 1.0 - a * y * y, -y]),
        jnp.stack([x, y, z]),
    ])  # fmt: skip
    return turn_z(-pole.s, m)


def rotation_tirs_to_itrf(t: Scalar, x: FloatScalar, y: FloatScalar) -> Matrix3:
    """Rotation matrix from the terrestrial intermediate frame to ITRF: polar motion.

    Args:
        t: Julian centuries of TT since J2000.0, for the terrestrial origin's locator s'.
        x, y: the pole's coordinates [rad].

    Source: IERS Conventions (2010), TN 36, eqs. 5.3 and 5.13.
    """
    return _polar_motion(t, x, y, jnp.eye(3, dtype=x.dtype))


def _polar_motion(t: Scalar, x: FloatScalar, y: FloatScalar, m: Matrix3) -> Matrix3:
    """The same after another rotation: applied in turn, no product of matrices."""
    locator = (-47e-6 * c.ARCSECOND) * jnp.asarray(t, x.dtype)
    return turn_x(-y, turn_y(-x, turn_z(locator, m)))


def rotation_gcrf_to_itrf(
    day: Scalar, seconds: Scalar, orientation: EarthOrientation | None = None, pole: PoleModel = _SERIES
) -> Matrix3:
    """Rotation matrix from GCRF to ITRF at a UTC epoch.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        orientation: Earth orientation at that epoch.
        pole: how the celestial pole is found: `PoleSeries`, shorter for speed, or a `PoleTable`.

    Validity: ERFA `c2t06a` to 1e-13 rad over 1962 to 2050 (3 um at the height of GEO), which is the rounding in ERFA's
    own rotation angle; with that angle exact, to 5e-15 rad, 0.2 um. float32: 2e-6 rad.

    Source: IERS Conventions (2010), TN 36, eq. 5.1.
    """
    rotation, _ = _rotation(day, seconds, orientation, pole)
    return rotation


def _rotation(day, seconds, orientation, pole) -> tuple[Matrix3, EarthOrientation]:
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype)
    o = orientation_in(orientation, dtype)
    at = pole.at(day, seconds)
    inertial = rotation_gcrf_to_cirs(at._replace(x=at.x + o.dx, y=at.y + o.dy))
    turned = turn_z(earth_rotation_angle(day, seconds + o.ut1_minus_utc), inertial)
    return _polar_motion(centuries_tt(day, seconds), o.x, o.y, turned), o


def rotation_and_rate_gcrf_to_itrf(
    day: Scalar, seconds: Scalar, orientation: EarthOrientation | None = None, pole: PoleModel = _SERIES
) -> tuple[Matrix3, Matrix3]:
    """Rotation matrix from GCRF to ITRF and its derivative by time [1/s].

    Args:
        day, seconds, orientation, pole: as in `rotation_gcrf_to_itrf`.

    Validity: the derivative is that of the whole model, precession and nutation included, and of UT1 by the length of
    day; the drift of the measured pole (0.01 arcsec a day) is left out: 3e-13 rad/s.
    """
    dtype = float_dtype(day, seconds)
    o = orientation_in(orientation, dtype)

    def at(seconds, ut1_minus_utc):
        return _rotation(day, seconds, o._replace(ut1_minus_utc=ut1_minus_utc), pole)[0]

    return with_rate(at, seconds, o.ut1_minus_utc, o.lod)


def state_gcrf_to_itrf(
    day: Scalar,
    seconds: Scalar,
    state: Vector6,
    orientation: EarthOrientation | None = None,
    pole: PoleModel = _SERIES,
) -> Vector6:
    """Position and velocity in ITRF, which turns, of a state in GCRF.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        state: (6,) position and velocity [m, m/s], GCRF.
        orientation, pole: as in `rotation_gcrf_to_itrf`.

    Validity: as `rotation_gcrf_to_itrf`; velocity as `rotation_and_rate_gcrf_to_itrf`.
    """
    rotation, rate = rotation_and_rate_gcrf_to_itrf(day, seconds, orientation, pole)
    return into_turning(rotation, rate, state)


def state_itrf_to_gcrf(
    day: Scalar,
    seconds: Scalar,
    state: Vector6,
    orientation: EarthOrientation | None = None,
    pole: PoleModel = _SERIES,
) -> Vector6:
    """Position and velocity in GCRF of a state in ITRF: the inverse of `state_gcrf_to_itrf`.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        state: (6,) position and velocity as seen from the turning Earth [m, m/s], ITRF.
        orientation, pole: as in `rotation_gcrf_to_itrf`.
    """
    rotation, rate = rotation_and_rate_gcrf_to_itrf(day, seconds, orientation, pole)
    return out_of_turning(rotation, rate, state)
