"""Write `frames/data/iau2006.npz` and `time/data/tdb.npz`: the series of the Earth's pole and of TDB.

    python astrojax/tools/make_earth_rotation_series.py SOURCES

SOURCES is a folder with ERFA's `nut00a.c`, `s06.c` and `dtdb.c` (BSD-3-Clause; they are in the source distribution of
pyerfa, under `liberfa/erfa/src`). Only the numbers of the published tables are read: nutation IAU 2000A (Mathews,
Herring and Buffett 2002; IERS Conventions 2010, tables 5.3a and 5.3b), the CIO locator s + XY/2 (table 5.2d), and
TDB - TT (Fairhead and Bretagnon 1990). Terms of equal argument become one row; rows are sorted by size, so that
leaving out the last ones is the best series of that length.
"""

import re
import sys
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).parents[1] / "src" / "astrojax"
# Columns of the multipliers: l l' F D Om | l F D Om of the planetary theory | Me Ve E Ma Ju Sa Ur Ne | p_A
LUNAR, PLANETARY = [0, 1, 2, 3, 4], [5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17]
LOCATOR = [0, 1, 2, 3, 4, 10, 11, 17]
MICRO = 10.0  # a microarcsecond in the table's unit of 0.1 microarcsecond
# Columns of the coefficients: of sin: psi, psi t, eps; of cos: psi, eps, eps t; then s t^0 .. t^4 of each.
TDB_SMALLEST = 1e-9  # seconds, of the largest power of t = 0.15 millennia that 1850 to 2150 needs


def table(text: str, start: str, stop: str) -> list[list[float]]:
    """Rows of numbers of a C array, comments removed."""
    text = text[text.index(start) + len(start) :]
    body = re.sub(r"/\*.*?\*/", "", text[: text.index(stop)], flags=re.DOTALL)
    if "{{" in body:
        body = re.sub(r"\{\{([^}]*)\}", r"{\1", body)
    rows = re.findall(r"\{([^{}]*)\}", body)
    return [[float(x) for x in row.split(",") if x.strip()] for row in rows]


def pole(folder: Path) -> dict[str, np.ndarray]:
    rows: dict[tuple, np.ndarray] = {}

    def add(columns, multipliers, sine, cosine):
        key = np.zeros(18, int)
        key[columns] = multipliers
        first = key[np.nonzero(key)[0][0]]
        if first < 0:  # one sign for each argument
            key, sine = -key, [-x for x in sine]
        row = rows.setdefault(tuple(key), np.zeros((2, 8)))
        row += [sine, cosine]

    nutation = (folder / "nut00a.c").read_text(encoding="utf-8")
    lunar, planets = table(nutation, "xls[] = {", "};"), table(nutation, "xpl[] = {", "};")
    assert (len(lunar), len(planets)) == (678, 687)
    none = [0.0] * 5
    for *m, ps, pst, pc, ec, ect, es in lunar:
        add(LUNAR, m, [ps, pst, es, *none], [pc, ec, ect, *none])
    for *m, sp, cp, se, ce in planets:
        add(PLANETARY, m, [sp, 0.0, se, *none], [cp, ce, 0.0, *none])
    locator = (folder / "s06.c").read_text(encoding="utf-8")
    for power, length in enumerate((33, 3, 25, 4, 1)):
        terms = table(locator, f"s{power}[] = {{", "};")
        assert len(terms) == length
        for *m, s, c in terms:
            sine, cosine = np.zeros(8), np.zeros(8)
            sine[3 + power], cosine[3 + power] = s * 1e6 * MICRO, c * 1e6 * MICRO
            add(LOCATOR, m, sine, cosine)
    multipliers = np.array(list(rows), np.int8)
    coefficients = np.array(list(rows.values()))
    size = np.abs(coefficients).max(axis=(1, 2))
    order = np.argsort(-size, kind="stable")
    coefficients = np.round(coefficients[order], 6)
    return {"multipliers": multipliers[order], "sine": coefficients[:, 0], "cosine": coefficients[:, 1]}


def tdb(folder: Path) -> dict[str, np.ndarray]:
    rows = np.array(table((folder / "dtdb.c").read_text(encoding="utf-8"), "fairhd[787][3] = {", "};"))
    assert rows.shape == (787, 3)
    power = np.repeat(np.arange(5), (474, 205, 85, 20, 3))
    keep = rows[:, 0] * 0.15**power > TDB_SMALLEST
    rows, power = rows[keep], power[keep]
    return {"amplitude": rows[:, 0], "rate": rows[:, 1], "phase": rows[:, 2], "power": power.astype(np.int8)}


def main() -> None:
    folder = Path(sys.argv[1])
    for name, arrays in (("frames/data/iau2006.npz", pole(folder)), ("time/data/tdb.npz", tdb(folder))):
        np.savez_compressed(SOURCE / name, **arrays)
        print(name, {k: v.shape for k, v in arrays.items()}, (SOURCE / name).stat().st_size)


if __name__ == "__main__":
    main()
