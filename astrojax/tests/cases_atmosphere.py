"""Example calls of `forces.atmosphere`, for test_conformance.py, and its rows of the conformance page."""

import numpy as np

from astrojax.forces import atmosphere

HOST = {"load_space_weather", "parse_space_weather", "constant_space_weather"}
MODELS = [
    (
        "forces.atmosphere",
        "NRLMSISE-00, 23 switches, daily and storm-time activity, hot oxygen",
        "Picone et al. 2002",
        "C transcription in double precision (nrlmsise00); the model's Fortran in single precision (pymsis)",
        "3e-13 relative; 2e-4 a gas, 4e-5 density, 5e-6 temperature, which is the Fortran's own rounding",
        "0-1000 km",
    ),
    ("forces.atmosphere", "28 exponential layers", "Vallado table 8-4", "the table", "1e-12 relative", "0-1000 km"),
    (
        "forces.atmosphere",
        "space weather, stepwise",
        "CelesTrak",
        "brahe's reading of the same file",
        "exact",
        "1957-2041, status outside",
    ),
]
A = np.array
UP = A([0.4, -0.5, 0.3]) / np.linalg.norm([0.4, -0.5, 0.3])
STORM = A([48.0, 80.0, 56.0, 32.0, 15.0, 22.0, 9.0])


def _density(r, seconds, f107, f107a, ap, switches):
    return atmosphere.density_nrlmsise00(r, 60000, seconds, atmosphere.SpaceWeather(f107, f107a, ap), switches)


def _air(height, latitude, f107, ap):
    weather = atmosphere.SpaceWeather(f107, 0.9 * f107, ap)
    found = atmosphere.nrlmsise00(height, latitude, 0.3 * latitude, 200.0, 3e4, weather, atmosphere.STORM_TIME)
    return found.temperature / 1000.0, found.exosphere / 1000.0


def _weather(seconds):
    found = atmosphere.space_weather(atmosphere.load_space_weather(), 60000, seconds)
    return found.f107, found.f107a, found.ap


def cases(case):
    switches = A(atmosphere.ALL_ON)
    part = switches * A([0.9, 0.6] * 11 + [0.8])
    return [
        case(
            "density_exponential",
            atmosphere.density_exponential,
            (6778e3 * UP, A(3e-12), A(4e5), A(6e4)),
            rtol32=1e-4,
        ),
        case(
            "density_layered",
            atmosphere.density_layered,
            *((h * UP,) for h in (6360e3, 6390e3, 6778e3, 7300e3, 7800e3)),
            rtol32=1e-3,
            gradient_rtol32=1e-2,
        ),
        case(
            "density_nrlmsise00",
            _density,
            *(
                (h * UP, A(4e4), A(150.0), A(140.0), STORM, part)
                for h in (6350e3, 6379e3, 6415e3, 6450e3, 6475e3, 6600e3, 6720e3, 6900e3, 7300e3)
            ),
            rtol32=2e-4,
            gradient_rtol32=1e-2,
        ),
        case("nrlmsise00", _air, (A(2e5), A(0.5), A(150.0), STORM), (A(5e4), A(-0.5), A(150.0), STORM), rtol32=1e-5),
        case("space_weather", _weather, (A(43000.0),), (A(-1e5),)),
    ]
