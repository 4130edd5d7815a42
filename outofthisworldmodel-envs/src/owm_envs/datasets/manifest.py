"""What a finished run consists of: the SHA-256 and size of every file, in `manifest.json` at its root."""

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from owm_envs.files import inner_path, write_atomically

MANIFEST = "manifest.json"
SOURCE = "source.json"
"""Where a download notes what it came from: of no run, like everything whose name begins with a dot."""


class Entry(NamedTuple):
    """What a manifest tells of a file."""

    sha256: str
    bytes: int


def write_manifest(root: str | os.PathLike) -> None:
    """List every file below a folder in its `manifest.json`.

    Files and folders whose names begin with a dot are left out: half-written files, and what desktops leave.

    Raises:
        ValueError: a symbolic link or something else that is no plain file lies there.
    """
    root = Path(root)
    store_manifest(root / MANIFEST, {name: entry_of(root / name) for name in sorted(_names(root))})


def store_manifest(path: Path, entries: dict[str, Entry]) -> None:
    """Write these entries, by their paths below the manifest's own folder."""
    write_atomically(path, lambda file: file.write(manifest_text(entries)), text=True)


def manifest_text(entries: dict[str, Entry]) -> str:
    """The text of a manifest with these entries."""
    files = {name: entries[name]._asdict() for name in sorted(entries)}
    return json.dumps({"files": files}, indent=1) + "\n"


def load_manifest(root: str | os.PathLike) -> dict[str, Entry]:
    """Read what the manifest of a folder lists, by paths below it, "/" between their parts.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is damaged, or names a path that leaves the folder.
    """
    path = Path(root) / MANIFEST
    try:
        files = json.loads(path.read_text(encoding="utf-8"))["files"]
        entries = {str(name): Entry(str(told["sha256"]), int(told["bytes"])) for name, told in files.items()}
    except FileNotFoundError:
        raise FileNotFoundError(f"{Path(root)} has no {MANIFEST}, so nothing tells whether it is whole") from None
    except (UnicodeDecodeError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged: {error!r}") from None
    for name in entries:
        inner_path(name)
    return entries


def check_manifest(root: str | os.PathLike) -> None:
    """Compare a folder with its manifest, file by file.

    Raises:
        FileNotFoundError: there is no manifest.
        ValueError: the first difference: a file is missing, of another size or hash, or not listed.
    """
    root = Path(root)
    entries = load_manifest(root)
    there = set(_names(root))
    if missing := sorted(set(entries) - there):
        raise ValueError(f"{root / missing[0]} is missing; {MANIFEST} lists it")
    if surplus := sorted(there - set(entries)):
        raise ValueError(f"{root / surplus[0]} is not listed in {MANIFEST}")
    for name, entry in sorted(entries.items()):
        check_entry(root / name, entry)


def check_entry(path: Path, entry: Entry) -> None:
    """Compare a file with what a manifest tells of it; the size first, which costs nothing.

    Raises:
        ValueError: they differ.
    """
    if (size := path.stat().st_size) != entry.bytes:
        raise ValueError(f"{path} has {size:,} bytes, {MANIFEST} tells of {entry.bytes:,}: damaged, or changed since")
    if entry_of(path).sha256 != entry.sha256:
        raise ValueError(f"{path} does not match its SHA-256 in {MANIFEST}: damaged, or changed since")


def entry_of(path: Path) -> Entry:
    """Hash and size of a file."""
    with open(path, "rb") as file:
        return Entry(hashlib.file_digest(file, "sha256").hexdigest(), path.stat().st_size)


def _names(root: Path) -> Iterator[str]:
    """Paths of the files below a folder that are part of the run, "/" between their parts."""
    for folder, folders, files in os.walk(root):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in (*folders, *files):
            path = Path(folder, name)
            if path.is_symlink() or not (path.is_dir() or path.is_file()):
                raise ValueError(f"{path} is no plain file or folder: a run holds only these")
        for name in files:
            told = Path(folder, name).relative_to(root).as_posix()
            if not name.startswith(".") and told not in (MANIFEST, SOURCE):
                yield told
