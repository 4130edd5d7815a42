"""How dense the air is: pure functions of a position and an epoch, for any drag model to call."""

from astrojax.forces.atmosphere.exponential import density_exponential, density_layered
from astrojax.forces.atmosphere.models import NRLMSISE00, ExponentialAtmosphere, LayeredAtmosphere
from astrojax.forces.atmosphere.nrlmsise00 import ALL_ON, STORM_TIME, Air, density_nrlmsise00, nrlmsise00
from astrojax.forces.atmosphere.space_weather import (
    MONTHLY,
    OBSERVED,
    OUTSIDE,
    PREDICTED,
    SpaceWeather,
    SpaceWeatherTable,
    constant_space_weather,
    space_weather,
)
from astrojax.forces.atmosphere.space_weather_files import load_space_weather, parse_space_weather

__all__ = [
    "ALL_ON",
    "MONTHLY",
    "NRLMSISE00",
    "OBSERVED",
    "OUTSIDE",
    "PREDICTED",
    "STORM_TIME",
    "Air",
    "ExponentialAtmosphere",
    "LayeredAtmosphere",
    "SpaceWeather",
    "SpaceWeatherTable",
    "constant_space_weather",
    "density_exponential",
    "density_layered",
    "density_nrlmsise00",
    "load_space_weather",
    "nrlmsise00",
    "parse_space_weather",
    "space_weather",
]
