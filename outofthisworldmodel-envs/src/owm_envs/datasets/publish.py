"""A finished run as repositories of the hub: what goes where, its card and its tag."""

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from owm_envs import hub
from owm_envs.config import load_config
from owm_envs.datasets.card import dataset_card
from owm_envs.datasets.fetch import RUN_FILES
from owm_envs.datasets.manifest import MANIFEST, Entry, check_manifest, load_manifest, manifest_text
from owm_envs.datasets.recipe import Request
from owm_envs.datasets.runs import GENERATION, run_of
from owm_envs.datasets.schema import CODEBASE_VERSION, OBSERVATION, part_columns
from owm_envs.files import read_text
from owm_envs.hub import Repository
from owm_envs.words import plain

PICTURE = "flights.png"
_PATHS = 24
"""Flights in the picture of a split, of those in its first file."""


def repositories(run: str | os.PathLike, name: str, *, together: bool = False) -> list[Repository]:
    """What to push of a run, once it is known to be whole: nothing is sent.

    Args:
        run: folder that `owm-envs generate` finished.
        name: `user/name`.
        together: one repository with the splits in folders, else `user/name-train` and `user/name-val`, each a
            LeRobot dataset of its own.

    Raises:
        FileNotFoundError, ValueError: there is no such run, it is not finished, or differs from its manifest.
    """
    hub.checked_name(name)
    folder = Path(run).expanduser().resolve()
    told = _finished(folder)
    listed = load_manifest(folder)
    splits = [split for split in told["result"] if f"{split}/meta/info.json" in listed]
    if together:
        files = {path: folder / path for path in listed}
        files |= _described(folder, told, name, splits, None)
        return [_repository(name, _with_manifest(files, listed), splits)]
    made = []
    for split in splits:
        inside = {path.removeprefix(f"{split}/"): path for path in listed if path.startswith(f"{split}/")}
        inside |= {path: path for path in RUN_FILES if path in listed}
        # A split that was fetched brings its own card and picture: they are made anew.
        inside = {path: place for path, place in inside.items() if path not in ("README.md", PICTURE)}
        called = f"{name}-{split}"
        files = {path: folder / place for path, place in inside.items()}
        files |= _described(folder, told, called, [split], split)
        known = {path: listed[place] for path, place in inside.items()}
        folders = sorted({path.split("/")[0] for path in files if "/" in path})
        made.append(_repository(called, _with_manifest(files, known), folders))
    return made


def _repository(name: str, files: dict[str, Path | bytes], folders: Iterable[str]) -> Repository:
    message = "Episodes recorded by owm-envs generate"
    # LeRobot reads the commit that its format's version is the tag of.
    return Repository(name, "dataset", files, message, tuple(folders), CODEBASE_VERSION)


def _finished(folder: Path) -> dict[str, Any]:
    """What a run tells of itself, once it is known to be finished and whole."""
    partial = folder.with_name(folder.name + ".partial")
    again = "run the same `owm-envs generate` again, which finishes it"
    if not folder.is_dir():
        unfinished = f"; {partial} is unfinished: {again}" if partial.is_dir() else ""
        raise FileNotFoundError(f"there is no run at {folder}{unfinished}")
    if folder.name.endswith(".partial") or partial.is_dir():
        raise ValueError(f"{folder} is not finished: {again}")
    try:
        told = json.loads(read_text(folder / GENERATION))
        Request(**told["request"]), dict(told.get("versions") or {}), run_of(folder)
        finished = isinstance(told["result"], dict)
    except (OSError, ValueError, KeyError, TypeError):
        finished = False
    if not finished:
        raise ValueError(f"{folder} is no finished run, for its {GENERATION} tells of no result: {again}")
    try:
        check_manifest(folder)
    except (FileNotFoundError, ValueError) as error:
        raise ValueError(f"nothing was sent, for {folder} is not what was recorded: {plain(error)}") from None
    return told


def _described(
    folder: Path, told: Mapping[str, Any], name: str, splits: list[str], alone: str | None
) -> dict[str, Path | bytes]:
    """The card and its picture."""
    from owm_envs.datasets.picture import flights_picture

    paths = [path for split in splits for path in _paths(folder / split)]
    features = json.loads(read_text(folder / splits[0] / "meta" / "info.json"))["features"]
    parts = {
        column: SimpleNamespace(shape=tuple(features[column]["shape"]), dtype=features[column]["dtype"])
        for column in part_columns(features)
    }
    card = dataset_card(
        load_config(folder / "config.toml"),
        told["request"],
        told["result"],
        {column.removeprefix(OBSERVATION): part for column, part in parts.items()},
        name=name,
        split=alone,
        picture=PICTURE,
        sensors=told.get("sensors"),
        versions=told.get("versions"),
    )
    return {"README.md": card.encode(), PICTURE: flights_picture(paths)}


def _paths(split: Path) -> list[Any]:
    """Where the first flights of a split went."""
    import pyarrow.parquet as pq

    from owm_envs.datasets.picture import Path as Flown

    file = min((split / "data").glob("chunk-*/file-*.parquet"))
    table = pq.read_table(file, columns=["observation.environment_state", "episode_index", "port"])
    states = table["observation.environment_state"].combine_chunks()
    places = states.flatten().to_numpy(zero_copy_only=False).reshape(len(table), -1)[:, :3]
    index, ports = table["episode_index"].to_numpy(), table["port"].to_numpy()
    starts = np.flatnonzero(np.diff(index, prepend=index[:1] - 1))[:_PATHS]
    ends = np.append(np.flatnonzero(np.diff(index)) + 1, len(index))[: len(starts)]
    return [Flown(places[start:end], int(ports[start])) for start, end in zip(starts, ends, strict=True)]


def _with_manifest(files: dict[str, Path | bytes], known: Mapping[str, Entry]) -> dict[str, Path | bytes]:
    """These files, and the manifest of all but the card."""
    entries = {
        path: known[path] if path in known and isinstance(content, Path) else Entry.of(content)
        for path, content in files.items()
        if path != "README.md"
    }
    return files | {MANIFEST: manifest_text(entries).encode()}
