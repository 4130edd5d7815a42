"""Example calls of the adaptive integrators, for test_conformance.py, and their rows of the conformance page."""

import functools

import jax.numpy as jnp
import numpy as np

from astrojax import orbits, propagate

HOST = {"pullback"}  # gives a function
MODELS = [
    (
        "propagate",
        "Dormand-Prince 5(4), dense output",
        "Dormand & Prince 1980",
        "Kepler's orbit; SciPy DOP853, RK45",
        "4 mm after three orbits at rtol 1e-11",
        "order 5 measured",
    ),
    (
        "propagate",
        "Runge-Kutta-Fehlberg 4(5)",
        "Fehlberg 1969",
        "Kepler's orbit",
        "12 mm after three orbits at rtol 1e-11",
        "order 5 measured",
    ),
    (
        "propagate",
        "Runge-Kutta-Nystrom 12(10)",
        "Dormand et al. 1987",
        "Kepler's orbit; order conditions",
        "1 um after three orbits at rtol 1e-11; 1e-14",
        "order 12 measured; no drag",
    ),
    ("propagate", "events: nodes, apsides, altitude", "-", "Kepler's equation", "1 us", ""),
    ("propagate", "events: eclipse", "Montenbruck & Gill sec. 3.4.2", "shadow cone of a circular orbit", "0.05 s", ""),
    ("propagate", "state transition matrix, forward mode", "-", "differences; symplectic", "1e-5; 1e-8", ""),
]
A = np.array
# In units of the orbit, so that every component is of order one.
START, PARAMETER = A([1.0, 0.1, -0.2, 0.05, 0.9, 0.3]), A(1.1)


def orbit(t, y, mu):
    del t
    r = y[:3]
    return jnp.concatenate([y[3:], -mu * r / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) ** 1.5])


def _options(steps):
    """A fixed step: those of a tolerance would not be the same on both sides of a difference."""
    return {"rtol": 1e3, "first_step": 1.0 / steps, "max_step": 1.0 / steps, "max_steps": 2 * steps, "bounded": True}


def _end(y, t1, mu, method, steps):
    return propagate.integrate(orbit, 0.0, y, t1, mu, method=method, **_options(steps)).y


def _path(y, mu):
    return propagate.trajectory(orbit, 0.0, y, jnp.ones_like(mu), mu, **_options(16))


def _trajectory(y, mu):
    path = _path(y, mu)
    return path.t, path.y[:9]


def _between(y, mu, t):
    return propagate.interpolate(_path(y, mu), t)[0]


def _event(y, mu):
    found = propagate.events(_path(y, mu), orbits.event_node, orbit, mu, max_events=1)
    return found.t[0], found.y[0]


def _matrix(y, mu):
    return propagate.state_transition_matrix(orbit, 0.0, y, 1.0, mu, **_options(8))[1]


def _by_parameter(y, mu):
    return propagate.parameter_sensitivity(orbit, 0.0, y, 1.0, mu, **_options(8))[1]


def _eclipse(y, sun):
    return orbits.event_eclipse(lambda t: sun)(jnp.zeros_like(y[0]), y)


def cases(case):
    up = A([6.9e6, 1e5, -2e5, 1e2, 5.6e3, 5.5e3])
    methods = (("5(4)", propagate.DORMAND_PRINCE, 8), ("4(5)", propagate.FEHLBERG, 8), ("12", propagate.NYSTROM_12, 1))
    return [
        *(
            case(f"integrate/{name}", functools.partial(_end, method=method, steps=steps), (START, A(0.9), PARAMETER))
            for name, method, steps in methods
        ),
        case("trajectory", _trajectory, (START, PARAMETER)),
        case("interpolate", _between, (START, PARAMETER, A(0.77))),
        case("events", _event, (START, PARAMETER), rtol32=1e-5),
        case("state_transition_matrix", _matrix, (START, PARAMETER), rtol32=1e-5),
        case("parameter_sensitivity", _by_parameter, (START, PARAMETER), rtol32=1e-5),
        case("event_node", lambda y: orbits.event_node(0.0, y), (up,)),
        case("event_apsis", lambda y: orbits.event_apsis(0.0, y), (up,)),
        case("event_altitude", lambda y, h: orbits.event_altitude(h)(0.0, y), (up, A(2e5)), rtol32=1e-4),
        case("event_eclipse", _eclipse, (up, A([-9.4e10, 1.09e11, 4.7e10])), (-up, A([1e11, 1e11, 3e10])), rtol32=1e-5),
    ]
