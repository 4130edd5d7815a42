"""Perturbing acceleration of a distant body."""

import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, dot, inverse_norm
from astrojax.constants import GM_MOON, GM_SUN
from astrojax.forces.base import Traced, force, static
from astrojax.forces.environment import Environment
from astrojax.forces.spacecraft import Spacecraft

GM_BODIES = {
    "sun": GM_SUN,
    "moon": GM_MOON,
    # Systems of planet and moons, JPL DE440 (Park et al. 2021, table 2).
    "mercury": 2.2031868551e13,
    "venus": 3.24858592e14,
    "mars": 4.2828375816e13,
    "jupiter": 1.26712764100000e17,
    "saturn": 3.79405848418000e16,
    "uranus": 5.79455640000e15,
    "neptune": 6.83652710058e15,
}
"""Gravitational parameters [m^3/s^2] of the bodies that `ThirdBody` knows by name."""


def accel_third_body(r: Vector3, r_body: Vector3, gm_body: Scalar) -> Vector3:
    """Acceleration [m/s^2] a third body adds to motion about Earth's centre (direct minus indirect term).

    Args:
        r: (3,) position of the vehicle from Earth's centre [m].
        r_body: (3,) position of the body from Earth's centre [m], same axes, |r_body| > |r|.
        gm_body: its gravitational parameter [m^3/s^2].

    Validity: any |r| < |r_body|; the two terms, equal to four digits for the Sun, are never subtracted, so
    float32 keeps its full relative accuracy.

    Source: Battin, An Introduction to the Mathematics and Methods of Astrodynamics, rev. ed.,
    ch. 8 (the function f(q)).
    """
    inv_d = inverse_norm(r_body)
    # Scaled by the body's distance: the bare powers of 1.5e11 m leave the range of float32.
    x, u = r * inv_d, r_body * inv_d
    q = dot(x, x - 2.0 * u)
    root = jnp.sqrt(1.0 + q)
    cubed = (1.0 + q) * root
    f = q * (3.0 + q * (3.0 + q)) / (1.0 + cubed)
    return (-gm_body * inv_d * inv_d / cubed) * (x + f * u)


_BY_NAME = object()  # stands for the table's value; None may not, since tree operations put it in a leaf's place


@force
class ThirdBody:
    """The attraction of a distant body, which also accelerates the centre that positions are counted from.

    Args:
        body: static; one of `GM_BODIES`, or with `gm` any name that the environment's `planets` has.
        gm: gravitational parameter [m^3/s^2]; of the table, if not given.

    Raises: ValueError, the body is not in the table and no `gm` is given.
    """

    body: str = static()
    gm: Traced = _BY_NAME

    def __post_init__(self) -> None:
        if self.gm is _BY_NAME:
            if self.body not in GM_BODIES:
                raise ValueError(f"body: expected one of {sorted(GM_BODIES)} or a `gm` of its own, got {self.body!r}")
            object.__setattr__(self, "gm", GM_BODIES[self.body])

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({self.body})

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2] relative to the centre."""
        return accel_third_body(r, environment.required(self.body, "ThirdBody"), self.gm)

    def relative(
        self,
        t: Scalar,
        r: Vector3,
        v: Vector3,
        rho: Vector3,
        rho_dot: Vector3,
        chief: Spacecraft,
        spacecraft: Spacecraft,
        environment: Environment,
    ) -> Vector3:
        """Exact, by the same expression seen from the chief."""
        return accel_third_body(rho, environment.required(self.body, "ThirdBody") - r, self.gm)
