"""Tides of the solid Earth: the harmonics of its gravity that the Sun and the Moon raise."""

import math
from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Scalar, Vector3, inverse_norm
from astrojax.constants import GM_EARTH, GM_MOON, GM_SUN, R_EARTH
from astrojax.forces.base import Traced, force, static, turned, turned_back
from astrojax.forces.environment import Environment
from astrojax.forces.fields import GravityField
from astrojax.forces.spacecraft import Spacecraft
from astrojax.forces.spherical_harmonics import accel_spherical_harmonics

# IERS Conventions (2010), TN 36, table 6.3, anelastic Earth: real and imaginary part of k_2m, k_2m(+), and k_3m.
_K2 = ((0.30190, 0.0), (0.29830, -0.00144), (0.30102, -0.00130))
_K2_PLUS = (-0.00089, -0.00080, -0.00057)
_K3 = (0.093, 0.093, 0.093, 0.094)
# Eq. 6.14: what the permanent tide has already added to C_20 in a zero-tide field, before k_20.
_PERMANENT = 4.4228e-8 * -0.31460

TIDE_SYSTEMS = ("tide_free", "zero_tide")


def solid_tide_coefficients(
    r_body: Vector3, gm_body: Scalar, gm: Scalar = GM_EARTH, radius: Scalar = R_EARTH
) -> tuple[Float[Array, "5 5"], Float[Array, "5 5"]]:
    """Changes of the normalised C and S, degrees 2 to 4, that one body raises on the Earth.

    Args:
        r_body: (3,) position of the body in Earth-fixed axes [m].
        gm_body, gm: gravitational parameters of the body and the Earth [m^3/s^2].
        radius: reference radius [m].

    Validity: step 1 of the conventions, without its frequency-dependent corrections (step 2: 10 % of the tide of some
    diurnal lines), ocean tides and pole tide.

    Source: IERS Conventions (2010), TN 36, eq. 6.6 and 6.7, table 6.3 (anelastic Earth).
    """
    inv_d = inverse_norm(r_body)
    x, y, u = r_body * inv_d
    ratio = radius * inv_d
    mass_ratio = gm_body * (1.0 / gm)  # this way round, its derivative by gm stays in the range of float32
    third = mass_ratio * ratio * ratio * ratio
    # Normalised P_nm(sin latitude) exp(-i m longitude): real part, and the imaginary one negated, as C and S have it.
    two = [
        (math.sqrt(5.0) * 0.5 * (3.0 * u * u - 1.0), jnp.zeros_like(u)),
        (math.sqrt(15.0) * u * x, math.sqrt(15.0) * u * y),
        (math.sqrt(15.0) * 0.5 * (x * x - y * y), math.sqrt(15.0) * x * y),
    ]
    sqrt_42, sqrt_105, sqrt_70 = math.sqrt(42.0), math.sqrt(105.0), math.sqrt(70.0)
    three = [
        (math.sqrt(7.0) * 0.5 * u * (5.0 * u * u - 3.0), jnp.zeros_like(u)),
        (sqrt_42 * 0.25 * (5.0 * u * u - 1.0) * x, sqrt_42 * 0.25 * (5.0 * u * u - 1.0) * y),
        (sqrt_105 * 0.5 * u * (x * x - y * y), sqrt_105 * u * x * y),
        (sqrt_70 * 0.25 * x * (x * x - 3.0 * y * y), sqrt_70 * 0.25 * y * (3.0 * x * x - y * y)),
    ]
    zero = jnp.zeros_like(u)
    c, s = [[zero] * 5 for _ in range(5)], [[zero] * 5 for _ in range(5)]
    for m, ((even, odd), (re, im)) in enumerate(zip(two, _K2)):
        # C - i S = k (even - i odd), k = re + i im
        c[2][m] = (third / 5.0) * (re * even + im * odd)
        s[2][m] = (third / 5.0) * (re * odd - im * even)
        c[4][m], s[4][m] = (third / 5.0) * _K2_PLUS[m] * even, (third / 5.0) * _K2_PLUS[m] * odd
    for m, ((even, odd), k) in enumerate(zip(three, _K3)):
        c[3][m], s[3][m] = (third * ratio / 7.0) * k * even, (third * ratio / 7.0) * k * odd
    return tuple(jnp.stack([jnp.stack(row) for row in table]) for table in (c, s))


@force
class SolidTides:
    """Tides of the solid Earth raised by the Sun and the Moon, degrees 2 to 4.

    Args:
        gm, radius: of the Earth, as of the gravity field it goes with.
        gm_sun, gm_moon: gravitational parameters [m^3/s^2].
        tide_system: static; "tide_free" if the gravity field is (EGM2008), "zero_tide" if it holds the permanent tide
            already (GGM05S, JGM3), which is then left out here.

    Validity: as of `solid_tide_coefficients`.
    Raises: ValueError, `tide_system` is neither.
    """

    gm: Traced = GM_EARTH
    radius: Traced = R_EARTH
    gm_sun: Traced = GM_SUN
    gm_moon: Traced = GM_MOON
    tide_system: str = static(default="tide_free")

    needs = frozenset({"sun", "moon", "rotation"})

    def __post_init__(self) -> None:
        if self.tide_system not in TIDE_SYSTEMS:
            raise ValueError(f"tide_system: expected one of {TIDE_SYSTEMS}, got {self.tide_system!r}")

    def acceleration_field(self, environment: Environment) -> Callable[[Vector3], Vector3]:
        """The acceleration [m/s^2] as a function of the inertial position [m] alone."""
        rotation = environment.required("rotation", "SolidTides")
        c, s = 0.0, 0.0
        for body, gm_body in (("sun", self.gm_sun), ("moon", self.gm_moon)):
            position = turned(rotation, environment.required(body, "SolidTides"))
            more = solid_tide_coefficients(position, gm_body, self.gm, self.radius)
            c, s = c + more[0], s + more[1]
        if self.tide_system == "zero_tide":
            c = c.at[2, 0].add(-_PERMANENT * _K2[0][0])
        field = GravityField(self.gm, self.radius, c, s)

        def inertial(r):
            return turned_back(rotation, accel_spherical_harmonics(turned(rotation, r), field, 4))

        return inertial

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        return self.acceleration_field(environment)(r)
