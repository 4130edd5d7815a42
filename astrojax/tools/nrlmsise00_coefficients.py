"""Make `astrojax/forces/atmosphere/data/nrlmsise00.npz` from the published coefficient tables.

    pip download --no-binary nrlmsise00 --no-deps nrlmsise00==0.1.2
    python astrojax/tools/nrlmsise00_coefficients.py nrlmsise00-0.1.2.tar.gz

The tables are those of the block data of the Naval Research Laboratory's NRLMSISE-00 (Picone et al. 2002), which is in
the public domain, as they stand in D. Brodowski's transcription, in the public domain too.
"""

import re
import sys
import tarfile
from pathlib import Path

import numpy as np

SHAPES = {
    "pt": (150,),
    "pd": (9, 150),
    "ps": (150,),
    "pdl": (2, 25),
    "ptm": (50,),
    "pdm": (8, 10),
    "ptl": (4, 100),
    "pma": (10, 100),
    "pavgm": (10,),
}
OUT = Path(__file__).parents[1] / "src/astrojax/forces/atmosphere/data/nrlmsise00.npz"


def tables(text: str) -> dict[str, np.ndarray]:
    """Every table by its published name."""
    text = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)
    found = {}
    for name, body in re.findall(r"double (\w+)(?:\[\d+\])+ = \{(.*?)\};", text, flags=re.DOTALL):
        if name in SHAPES:
            numbers = np.array([float(number) for number in re.findall(r"[-+]?\d+\.\d*(?:E[-+]\d+)?", body)])
            size = int(np.prod(SHAPES[name]))
            found[name] = np.pad(numbers, (0, size - numbers.size)).reshape(SHAPES[name])
    missing = set(SHAPES) - set(found)
    if missing:
        raise SystemExit(f"tables not found: {sorted(missing)}")
    return found


def main() -> None:
    with tarfile.open(sys.argv[1]) as archive:
        member = next(m for m in archive.getmembers() if m.name.endswith("nrlmsise-00_data.c"))
        text = archive.extractfile(member).read().decode()
    found = tables(text)
    # Two families of expansions, each with its rows in one array.
    upper = np.concatenate([found["pt"][None], found["ps"][None], found["pd"]])
    lower = np.concatenate([found["ptl"], found["pma"]])
    OUT.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        OUT,
        upper=upper,
        lower=lower,
        turbopause=found["pdl"],
        temperature=found["ptm"][:10],
        density=found["pdm"],
        mean=found["pavgm"],
    )
    print(f"{OUT.name}: {OUT.stat().st_size} bytes")


if __name__ == "__main__":
    main()
