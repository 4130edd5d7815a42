"""Solar radiation pressure on a sphere or on flat plates, in and out of Earth's shadow."""

import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar, Vector3, inverse_norm
from astrojax.attitude import quat_rotate
from astrojax.constants import AU
from astrojax.ephemeris import illumination_conical, illumination_cylindrical
from astrojax.forces.base import Traced, force, static
from astrojax.forces.environment import Environment
from astrojax.forces.spacecraft import Plates, Spacecraft

SOLAR_PRESSURE = 1361.0 / 299792458.0
"""At 1 au [N/m^2]: the total solar irradiance of 1361 W/m^2 (Kopp and Lean 2011, doi:10.1029/2010GL045777) over c."""

SHADOWS = ("conical", "cylindrical", "none")


def accel_radiation(
    r: Vector3,
    r_sun: Vector3,
    mass: Scalar,
    area: Scalar,
    reflectivity: Scalar,
    pressure: Scalar = SOLAR_PRESSURE,
) -> Vector3:
    """Acceleration [m/s^2] by sunlight of a sphere, or of a plate that faces the Sun; no shadow.

    Args:
        r: (3,) position of the vehicle [m].
        r_sun: (3,) position of the Sun [m], same origin and axes.
        mass: of the vehicle [kg].
        area: cross-section [m^2].
        reflectivity: radiation pressure coefficient, 1 (all absorbed) to 2 (all mirrored back).
        pressure: at 1 au [N/m^2].

    Source: Montenbruck and Gill, Satellite Orbits, eq. 3.75.
    """
    flux, direction = _sunlight(r, r_sun, pressure)
    return (-reflectivity * area / mass * flux) * direction


def accel_radiation_plates(
    r: Vector3, r_sun: Vector3, mass: Scalar, plates: Plates, pressure: Scalar = SOLAR_PRESSURE
) -> Vector3:
    """Acceleration [m/s^2] by sunlight of flat plates that do not shade each other; no shadow of the Earth.

    Args:
        r: (3,) position of the vehicle [m].
        r_sun: (3,) position of the Sun [m], same origin and axes.
        mass: of the vehicle [kg].
        plates: with normals in the axes of `r`.
        pressure: at 1 au [N/m^2].

    Source: Montenbruck and Gill, Satellite Orbits, eq. 3.73, with Lambertian scatter: Milani, Nobili and Farinella,
    Non-gravitational Perturbations and Satellite Geodesy, sec. 4.2.
    """
    flux, direction = _sunlight(r, r_sun, pressure)
    cosine = jnp.maximum(plates.normals @ direction, 0.0)
    along_light = plates.areas * cosine * (1.0 - plates.specular)
    along_normal = plates.areas * cosine * 2.0 * (plates.specular * cosine + plates.diffuse * (1.0 / 3.0))
    push = jnp.sum(along_light) * direction + along_normal @ plates.normals
    return (-flux / mass) * push


def _sunlight(r: Vector3, r_sun: Vector3, pressure: Scalar) -> tuple[FloatScalar, Vector3]:
    """Pressure [N/m^2] at the vehicle, and the unit vector to the Sun."""
    # In au: the square of 1.5e11 m leaves the range of float32 when differentiated.
    to_sun = (r_sun - r) * (1.0 / AU)
    inverse = inverse_norm(to_sun)
    return pressure * inverse * inverse, to_sun * inverse


@force
class SolarRadiation:
    """Solar radiation pressure; acts on mass and either plates or srp_area and reflectivity.

    Args:
        pressure: at 1 au [N/m^2].
        shadow: static; "conical" (smooth), "cylindrical" or "none".

    Raises: ValueError, `shadow` is none of these.
    """

    pressure: Traced = SOLAR_PRESSURE
    shadow: str = static(default="conical")

    needs = frozenset({"sun"})

    def __post_init__(self) -> None:
        if self.shadow not in SHADOWS:
            raise ValueError(f"shadow: expected one of {SHADOWS}, got {self.shadow!r}")

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        sun = environment.required("sun", "SolarRadiation")
        mass = spacecraft.required("mass", "SolarRadiation")
        plates = spacecraft.plates
        if plates is not None:
            if spacecraft.attitude is not None:
                normals = [quat_rotate(spacecraft.attitude, n) for n in plates.normals]
                plates = plates._replace(normals=jnp.stack(normals))
            lit = accel_radiation_plates(r, sun, mass, plates, self.pressure)
        else:
            area, reflectivity = (spacecraft.required(n, "SolarRadiation") for n in ("srp_area", "reflectivity"))
            lit = accel_radiation(r, sun, mass, area, reflectivity, self.pressure)
        if self.shadow == "none":
            return lit
        illumination = illumination_conical if self.shadow == "conical" else illumination_cylindrical
        return illumination(r, sun) * lit
