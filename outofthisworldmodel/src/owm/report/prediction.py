"""What `owm evaluate prediction` left in a folder, as blocks of a report."""

import itertools
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from owm.report.page import Block, Picture, Table
from owm.scores.prediction import QUANTITIES

_SECONDS = (1.0, 4.0, 16.0)
_PICTURES = {"prediction": "Mean error against horizon.", "calibration": "Coverage and spread against horizon."}


def prediction_blocks(folder: Path, figures: Path) -> Iterator[Block]:
    """Tables of errors and calibration, and the pictures, copied into `figures` when their blocks are taken.

    Raises:
        FileNotFoundError: the folder holds no `prediction.json`; at once.
        ValueError: it is damaged; at once.
    """
    file = folder / "prediction.json"
    try:
        tables = list(_tables(json.loads(file.read_text(encoding="utf-8"))))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{file} is damaged ({error!r}): let `owm evaluate prediction` write it again") from None
    return itertools.chain(tables, _pictures(folder, figures))


def _tables(rows: Mapping[str, Any]) -> Iterator[Block]:
    yield "## Prediction"
    yield (
        "Open loop under the true future actions, against the noiseless truth; means over windows of the same instants "
        "for all. The filter starts from as many measurements as the model with the longest history."
    )
    for group, some in _grouped(rows["error"]).items():
        yield f"### Prediction errors: {group}"
        columns = ["m / m/s / deg / deg/s at", *(f"{s:g} s" for s in _SECONDS)]
        yield Table(columns, _cells(some, lambda row: " / ".join(f"{row[f'{q}_mean']:.2g}" for q in QUANTITIES)))
    for group, some in _grouped(rows["calibration"]).items():
        yield f"### Calibration: {group}"
        levels = [key.rpartition("_")[2] for key in some[0] if key.startswith(f"{QUANTITIES[0]}_coverage_")]

        def calibrated(row: Mapping[str, Any], levels=levels) -> str:
            parts = []
            for quantity in (QUANTITIES[0], QUANTITIES[2]):
                covered = "/".join(f"{100 * row[f'{quantity}_coverage_{level}']:.0f}" for level in levels)
                ratio = row[f"{quantity}_spread"] / max(row[f"{quantity}_error"], 1e-12)
                parts.append(f"{covered} %, {ratio:.2f}")
            return "; ".join(parts)

        columns = ["position; attitude at", *(f"{s:g} s" for s in _SECONDS)]
        caption = f"Coverage of {'/'.join(levels)} % and spread over error, of the position and of the attitude."
        yield Table(columns, _cells(some, calibrated), caption)


def _pictures(folder: Path, figures: Path) -> Iterator[Block]:
    for name, caption in _PICTURES.items():
        if (folder / f"{name}.png").is_file():
            figures.mkdir(parents=True, exist_ok=True)
            yield Picture(Path(shutil.copyfile(folder / f"{name}.png", figures / f"{name}.png")), caption)


def _grouped(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    groups: dict[str, list] = {}
    for row in rows:
        groups.setdefault(row["group"], []).append(row)
    return groups


def _cells(rows: Sequence[Mapping[str, Any]], say) -> list[list[str]]:
    models = dict.fromkeys(row["model"] for row in rows)
    at = {(row["model"], row["seconds"]): say(row) for row in rows}
    return [[model, *(at.get((model, s), "–") for s in _SECONDS)] for model in models]
