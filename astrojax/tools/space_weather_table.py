"""Make `astrojax/forces/atmosphere/data/space_weather.npz` from a file of CelesTrak's, or from the one in brahe.

    python astrojax/tools/space_weather_table.py [SW-All.txt]

Without a file the rows are read from the data that brahe 1.8 (MIT licence) ships, day by day through its public
functions. They are CelesTrak's compilation of the indices of GFZ Potsdam (Kp and Ap, CC BY 4.0) and of the Dominion
Radio Astrophysical Observatory (F10.7), with the predictions of NOAA and NASA.
"""

import sys
from pathlib import Path

import numpy as np

from astrojax.forces.atmosphere.space_weather import MONTHLY, OBSERVED, PREDICTED, SpaceWeatherTable
from astrojax.forces.atmosphere.space_weather_files import load_space_weather

OUT = Path(__file__).parents[1] / "src/astrojax/forces/atmosphere/data/space_weather.npz"


def from_brahe() -> SpaceWeatherTable:
    import brahe

    found = brahe.FileSpaceWeatherProvider.from_default_file()
    days = np.arange(int(found.mjd_min()), int(found.mjd_max()) + 1)
    noon = days + 0.5
    kind = np.full(days.size, MONTHLY)
    kind[days <= found.mjd_last_daily_predicted()] = PREDICTED
    kind[days <= found.mjd_last_observed()] = OBSERVED

    def column(get, scale=1):
        return np.rint(scale * np.array([get(float(mjd)) for mjd in noon])).astype(np.int16)

    return SpaceWeatherTable(
        first_day=np.int32(days[0]),
        f107=column(found.get_f107_observed, 10),
        f107a=column(found.get_f107_obs_avg81, 10),
        ap_daily=column(found.get_ap_daily),
        ap=column(found.get_ap_all),
        kind=kind.astype(np.int16),
    )


def main() -> None:
    table = load_space_weather(sys.argv[1]) if len(sys.argv) > 1 else from_brahe()
    np.savez_compressed(OUT, **table._asdict())
    print(f"{OUT.name}: {len(table.f107)} days, {OUT.stat().st_size} bytes")


if __name__ == "__main__":
    main()
