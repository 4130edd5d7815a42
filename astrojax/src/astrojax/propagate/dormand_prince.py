"""Dormand and Prince's method of order 5 with an error estimate of order 4 and its interpolant of order 4.

Source: Dormand and Prince (1980), J. Comput. Appl. Math. 6(1), 19; the interpolant: Shampine's, as in Hairer, Norsett
and Wanner, Solving Ordinary Differential Equations I, sec. II.6, eq. 6.12.
"""

import numpy as np

from astrojax.propagate.methods import Method, Step, runge_kutta_stages, weighted

_NODES = np.array([1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
_MATRIX = [
    np.array([1 / 5]),
    np.array([3 / 40, 9 / 40]),
    np.array([44 / 45, -56 / 15, 32 / 9]),
    np.array([19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729]),
    np.array([9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656]),
    np.array([35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]),
]
_ERROR = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
_BEND = np.array(
    [
        -12715105075 / 11282082432,
        0.0,
        87487479700 / 32700410799,
        -10690763975 / 1880347072,
        701980252875 / 199316789632,
        -1453857185 / 822651844,
        69997945 / 29380423,
    ]
)


def _step(f, t, y, first, h):
    ks = runge_kutta_stages(f, t, y, first, h, _NODES, _MATRIX)
    # The last stage is taken at the end of the step, and is the first of the next.
    return Step(y + h * weighted(_MATRIX[-1], ks), h * weighted(_ERROR, ks), ks[-1], h * weighted(_BEND, ks))


DORMAND_PRINCE = Method("Dormand-Prince 5(4)", 5, 4, _step)
"""Order 5, six evaluations a step; dense output of order 4. The one to begin with."""
