"""A gravity field's coefficients: those that come with the package, and any ICGEM file."""

import gzip
import math
import pathlib
from importlib import resources
from typing import Any

import numpy as np

from astrojax.forces.base import Traced, force, static

BUNDLED = {"EGM2008": "egm2008", "GGM05S": "ggm05s", "JGM3": "jgm3"}
"""Fields that come with the package, and their files."""


@force
class GravityField:
    """Fully normalised coefficients of a body's exterior potential.

    Args:
        gm: gravitational parameter [m^3/s^2].
        radius: reference radius [m].
        c, s: (degree + 1, degree + 1) cosine and sine coefficients by degree and order, zero above the diagonal.
        tide_system: static; "tide_free", "zero_tide", "mean_tide" or "unknown".
        name: static.
    """

    gm: Traced
    radius: Traced
    c: Traced
    s: Traced
    tide_system: str = static(default="unknown")
    name: str = static(default="")

    @property
    def degree(self) -> int:
        """Highest degree and order there are coefficients for."""
        return self.c.shape[-1] - 1

    def truncated(self, degree: int) -> "GravityField":
        """The same field to a lower degree. Raises ValueError if it has none as high."""
        if not 0 <= degree <= self.degree:
            raise ValueError(f"degree: expected 0 to {self.degree}, which {self.name or 'the field'} has, got {degree}")
        size = degree + 1
        cut = self.c[..., :size, :size], self.s[..., :size, :size]
        return GravityField(self.gm, self.radius, *cut, self.tide_system, self.name)


def gravity_field(name: str = "EGM2008", degree: int | None = None) -> GravityField:
    """A bundled field of the Earth, on the host.

    Args:
        name: "EGM2008" (to degree 120), "GGM05S" (120) or "JGM3" (70).
        degree: truncate to this; None for all there is.

    Raises: ValueError, the name is none of these or the degree is above the field's.

    Source: EGM2008: Pavlis et al. 2012, doi:10.1029/2011JB008916. GGM05S: Ries et al. 2016, doi:10.26153/tsw/1461.
    JGM3: Tapley et al. 1996, doi:10.1029/96JB01645.
    """
    if name not in BUNDLED:
        raise ValueError(f"name: expected one of {sorted(BUNDLED)}, got {name!r}")
    with (resources.files("astrojax.forces") / "data" / f"{BUNDLED[name]}.npz").open("rb") as file:
        stored = np.load(file)
        size = int(stored["degree"]) + 1
        c, s = np.zeros((size, size)), np.zeros((size, size))
        lower = np.tril_indices(size)
        c[lower], s[lower] = stored["c"], stored["s"]
        field = GravityField(float(stored["gm"]), float(stored["radius"]), c, s, str(stored["tide_system"]), name)
    return field if degree is None else field.truncated(degree)


def load_gfc(path: str | pathlib.Path, degree: int | None = None) -> GravityField:
    """A gravity field from a file in the format of the International Centre for Global Earth Models (.gfc, .gfc.gz).

    Args:
        path: of the file.
        degree: read no further; None for all there is.

    Validity: `gfct` coefficients are taken at their reference epoch, without trend or periodic terms.
    Raises: ValueError, naming the line, for what is malformed, not fully normalised or missing; or if the file has no
    coefficients as high as `degree`.

    Source: Barthelmes and Foerste, The ICGEM-format, GFZ Potsdam, 2011.
    """
    path = pathlib.Path(path)
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8", errors="replace") as file:
        lines = iter(enumerate(file, start=1))
        header = _read_header(path, lines)
        highest = int(_number(path, header, "max_degree"))
        if degree is not None and not 0 <= degree <= highest:
            raise ValueError(f"degree: expected 0 to {highest}, the max_degree of {path.name}, got {degree}")
        size = (highest if degree is None else degree) + 1
        c, s, seen = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size), bool)
        for number, line in lines:
            _read_line(path, number, line, highest, c, s, seen)
    if not seen.any():
        raise ValueError(f"{path.name}: no line of coefficients (gfc) up to degree {size - 1}")
    if not seen[-1].any():
        raise ValueError(f"{path.name}: max_degree is {highest}, but no coefficient of degree {size - 1} follows")
    if not seen[0, 0]:
        c[0, 0] = 1.0
    gm, radius = _number(path, header, "earth_gravity_constant", "gravity_constant"), _number(path, header, "radius")
    tide = header.get("tide_system", "unknown").replace("-", "_").lower()
    return GravityField(gm, radius, c, s, tide, header.get("modelname", path.stem))


def _read_header(path: pathlib.Path, lines: Any) -> dict[str, str]:
    header = {}
    for number, line in lines:
        words = line.split()
        if words and words[0] == "end_of_head":
            norm = header.get("norm", "fully_normalized")
            if norm != "fully_normalized":
                raise ValueError(f"{path.name}: norm: expected fully_normalized coefficients, got {norm!r}")
            return header
        if words and words[0] in ("gfc", "gfct"):
            raise ValueError(f"{path.name}, line {number}: coefficients before end_of_head")
        if len(words) > 1:
            header.setdefault(words[0], words[1])
    raise ValueError(f"{path.name}: no line end_of_head; is it an ICGEM file?")


def _number(path: pathlib.Path, header: dict[str, str], *keys: str) -> float:
    key = next((key for key in keys if key in header), None)
    if key is None:
        raise ValueError(f"{path.name}: the header has no {keys[0]}")
    try:
        value = _float(header[key])
    except ValueError:
        raise ValueError(f"{path.name}: {key}: expected a number, got {header[key]!r}") from None
    if not math.isfinite(value) or value <= 0:
        raise ValueError(f"{path.name}: {key}: expected a positive number, got {header[key]!r}")
    return value


def _float(word: str) -> float:
    return float(word.replace("D", "e").replace("d", "e"))


def _read_line(path: pathlib.Path, number: int, line: str, highest: int, c: Any, s: Any, seen: Any) -> None:
    """One line after the header, into the arrays."""
    words = line.split()
    if not words or words[0] not in ("gfc", "gfct"):
        return  # comments, and the trends (dot, trnd) and periodic terms (asin, acos) of gfct lines
    try:
        n, m = int(words[1]), int(words[2])
        values = _float(words[3]), _float(words[4])
    except (ValueError, IndexError):
        raise ValueError(
            f"{path.name}, line {number}: expected '{words[0]} degree order C S ...', got {line.strip()!r}"
        ) from None
    if not (0 <= m <= n <= highest) or not all(map(math.isfinite, values)):
        raise ValueError(
            f"{path.name}, line {number}: expected 0 <= order <= degree <= {highest} and finite numbers, "
            f"got {line.strip()!r}"
        )
    if n >= len(c):
        return
    if seen[n, m]:
        raise ValueError(f"{path.name}, line {number}: a second coefficient of degree {n} and order {m}")
    c[n, m], s[n, m] = values
    seen[n, m] = True
