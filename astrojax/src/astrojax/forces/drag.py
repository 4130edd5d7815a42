"""Aerodynamic drag."""

import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, dot, safe_sqrt
from astrojax.constants import OMEGA_EARTH


def accel_drag(r: Vector3, v: Vector3, density: Scalar, mass: Scalar, area: Scalar, cd: Scalar) -> Vector3:
    """Drag acceleration [m/s^2] in an atmosphere that turns with the Earth.

    Args:
        r: (3,) inertial position [m], z along Earth's rotation axis.
        v: (3,) inertial velocity [m/s].
        density: of the air [kg/m^3].
        mass: of the vehicle [kg].
        area: cross-section across the flow [m^2].
        cd: drag coefficient.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.5.
    """
    wind = jnp.stack([v[0] + OMEGA_EARTH * r[1], v[1] - OMEGA_EARTH * r[0], v[2]])
    return (-0.5 * cd * area / mass * density * safe_sqrt(dot(wind, wind))) * wind
