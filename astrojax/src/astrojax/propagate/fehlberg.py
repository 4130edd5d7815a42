"""Fehlberg's method of order 4 with an error estimate of order 5, carried on at order 5.

Source: Fehlberg (1969), NASA TR R-315, table III; Hairer, Norsett and Wanner, Solving Ordinary Differential
Equations I, table II.5.1.
"""

import jax.numpy as jnp
import numpy as np

from astrojax.propagate.methods import Method, Step, runge_kutta_stages, weighted

_NODES = np.array([1 / 4, 3 / 8, 12 / 13, 1.0, 1 / 2])
_MATRIX = [
    np.array([1 / 4]),
    np.array([3 / 32, 9 / 32]),
    np.array([1932 / 2197, -7200 / 2197, 7296 / 2197]),
    np.array([439 / 216, -8.0, 3680 / 513, -845 / 4104]),
    np.array([-8 / 27, 2.0, -3544 / 2565, 1859 / 4104, -11 / 40]),
]
_FIFTH = np.array([16 / 135, 0.0, 6656 / 12825, 28561 / 56430, -9 / 50, 2 / 55])
_FOURTH = np.array([25 / 216, 0.0, 1408 / 2565, 2197 / 4104, -1 / 5, 0.0])


def _step(f, t, y, first, h):
    ks = runge_kutta_stages(f, t, y, first, h, _NODES, _MATRIX)
    end = y + h * weighted(_FIFTH, ks)
    return Step(end, h * weighted(_FIFTH - _FOURTH, ks), f(t + h, end), jnp.zeros_like(y))


FEHLBERG = Method("Runge-Kutta-Fehlberg 4(5)", 5, 4, _step)
"""Order 5 by local extrapolation, six evaluations a step; dense output is the cubic through both ends."""
