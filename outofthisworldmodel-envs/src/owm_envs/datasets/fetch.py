"""Datasets by name: a folder, or a repository of the hub, in the cache or in a folder of its own."""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from owm_envs import hub
from owm_envs.datasets.manifest import MANIFEST, Entry, check_manifest, load_manifest, manifest_text
from owm_envs.datasets.recipe import SPLITS
from owm_envs.datasets.runs import GENERATION
from owm_envs.files import read_text
from owm_envs.hub import SOURCE, Fetched
from owm_envs.hub_client import HubError, NoRepository, Unreachable

RUN_FILES = (GENERATION, "config.toml")
"""What tells of the run as a whole, in the folder of the splits; a split's own repository has copies."""


def local_dataset(source: str | os.PathLike) -> Path:
    """The folder of a dataset, which is fetched into the cache first if it is one of the hub's.

    Where the hub has no repository `user/name`, `user/name-train` and `user/name-val` are taken for its splits.

    Args:
        source: a folder, or `user/name` with an optional `@revision` (branch, tag or commit).

    Raises:
        FileNotFoundError: it is neither, or the hub does not give it.
        ValueError: what came differs from the manifest that came with it.
        ImportError: the hub's client is not installed.
    """
    named = hub.parse(source)
    if named is None:
        return Path(source)
    try:
        parts = _fetched(*named)
    except HubError as error:
        told = (
            f"there is no dataset at {os.fspath(source)}: neither a folder nor found on the hub, which {error.reason}"
        )
        raise FileNotFoundError(told) from error
    if "" in parts:
        return parts[""].folder
    commits = "-".join(part.commit for part in parts.values())
    folder = hub.cache() / f"datasets--{named[0].replace('/', '--')}" / commits
    if not folder.is_dir():
        note = hub.source_note("dataset", _commits(parts))
        hub.keep(_contents(parts) | {SOURCE: note}, folder, _check)
    return folder


def download(
    source: str,
    out: str | os.PathLike,
    revision: str | None = None,
    announce: Callable[[str], None] = lambda text: None,
) -> dict[str, str]:
    """Copy a dataset of the hub to a folder, whole or not at all; a killed call is resumed by the same one.

    Args:
        source: as `local_dataset` takes it.
        out: new or empty; one that holds this very dataset is checked anew.
        revision: branch, tag or commit, if `source` names none; the main branch by default.
        announce: told in words what has been found.

    Returns:
        The commit of each repository that it came from.

    Raises:
        ValueError: `source` is no repository's name, or what came differs from its manifest.
        FolderTaken: `out` holds something else.
        NoRepository, Unreachable, HubError, ImportError, OSError: as `owm_envs.hub.fetch` and `deliver`.
    """
    name, _, at = source.partition("@")
    parts = _fetched(hub.checked_name(name), at or revision, again=True)
    commits, contents = _commits(parts), _contents(parts)
    folder, was_there = hub.deliver(contents, out, "dataset", commits, _check)
    if was_there:
        announce(f"{folder} holds it already, and is whole")
    if MANIFEST not in contents:
        announce(f"{name} brings no {MANIFEST}: checked by the hub's own hashes only")
    return commits


def origin(folder: str | os.PathLike) -> str | None:
    """The repository and commit that a folder was fetched from, or None."""
    try:
        told = json.loads(read_text(Path(folder) / SOURCE))["repositories"]
        return ", ".join(f"{name}@{commit}" for name, commit in told.items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _fetched(name: str, revision: str | None, again: bool = False) -> dict[str, Fetched]:
    """The repositories of a dataset by the folders they make: "" for one that has everything, else the splits."""
    how = {"kind": "dataset", "check": _check, "again": again}
    try:
        return {"": hub.fetch(name, revision, **how)}
    except (NoRepository, Unreachable) as error:
        try:
            return {split: hub.fetch(f"{name}-{split}", revision, **how) for split in SPLITS}
        except (NoRepository, Unreachable) as other:
            missing = isinstance(error, NoRepository) and isinstance(other, Unreachable)
            raise (other if missing else error) from None


def _commits(parts: Mapping[str, Fetched]) -> dict[str, str]:
    return {part.name: part.commit for part in parts.values()}


def _contents(parts: Mapping[str, Fetched]) -> dict[str, Path | bytes]:
    """The files of a dataset by their paths in it; of splits put together as they were when they were recorded."""
    files: dict[str, Path | bytes] = {}
    listed: dict[str, dict] = {}
    for split, part in parts.items():
        for file in sorted(part.folder.rglob("*")):
            name = file.relative_to(part.folder).as_posix()
            if file.is_dir() or name == SOURCE:
                continue
            if split and name == MANIFEST:
                listed[split] = load_manifest(part.folder)
            elif split and name not in RUN_FILES:
                files[f"{split}/{name}"] = file
            else:
                files.setdefault(name, file)
    if listed and len(listed) == len(parts):
        entries = {
            name if name in RUN_FILES else f"{split}/{name}": entry
            for split, names in listed.items()
            for name, entry in names.items()
        }
        for name, file in files.items():  # cards are listed in no split's own manifest
            if name not in entries:
                entries[name] = Entry.of(file)
        files[MANIFEST] = manifest_text(entries).encode()
    return files


def _check(folder: Path) -> None:
    """Compare a folder with its manifest, if it has one."""
    if (folder / MANIFEST).is_file():
        check_manifest(folder)
