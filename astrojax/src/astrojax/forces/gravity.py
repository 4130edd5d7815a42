"""Gravity of a point mass and of the zonal harmonics."""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Scalar, Vector3, inverse_norm
from astrojax.constants import GM_EARTH, R_EARTH, ZONALS
from astrojax.forces.base import Traced, force, static, turned, turned_back
from astrojax.forces.environment import Environment
from astrojax.forces.spacecraft import Spacecraft
from astrojax.forces.third_body import accel_third_body


def accel_two_body(r: Vector3, gm: Scalar = GM_EARTH) -> Vector3:
    """Point-mass gravitational acceleration [m/s^2], in the axes of `r`.

    Args:
        r: (3,) position from the attracting centre [m], not zero.
        gm: gravitational parameter [m^3/s^2].
    """
    inv_r = inverse_norm(r)
    return (-gm * inv_r * inv_r * inv_r) * r


def accel_zonal(
    r: Vector3,
    degree: int = 4,
    gm: Scalar = GM_EARTH,
    radius: Scalar = R_EARTH,
    coefficients: Sequence[Scalar] | Float[Array, "J"] = ZONALS,
) -> Vector3:
    """Acceleration [m/s^2] of zonal harmonics J2 to J`degree` (the Earth's, by default), the two-body term left out.

    Args:
        r: (3,) position from the body's centre [m], in axes whose z is its figure axis (an inertial frame
            may stand in for the Earth's: zonal terms don't depend on longitude, and the pole of date is within
            0.15 deg of the J2000 pole until 2026).
        degree: static; 0 (or 1) for none, else 2 up to what `coefficients` has, which is 6 for the Earth.
        gm: gravitational parameter [m^3/s^2].
        radius: that the coefficients refer to [m].
        coefficients: J2, J3 and so on, unnormalised.

    Validity: outside the body.
    Raises: ValueError, `degree` is not an integer from 0 to 6 (or as far as the coefficients go).

    Source: gradient of U = -gm/r sum J_n (R/r)^n P_n(z/r) (Montenbruck and Gill, Satellite Orbits, sec. 3.2),
    with (n+1) P_n + u P'_n = P'_(n+1) and the recursion of the derivatives n P'_(n+1) = (2n+1) u P'_n -
    (n+1) P'_(n-1). Coefficients: see `constants`.
    """
    highest = len(coefficients) + 1
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= highest:
        raise ValueError(f"degree: expected a static integer from 0 to {highest}, got {degree!r}")
    if degree < 2:
        return jnp.zeros_like(r)
    inv_r = inverse_norm(r)
    unit = r * inv_r
    u = unit[2]
    ratio = radius * inv_r
    scale = gm * inv_r * inv_r * ratio
    radial, axial = 0.0, 0.0
    lower, current = 1.0, 3.0 * u  # P'_1 and P'_2
    for n in range(2, degree + 1):
        scale = scale * ratio
        upper = ((2 * n + 1) / n) * u * current - ((n + 1) / n) * lower
        weight = coefficients[n - 2] * scale
        radial, axial = radial + weight * upper, axial + weight * current
        lower, current = current, upper
    return jnp.stack([radial * unit[0], radial * unit[1], radial * u - axial])


@force
class PointMass:
    """The attraction of the central body as if all its mass were in one point.

    Args:
        gm: gravitational parameter [m^3/s^2].
    """

    gm: Traced = GM_EARTH

    needs = frozenset()

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        return accel_two_body(r, self.gm)

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
        """Exact: the difference of two attractions is that of a body seen from the chief (Battin's f(q))."""
        return accel_third_body(rho, -r, self.gm)


@force
class Zonal:
    """Zonal harmonics J2 to J`degree`, the central term left out (the Earth's, by default).

    Args:
        degree: static; 0 for none, else 2 up to what `coefficients` has, which is 6 for the Earth.
        gm, radius, coefficients: as of `accel_zonal`.
        of_date: static; True: about the pole of date, by the environment's rotation; False: about the inertial z axis.

    Raises: ValueError, `degree` is outside that range (where it is used).
    """

    degree: int = static(default=4)
    gm: Traced = GM_EARTH
    radius: Traced = R_EARTH
    coefficients: Traced = ZONALS
    of_date: bool = static(default=False)

    def __post_init__(self) -> None:
        if isinstance(self.coefficients, tuple):
            highest = len(self.coefficients) + 1
            if isinstance(self.degree, bool) or not isinstance(self.degree, int) or not 0 <= self.degree <= highest:
                raise ValueError(f"degree: expected a static integer from 0 to {highest}, got {self.degree!r}")

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"rotation"} if self.of_date else ())

    def acceleration_field(self, environment: Environment) -> Callable[[Vector3], Vector3]:
        """The acceleration [m/s^2] as a function of the inertial position [m] alone."""

        def along_axis(r):
            return accel_zonal(r, self.degree, self.gm, self.radius, self.coefficients)

        if not self.of_date:
            return along_axis
        rotation = environment.required("rotation", "Zonal")
        return lambda r: turned_back(rotation, along_axis(turned(rotation, r)))

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        return self.acceleration_field(environment)(r)
