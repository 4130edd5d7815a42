"""Write `tests/data/planets_de421.npz`: heliocentric positions of the planets from JPL's DE421.

    python astrojax/tools/make_planet_reference.py de421.bsp

The kernel is JPL's (https://ssd.jpl.nasa.gov/ftp/eph/planets/bsp), also in the PyPI package `skyfield-data`; it is read
with `jplephem`. Positions in metres at whole days of TDB, ICRF axes, 1900 to 2050.
"""

import sys
from pathlib import Path

import numpy as np
from jplephem.spk import SPK

TARGET = Path(__file__).parents[1] / "tests" / "data" / "planets_de421.npz"
NUMBERS = {
    "mercury": 1,
    "venus": 2,
    "emb": 3,
    "mars": 4,
    "jupiter": 5,
    "saturn": 6,
    "uranus": 7,
    "neptune": 8,
    "pluto": 9,
}


def main() -> None:
    kernel = SPK.open(sys.argv[1])
    days = np.linspace(15100, 69800, 400).round()
    at = lambda target, center: 1e3 * kernel[center, target].compute(2400000.5 + days).T
    sun = at(10, 0)
    positions = {body: at(number, 0) - sun for body, number in NUMBERS.items()}
    positions["earth"] = positions["emb"] + at(399, 3)
    np.savez_compressed(TARGET, days=days.astype(np.int32), **{b: p.astype(np.float32) for b, p in positions.items()})
    print(TARGET.stat().st_size)


if __name__ == "__main__":
    main()
