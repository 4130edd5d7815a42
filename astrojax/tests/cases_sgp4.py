"""Conformance cases of SGP4: elements and time in, position and velocity out."""

import functools

import jax.numpy as jnp
import numpy as np

from astrojax.orbits import sgp4

A = np.array
# Mean motion and eccentricity, inclination, node, perigee, anomaly: near Earth, high drag, geostationary, Molniya, GPS.
NEAR = A([1.13e-3, 3e-3, 1.013, 0.943, 2.43, 3.86])
LOW = A([1.19e-3, 2.5e-3, 1.13, 6.03, 4.55, 1.74])
STATIONARY = A([7.29e-5, 3.3e-4, 0.017, 4.65, 1.5, 3.18])
MOLNIYA = A([1.458e-4, 0.688, 1.12, 4.87, 4.62, 0.353])
GPS = A([1.4585e-4, 4.85e-3, 0.955, 5.67, 4.65, 1.626])


def _flown(elements, bstar, minutes, deep_space=True):
    day, seconds = jnp.asarray(53912.0, elements.dtype), jnp.asarray(28707.0, elements.dtype)
    satellite = sgp4.sgp4_init(sgp4.Sgp4Elements(day, seconds, *elements, bstar), deep_space=deep_space)
    return sgp4.sgp4(satellite, minutes)[:2]


def cases(case):
    near = functools.partial(_flown, deep_space=False)
    loose = {"rtol32": 3e-4, "gradient_rtol32": 1e-1}
    return [
        case("sgp4/near", near, (NEAR, A(1e-4), A(37.0)), (LOW, A(3e-4), A(-61.0)), **loose),
        case(
            "sgp4",
            _flown,
            (GPS, A(1e-4), A(900.0)),
            (MOLNIYA, A(1e-4), A(-800.0)),
            (STATIONARY, A(1e-4), A(1000.0)),
            (NEAR, A(1e-4), A(37.0)),
            **loose,
        ),
    ]


# Its structure holds what is known of a satellite; the cases above go through all of it.
HOST = {"sgp4_init", "read_omm", "read_tle", "parse_tle", "stack_elements", "is_deep_space"}
HOST |= {"alpha5_to_number", "number_to_alpha5"}
