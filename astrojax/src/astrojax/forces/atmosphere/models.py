"""Atmospheres as `Drag` asks for them, beside `HarrisPriester`."""

from astrojax._types import FloatScalar, Vector3
from astrojax.forces.atmosphere.exponential import density_exponential, density_layered
from astrojax.forces.atmosphere.nrlmsise00 import ALL_ON, density_nrlmsise00
from astrojax.forces.base import Traced, force, turned
from astrojax.forces.environment import Environment


@force
class NRLMSISE00:
    """Density of NRLMSISE-00, hot oxygen included; the environment is given the space weather, as `weather`.

    Args:
        switches: (23,) as of `nrlmsise00`.
    """

    switches: Traced = ALL_ON

    needs = frozenset({"rotation", "epoch", "weather"})

    def density(self, r: Vector3, environment: Environment) -> FloatScalar:
        """Density [kg/m^3] at r (3,) [m], in the axes that the environment's rotation turns to Earth-fixed ones."""
        rotation, (day, seconds), weather = (
            environment.required(name, "NRLMSISE00") for name in ("rotation", "epoch", "weather")
        )
        return density_nrlmsise00(turned(rotation, r), day, seconds, weather, self.switches)


@force
class ExponentialAtmosphere:
    """Density that falls by e over each scale height.

    Args:
        base: density at the reference height [kg/m^3].
        height: the reference, above the ellipsoid [m].
        scale_height: [m].
    """

    base: Traced
    height: Traced
    scale_height: Traced

    needs = frozenset()

    def density(self, r: Vector3, environment: Environment) -> FloatScalar:
        """Density [kg/m^3] at r (3,) [m], z along Earth's axis."""
        return density_exponential(r, self.base, self.height, self.scale_height)


@force
class LayeredAtmosphere:
    """Density of 28 exponential layers, by `density_layered`."""

    needs = frozenset()

    def density(self, r: Vector3, environment: Environment) -> FloatScalar:
        """Density [kg/m^3] at r (3,) [m], z along Earth's axis."""
        return density_layered(r)
