"""Example calls of the adaptive integrators, for test_conformance.py, and their rows of the conformance page."""

import jax.numpy as jnp
import numpy as np

from astrojax import propagate

HOST = {"pullback"}  # gives a function
MODELS = [
    ("propagate", "Dormand-Prince 5(4), dense output", "Dormand & Prince 1980", "SciPy RK45, Kepler's orbit", "", ""),
    ("propagate", "Runge-Kutta-Fehlberg 4(5)", "Fehlberg 1969", "Kepler's orbit", "", ""),
    ("propagate", "Runge-Kutta-Nystrom 12(10)", "Dormand et al. 1987", "Kepler's orbit", "", ""),
    ("propagate", "events, refined by steps of the method", "-", "Kepler's equation", "", ""),
    ("propagate", "state transition matrix by forward mode", "-", "central differences; symplectic", "", ""),
]
A = np.array
# In units of the orbit, so that every component is of order one.
START, PARAMETER = A([1.0, 0.1, -0.2, 0.05, 0.9, 0.3]), A(1.1)


def orbit(t, y, mu):
    del t
    r = y[:3]
    return jnp.concatenate([y[3:], -mu * r / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) ** 1.5])


def _end(y, t1, mu, method):
    # A fixed number of steps: those of a tolerance would not be the same on both sides of a difference.
    step = 1.0 / 64 if method is not propagate.NYSTROM_12 else 1.0 / 8
    found = propagate.integrate(orbit, 0.0, y, t1, mu, method=method, rtol=1e3, first_step=step, max_step=step)
    return found.y


def _path(y, t1, mu):
    return propagate.trajectory(orbit, 0.0, y, t1, mu, rtol=1e3, first_step=1 / 32, max_step=1 / 32, max_steps=128)


def _between(y, mu):
    return propagate.interpolate(_path(y, jnp.ones_like(mu), mu), 0.77)[0]


def _event(y, mu):
    path = _path(y, 3 * jnp.ones_like(mu), mu)
    found = propagate.events(path, propagate.event_node, orbit, mu, max_events=1)
    return found.t[0]


def _matrix(y, mu):
    return propagate.state_transition_matrix(
        orbit, 0.0, y, 1.0, mu, rtol=1e3, first_step=1 / 32, max_step=1 / 32, bounded=True, max_steps=40
    )[1]


def _by_parameter(y, mu):
    return propagate.parameter_sensitivity(
        orbit, 0.0, y, 1.0, mu, rtol=1e3, first_step=1 / 32, max_step=1 / 32, bounded=True, max_steps=40
    )[1]
