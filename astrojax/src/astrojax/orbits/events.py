"""What may happen on an orbit, as functions of time and state that change their sign then: for `propagate.events`."""

from collections.abc import Callable

from jaxtyping import Array

from astrojax._types import FloatScalar, Scalar, Vector6, dot, inverse_norm
from astrojax.constants import R_EARTH
from astrojax.ephemeris import eclipse_angles


def event_node(t: Scalar, y: Vector6) -> FloatScalar:
    """Crossing of the plane z = 0: rising at the ascending node.

    Args:
        t: not used.
        y: (6,) position and velocity [m, m/s].
    """
    del t
    return y[2]


def event_apsis(t: Scalar, y: Vector6) -> FloatScalar:
    """Radial velocity [m/s]: rising at periapsis, falling at apoapsis.

    Args:
        t: not used.
        y: (6,) position and velocity [m, m/s].
    """
    del t
    return dot(y[:3], y[3:]) * inverse_norm(y[:3])


def event_altitude(altitude: Scalar) -> Callable[[Scalar, Vector6], FloatScalar]:
    """Event of passing an altitude above the equator's radius [m], rising or falling with it."""

    def event(t: Scalar, y: Vector6) -> FloatScalar:
        del t
        return 1.0 / inverse_norm(y[:3]) - (R_EARTH + altitude)

    return event


def event_eclipse(sun: Callable[[Scalar], Array], *, umbra: bool = False) -> Callable[[Scalar, Vector6], FloatScalar]:
    """Event of entering the Earth's shadow, where it falls, and of leaving it, where it rises.

    Args:
        sun: gives the position (3,) of the Sun [m] at a time, in the axes of the state.
        umbra: static: the Sun wholly hidden; else at all.

    Validity: the Earth is a sphere, as in `ephemeris.eclipse_angles`.
    """
    side = -1.0 if umbra else 1.0

    def event(t: Scalar, y: Vector6) -> FloatScalar:
        radius_sun, radius_earth, separation = eclipse_angles(y[:3], sun(t))
        return separation - radius_earth - side * radius_sun

    return event
