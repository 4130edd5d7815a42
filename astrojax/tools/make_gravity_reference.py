"""Accelerations of a made-up gravity field in 60-digit arithmetic, the reference of the tests.

    python astrojax/tools/make_gravity_reference.py

By another road than the library's: the potential from unnormalised Legendre functions and factorials, its gradient by
central differences of 1e-20 of the radius, whose error is 1e-36. Takes a minute or two; needs mpmath.
"""

from pathlib import Path

import numpy as np

try:
    import mpmath as mp
except ImportError:  # the tests want `coefficients` alone
    mp = None

TARGET = Path(__file__).parents[1] / "tests/data/gravity_reference.npz"
GM, RADIUS = 3.986004415e14, 6378136.3
DEGREES = (120, 200)
POINTS = np.array(
    [
        [6778137.0, 0.0, 0.0],
        [0.0, 0.0, 6778137.0],
        [1.0, -2.0, -6478137.0],
        [3912345.0, -4412345.0, 3412345.0],
        [-1234567.0, 2345678.0, 6345678.0],
        [12345678.0, -23456789.0, 34567890.0],
    ]
)


def coefficients(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Kaula's rule, 1e-5 / n^2, times digits of no meaning; doubles."""
    n, m = np.indices((degree + 1, degree + 1))
    kaula = np.where((m <= n) & (n > 1), 1e-5 / np.maximum(n, 1) ** 2, 0.0)
    c = kaula * ((n * 7919 + m * 104729 + 13) % 2003 / 1001.5 - 1.0)
    s = kaula * ((n * 6101 + m * 95989 + 7) % 1999 / 999.5 - 1.0) * (m > 0)
    return c, s


def potential(x, y, z, c, s):
    """sum (R / r)^n P_nm (C cos m lon + S sin m lon) GM / r, without the central term."""
    degree = len(c) - 1
    r = mp.sqrt(x * x + y * y + z * z)
    u, ratio = z / r, mp.mpf(RADIUS) / r
    total, power, sectoral = mp.mpf(0), mp.mpc(1), mp.mpf(1)
    for m in range(degree + 1):
        # P_mm = (2m - 1)!! cos^m; the cosine goes with the longitude, in (x + i y)^m.
        below, value = mp.mpf(0), sectoral
        inner = mp.mpc(0)
        norm = mp.sqrt(mp.mpf(2 - (m == 0)) * (2 * m + 1) / mp.factorial(2 * m))
        scale = ratio**m
        for n in range(m, degree + 1):
            inner += norm * scale * value * mp.mpc(c[n, m], -s[n, m])
            below, value = value, ((2 * n + 1) * u * value - (n + m) * below) / (n + 1 - m)
            norm *= mp.sqrt(mp.mpf((2 * n + 3) * (n + 1 - m)) / ((2 * n + 1) * (n + 1 + m)))
            scale *= ratio
        total += (inner * power).real
        power *= mp.mpc(x, y) / r
        sectoral *= 2 * m + 1
    return mp.mpf(GM) / r * total


def gradient(point, c, s) -> list[float]:
    point = [mp.mpf(float(value)) for value in point]
    h = mp.mpf(10) ** -20 * mp.sqrt(sum(value * value for value in point))
    out = []
    for axis in range(3):
        plus, minus = list(point), list(point)
        plus[axis] += h
        minus[axis] -= h
        out.append(float((potential(*plus, c, s) - potential(*minus, c, s)) / (2 * h)))
    return out


def main() -> None:
    mp.mp.dps = 60
    stored = {"points": POINTS}
    for degree in DEGREES:
        c, s = coefficients(degree)
        stored[f"accel_{degree}"] = np.array([gradient(point, c, s) for point in POINTS])
    TARGET.parent.mkdir(exist_ok=True)
    np.savez_compressed(TARGET, **stored)


if __name__ == "__main__":
    main()
