"""Make `astrojax/tests/data/nrlmsise00.npz`: what two other implementations of NRLMSISE-00 say at random points.

    pip install nrlmsise00==0.1.2 pymsis==0.13.0
    python astrojax/tools/nrlmsise00_reference.py

`nrlmsise00` holds D. Brodowski's transcription in C, in double precision. `pymsis` (version 0) runs the model's own
Fortran, in single precision and at whole seconds, so the points have inputs that single precision holds exactly. Of the
points 600 go by the daily magnetic index, 400 by its history, and 460 have one switch each at 0 or 2.
"""

from pathlib import Path

import numpy as np
import pymsis
from nrlmsise00._nrlmsise00 import gtd7, gtd7d

OUT = Path(__file__).parents[1] / "tests/data/nrlmsise00.npz"
SPECIES = (0, 1, 2, 3, 4, 6, 7)  # He, O, N2, O2, Ar, H, N in the order of `gtd7`
PYMSIS = (4, 3, 1, 2, 6, 5, 7, 8, 0, 10)  # the same, hot oxygen, effective density and temperature in that of `pymsis`


def points(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Random places, seasons, hours and activities; a third of them below 130 km."""
    height = np.where(rng.random(n) < 1 / 3, rng.uniform(0, 130, n), rng.uniform(0, 1000, n))
    longitude, seconds = rng.uniform(-180, 180, n), rng.integers(0, 86400, n)
    found = {
        "height": height,
        "latitude": np.degrees(np.arcsin(rng.uniform(-1, 1, n))),
        "longitude": longitude,
        "day": rng.integers(1, 366, n),
        "seconds": seconds,
        "f107": rng.uniform(65, 300, n),
        "f107a": rng.uniform(65, 250, n),
        "ap": rng.choice([0, 2, 4, 7, 15, 27, 48, 80, 154, 300], (n, 7)),
    }
    return {name: value.astype(np.float32) for name, value in found.items()}


def in_double(at: dict[str, np.ndarray], switches: np.ndarray) -> np.ndarray:
    """Rows of seven densities, hot oxygen [1/m^3], density, effective density [kg/m^3], both temperatures [K]."""
    rows = []
    for i, flags in enumerate(switches):
        day, (sec, height, lat, lon, f107, f107a) = (
            int(at["day"][i]),
            (float(at[name][i]) for name in ("seconds", "height", "latitude", "longitude", "f107", "f107a")),
        )
        ap = [float(x) for x in at["ap"][i]]
        arguments = (
            2001,
            day,
            sec,
            height,
            lat,
            lon,
            sec / 3600 + lon / 15,
            f107a,
            f107,
            ap[0],
            ap,
            [1, *flags.tolist()],
        )
        (plain, temperatures), (effective, _) = gtd7(*arguments), gtd7d(*arguments)
        rows.append([*(plain[k] for k in SPECIES), plain[8], plain[5], effective[5], *temperatures])
    return np.array(rows)


def in_single(at: dict[str, np.ndarray], switches: np.ndarray) -> np.ndarray:
    """Rows of seven densities, hot oxygen, effective density and temperature."""
    start = np.datetime64("2001-01-01")
    dates = start + (at["day"] - 1).astype("timedelta64[D]") + at["seconds"].astype("timedelta64[s]")
    rows = np.empty((len(switches), 11), np.float32)
    # With the ninth switch at 0 the Fortran goes on by whichever index it went by last: the daily one, in this order.
    for flags in sorted(np.unique(switches, axis=0), key=lambda flags: flags[8] < 0):
        same = np.all(switches == flags, axis=1)
        args = (at[name][same] for name in ("longitude", "latitude", "height", "f107", "f107a", "ap"))
        rows[same] = pymsis.calculate(dates[same], *args, options=[*flags.astype(float), 1, 1], version=0)
    return rows[:, PYMSIS]


def main() -> None:
    rng = np.random.default_rng(20260801)
    switches = np.ones((1460, 23), np.int8)
    switches[600:1000, 8] = -1
    for k in range(23):
        for j, value in enumerate((0, 2)):
            start = 1000 + 10 * (2 * k + j)
            switches[start : start + 10, k] = value
            switches[start : start + 5, 8] *= 1 if k == 8 else -1
    at = points(rng, len(switches))
    # Without departures from diffusion both leave a variable of the mixed air as an earlier call set it.
    at["height"][1280:1300] = np.maximum(at["height"][1280:1300], 80)
    double, single = in_double(at, switches), in_single(at, switches)
    np.savez_compressed(OUT, **at, switches=switches, double=double, single=single)
    both = np.abs(single[:, -1] / double[:, -1] - 1)
    print(f"{OUT.name}: {OUT.stat().st_size} bytes; their temperatures differ by {both.max():.1e} at most")


if __name__ == "__main__":
    main()
