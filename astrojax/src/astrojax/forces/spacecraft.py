"""What forces act on: mass, areas and coefficients of a spacecraft."""

from typing import NamedTuple

from jaxtyping import Array, Float

from astrojax._types import Quaternion, Scalar


class Plates(NamedTuple):
    """Flat plates that sunlight falls on, each lit on the side its normal points to (N of them, all traced)."""

    normals: Float[Array, "N 3"]  # unit, body axes (inertial axes where the spacecraft has no attitude)
    areas: Float[Array, "N"]  # [m^2]
    specular: Float[Array, "N"]  # share of the light that is mirrored, 0 to 1
    diffuse: Float[Array, "N"]  # share that is scattered; the rest is absorbed


class Spacecraft(NamedTuple):
    """A spacecraft as the forces see it (all traced); give what the forces in use need, the rest stays None."""

    mass: Scalar | None = None  # [kg]
    drag_area: Scalar | None = None  # across the flow [m^2]
    drag_coefficient: Scalar | None = 2.2
    srp_area: Scalar | None = None  # across the sunlight [m^2]
    reflectivity: Scalar | None = 1.3  # 1: all light absorbed, 2: all mirrored back
    plates: Plates | None = None  # in place of srp_area and reflectivity
    attitude: Quaternion | None = None  # body to inertial axes, scalar first; turns the plates

    def required(self, name: str, force: str) -> Scalar:
        """The value of a field; ValueError if it is None, naming the force that asks for it."""
        value = getattr(self, name)
        if value is None:
            raise ValueError(f"spacecraft.{name}: {force} needs it, got None")
        return value
