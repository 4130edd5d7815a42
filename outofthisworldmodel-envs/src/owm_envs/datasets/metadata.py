"""What must hold of the metadata of a docking dataset, before any row is read, and of all its episodes together."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from owm_envs.datasets.checks import OUTCOMES
from owm_envs.datasets.layout import Layout
from owm_envs.datasets.parse import read_rows, schema_of
from owm_envs.datasets.runs import GENERATION, Run
from owm_envs.datasets.schema import FEATURES, OBSERVATION, Feature
from owm_envs.datasets.statistics import QUANTILES, Statistics
from owm_envs.episode import Episode
from owm_envs.station.ports import PORT_NAMES
from owm_envs.words import short


def check_metadata(folder: Path, info: Mapping[str, Any], layout: Layout, run: Run) -> None:
    """Features, rate, tasks and files are as we write them, and counts as the run tells.

    Raises:
        FileNotFoundError, ValueError: one is not.
    """
    path, features, fps = folder / "meta" / "info.json", info["features"], info.get("fps")
    if missing := [name for name in FEATURES if name not in features]:
        raise ValueError(f"{path} lacks the features {', '.join(missing)}; it has {', '.join(features)}")
    for name, told in features.items():
        feature, wanted = Feature(told["dtype"], tuple(told["shape"])), FEATURES.get(name)
        if wanted is not None and feature[:2] != wanted[:2]:
            raise ValueError(f"{path}: {name} must be {wanted.dtype} {wanted.shape}, got {feature[0]} {feature[1]}")
        if wanted is None and not name.startswith(OBSERVATION):
            raise ValueError(f"{path}: a further feature must be a part of the observation, got {name!r}")
        if feature.dtype == "video":
            frame_size(name, told)
        if wanted is not None and told.get("names") != wanted.names:
            raise ValueError(
                f"{path}: the numbers of {name} must be called {wanted.names}, got {short(told.get('names'))}"
            )
    for name, wanted in (("total_tasks", len(PORT_NAMES)), ("splits", {"train": f"0:{len(layout)}"})):
        if info.get(name, wanted) != wanted:
            raise ValueError(f"{path}: {name} must be {wanted}, got {short(info[name])}")
    if not fps:
        raise ValueError(f"{path}: fps must be a number above 0, got {fps!r}")
    if run.config is not None and abs(fps * run.config.decision_dt - 1) > 1e-6:
        raise ValueError(f"{path}: fps must be {1 / run.config.decision_dt:g} as the run was configured, got {fps:g}")
    if not any((folder / "meta" / "episodes").rglob("*.parquet")):
        raise FileNotFoundError(f"{folder / 'meta' / 'episodes'} is missing")
    _check_counts(folder, layout, run)
    if surplus := sorted(set((folder / "data").rglob("*.parquet")) - set(layout.files)):
        raise ValueError(f"{surplus[0]} belongs to no episode that meta/episodes tells of")
    _check_tasks(folder / "meta" / "tasks.parquet")


def check_columns(path: Path, features: Mapping[str, Mapping[str, Any]]) -> None:
    """A data file has the columns that `info.json` tells of, in their types, and no other.

    Raises:
        ValueError: it has not.
    """
    told = {name: feature for name, feature in features.items() if feature["dtype"] != "video"}
    schema = schema_of(path)
    if missing := [name for name in told if name not in schema.names]:
        raise ValueError(f"{path} lacks the columns {', '.join(missing)}; it has {', '.join(schema.names)}")
    if surplus := [name for name in schema.names if name not in told]:
        raise ValueError(f"{path} has the columns {', '.join(surplus)}, of which info.json tells nothing")
    for name, feature in told.items():
        kind, shape = schema.field(name).type, []
        while hasattr(kind, "value_type"):
            shape.append(getattr(kind, "list_size", None))
            kind = kind.value_type
        wanted = [] if feature["shape"] == [1] else feature["shape"]
        fits = len(shape) == len(wanted) and all(a in (None, b) for a, b in zip(shape, wanted))
        name_of_kind = {"float": "float32", "double": "float64", "halffloat": "float16"}.get(str(kind), str(kind))
        if name_of_kind != feature["dtype"] or not fits:
            came = f"{name_of_kind} {shape}" if shape else name_of_kind
            raise ValueError(f"{path}: {name} must be {feature['dtype']} {wanted}, got {came}")


def tallies(episodes: Iterable[Episode]) -> dict[str, Counter[str]]:
    """How many episodes each policy flew, each port was the goal of, and each outcome ended."""
    kinds = [(e.policy_name, PORT_NAMES[e.port], OUTCOMES[e.outcome]) for e in episodes]
    return {what: Counter(kind[i] for kind in kinds) for i, what in enumerate(("policies", "ports", "outcomes"))}


def check_tallies(folder: Path, run: Run, found: Mapping[str, Counter[str]]) -> None:
    """All episodes of a split are flown by, to, and ended as the run tells.

    Raises:
        ValueError: policies, ports or outcomes are others.
    """
    told = run.results()
    for what, tally in found.items():
        if told and all(result.get(what, tally) != tally for result in told):
            path = run.root / GENERATION
            raise ValueError(f"{folder} holds the {what} {dict(tally)}; {path} tells of {told[0][what]}")


def statistics_of(path: Path, stored: Any) -> Statistics:
    """Statistics as arrays of finite numbers, in order where there is one.

    Raises:
        ValueError: they are not.
    """
    if not isinstance(stored, Mapping) or not all(isinstance(part, Mapping) for part in stored.values()):
        raise ValueError(f"{path} does not hold statistics: a table of numbers for each column")
    return {name: {key: _numbers(path, name, key, part) for key in part} for name, part in stored.items()}


def pooled(parts: Sequence[Statistics]) -> Statistics:
    """The moments of all episodes together, from those of each: all that version 2.1 keeps.

    Raises:
        ValueError: they are not of the same columns, or one lacks a moment.
    """
    found: Statistics = {}
    for name in parts[0]:
        try:
            low, high, mean, std, count = (
                np.stack([part[name][key] for part in parts]) for key in ("min", "max", "mean", "std", "count")
            )
        except (KeyError, ValueError):
            raise ValueError(f"the episodes' statistics of {name} must each have min, max, mean, std, count") from None
        if not (count.sum(axis=0) > 0).all():
            raise ValueError(f"the episodes' statistics of {name} must count at least one row")
        share = (count / count.sum(axis=0)).reshape(len(parts), *[1] * (mean.ndim - 1))
        together = np.sum(share * mean, axis=0)
        with np.errstate(over="ignore"):
            spread = np.sqrt(np.sum(share * (std**2 + (mean - together) ** 2), axis=0))
        found[name] = {"min": low.min(0), "max": high.max(0), "mean": together, "std": spread, "count": count.sum(0)}
    return found


def check_statistics(path: Path, statistics: Statistics, features: Mapping[str, Mapping[str, Any]]) -> None:
    """There are statistics of each column, of as many numbers as it has.

    Raises:
        ValueError: there are not.
    """
    for name, feature in features.items():
        width = int(np.prod(feature["shape"]))
        for key in ("min", "max", "mean", "std", "count", *QUANTILES) if feature["dtype"] != "video" else ():
            numbers, wanted = statistics.get(name, {}).get(key), 1 if key == "count" else width
            if numbers is None or numbers.size != wanted:
                came = "none" if numbers is None else numbers.size
                raise ValueError(f"{path}: {key} of {name} must be {wanted} numbers, got {came}")
        if feature["dtype"] != "video":
            _check_order(path, name, statistics[name])


def _check_order(path: Path, name: str, part: Mapping[str, np.ndarray]) -> None:
    """Statistics are those of some rows: each lies where the others leave it room."""
    low, high, mean, std = (part[key].astype(np.float64).reshape(-1) for key in ("min", "max", "mean", "std"))
    slack = 1e-6 * np.maximum(np.maximum(np.abs(low), np.abs(high)), 1e-3)
    ordered = [low, *(part[key].astype(np.float64).reshape(-1) for key in QUANTILES), high]
    sound = all((one <= other + slack).all() for one, other in pairwise(ordered))
    sound &= bool(((mean >= low - slack) & (mean <= high + slack) & (std <= (high - low) / 2 + slack)).all())
    if not sound or part["count"].reshape(-1)[0] < 1:
        raise ValueError(f"{path}: the statistics of {name} must be those of at least one row, min to max in order")


def _numbers(path: Path, name: str, key: str, part: Mapping[str, Any]) -> np.ndarray:
    try:
        numbers = np.asarray(part[key])
    except (ValueError, OverflowError):
        numbers = np.zeros(0, object)
    if numbers.dtype.kind not in "iufb" or not np.isfinite(numbers).all():
        raise ValueError(f"{path}: {key} of {name} must be finite numbers, got {str(part[key])[:60]}")
    if key in ("std", "count") and (numbers < 0).any():
        raise ValueError(f"{path}: {key} of {name} must be at least 0, got {str(part[key])[:60]}")
    return numbers


def frame_size(name: str, feature: Mapping[str, Any]) -> tuple[int, int]:
    """Rows and columns of a video's frames, whose axes may come in either order.

    Raises:
        ValueError: it has no three channels.
    """
    shape, names = feature["shape"], feature.get("names")
    first = isinstance(names, list) and names[:1] in (["channel"], ["channels"])
    if len(shape) != 3 or min(shape) < 1 or shape[0 if first else 2] != 3:
        raise ValueError(f"the video {name} must have the shape [height, width, 3], got {shape}")
    return (shape[1], shape[2]) if first else (shape[0], shape[1])


def _check_counts(folder: Path, layout: Layout, run: Run) -> None:
    found = {"episodes": len(layout), "transitions": int(layout.rows.sum()) - len(layout)}
    ports = Counter(name for name in PORT_NAMES for task in layout.tasks if name.replace("_", " ") in str(task))
    if layout.tasks:
        found["ports"] = dict(ports)
    told = run.results()
    if not told or any(all(result.get(name) == n for name, n in found.items()) for result in told):
        return
    name, result = next((n, r.get(n)) for r in told for n in found if r.get(n) != found[n])
    raise ValueError(f"{folder} holds {found[name]} {name}; {run.root / GENERATION} tells of {result}")


def _check_tasks(path: Path) -> None:
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing")
    names = schema_of(path).names
    text = [name for name in names if name != "task_index"]
    if "task_index" not in names or len(text) != 1:
        raise ValueError(f"{path} must have task_index and its text, got {', '.join(names)}")
    table = read_rows(path, names)
    told = list(zip(table["task_index"].tolist(), map(str, table[text[0]])))
    wanted = [(number, port.replace("_", " ")) for number, port in enumerate(PORT_NAMES)]
    if len(told) != len(wanted) or any(a[0] != b[0] or b[1] not in a[1] for a, b in zip(told, wanted)):
        raise ValueError(f"{path} must name the {len(wanted)} ports in their order, got {told}")
