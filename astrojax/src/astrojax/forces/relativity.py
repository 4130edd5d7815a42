"""What general relativity adds to the motion about a massive body."""

import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, cross, dot, inverse_norm
from astrojax.constants import GM_EARTH
from astrojax.forces.base import Traced, force, static
from astrojax.forces.environment import Environment
from astrojax.forces.spacecraft import Spacecraft

SPEED_OF_LIGHT = 299792458.0
EARTH_SPIN = 9.8e8  # angular momentum of the Earth per unit mass [m^2/s], IERS Conventions (2010), sec. 10.3


def accel_schwarzschild(r: Vector3, v: Vector3, gm: Scalar = GM_EARTH) -> Vector3:
    """Relativistic correction [m/s^2] to the attraction of a spherical mass (harmonic coordinates).

    Args:
        r: (3,) position from the body's centre [m].
        v: (3,) velocity [m/s].
        gm: gravitational parameter [m^3/s^2].

    Source: IERS Conventions (2010), TN 36, eq. 10.12, first line, with beta = gamma = 1.
    """
    inv_r = inverse_norm(r)
    unit, beta = r * inv_r, v * (1.0 / SPEED_OF_LIGHT)
    potential = gm * inv_r * (1.0 / SPEED_OF_LIGHT**2)
    attraction = gm * inv_r * inv_r
    return attraction * ((4.0 * potential - dot(beta, beta)) * unit + 4.0 * dot(unit, beta) * beta)


def accel_lense_thirring(r: Vector3, v: Vector3, spin: Vector3, gm: Scalar = GM_EARTH) -> Vector3:
    """Acceleration [m/s^2] by the dragging of frames about a turning mass.

    Args:
        r: (3,) position from the body's centre [m].
        v: (3,) velocity [m/s].
        spin: (3,) angular momentum of the body per unit mass [m^2/s].
        gm: gravitational parameter [m^3/s^2].

    Source: IERS Conventions (2010), TN 36, eq. 10.12, second line, with gamma = 1.
    """
    inv_r = inverse_norm(r)
    unit, beta = r * inv_r, v * (1.0 / SPEED_OF_LIGHT)
    spin = spin * inv_r * (1.0 / SPEED_OF_LIGHT)
    return 2.0 * gm * inv_r * inv_r * (3.0 * dot(unit, spin) * cross(unit, beta) + cross(beta, spin))


@force
class Relativity:
    """Schwarzschild's correction to the central attraction, and the dragging of frames where asked for.

    Args:
        gm: gravitational parameter [m^3/s^2].
        spin: angular momentum of the body per unit mass [m^2/s], about the inertial z axis.
        lense_thirring: static; whether the spin acts (a hundredth of the rest in low orbit).
    """

    gm: Traced = GM_EARTH
    spin: Traced = EARTH_SPIN
    lense_thirring: bool = static(default=False)

    needs = frozenset()

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        accel = accel_schwarzschild(r, v, self.gm)
        if not self.lense_thirring:
            return accel
        spin = jnp.stack([jnp.zeros_like(r[0]), jnp.zeros_like(r[0]), jnp.asarray(self.spin, r.dtype)])
        return accel + accel_lense_thirring(r, v, spin, self.gm)
