"""Write `frames/data/eop.npz`: the Earth orientation parameters that the package brings along.

    python astrojax/tools/make_eop.py eopc04.1962-now finals2000A.all

Both files are published by the IERS (both are also in the PyPI package `astropy-iers-data`, BSD-3-Clause). The C04
series is taken as far as it goes, the finals after it, whose last part is predicted. UT1 is kept against TAI, so that
no leap second jumps in it. Numbers are kept as whole units of what is printed, and as second differences, which
compress to a third.
"""

import sys
from pathlib import Path

import numpy as np

from astrojax.frames import eop_files

TARGET = Path(__file__).parents[1] / "src" / "astrojax" / "frames" / "data" / "eop.npz"


def main() -> None:
    c04 = eop_files.parse_c04(Path(sys.argv[1]).read_text(encoding="utf-8"))
    finals = eop_files.parse_finals(Path(sys.argv[2]).read_text(encoding="utf-8"))
    eop_files.save_compact(TARGET, eop_files.join(c04, finals))
    table = eop_files.load_compact(TARGET)
    joined = eop_files.join(c04, finals)
    error = np.abs(table.columns - joined.columns).max(axis=0)
    assert np.all(error < [1e-12, 1e-12, 1e-12, 1e-12, 1e-12, 6e-8]), error  # a predicted length of day is derived
    print(TARGET.stat().st_size, "bytes,", len(table.columns), "days from", table.first_day)
    print("measured until", table.first_day + table.measured, "predicted until", table.last_day)


if __name__ == "__main__":
    main()
