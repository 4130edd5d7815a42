"""What a finished run consists of: the SHA-256 and size of every file, in `manifest.json` at its root."""

import hashlib
import json
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

from owm_envs.files import inner_path, read_text, write_atomically
from owm_envs.hub import SOURCE

MANIFEST = "manifest.json"
BESIDE = (MANIFEST, SOURCE, "README.md")
"""What lies at the root and is no part of the run: where it was fetched from, and a card, which may be reworded."""


class Entry(NamedTuple):
    """What a manifest tells of a file."""

    sha256: str
    bytes: int

    @classmethod
    def of(cls, content: Path | bytes) -> "Entry":
        """What to tell of a file, or of what one is to hold."""
        if not isinstance(content, Path):
            return cls(hashlib.sha256(content).hexdigest(), len(content))
        with open(content, "rb") as file:
            return cls(hashlib.file_digest(file, "sha256").hexdigest(), content.stat().st_size)


def write_manifest(root: str | os.PathLike, besides: Collection[str] = ()) -> None:
    """List every file below a folder in its `manifest.json`.

    Left out are `BESIDE`, and files and folders whose names begin with a dot: half-written, or left by desktops.

    Args:
        besides: names of folders in it that are no part of the run.

    Raises:
        ValueError: a symbolic link or something else that is no plain file lies there.
    """
    root = Path(root)
    text = manifest_text({name: Entry.of(root / name) for name in _names(root, besides)})
    write_atomically(root / MANIFEST, lambda file: file.write(text), text=True)


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
        files = json.loads(read_text(path))["files"]
        entries = {str(name): Entry(str(told["sha256"]), int(told["bytes"])) for name, told in files.items()}
    except FileNotFoundError:
        raise FileNotFoundError(f"{Path(root)} has no {MANIFEST}, so nothing tells whether it is whole") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: {error!r}") from None
    for name in entries:
        inner_path(name)
    return entries


def check_manifest(root: str | os.PathLike, besides: Collection[str] = ()) -> None:
    """Compare a folder with its manifest, file by file.

    Args:
        besides: as `write_manifest` takes it.

    Raises:
        FileNotFoundError: there is no manifest.
        ValueError: the first difference: a file is missing, of another size or hash, or not listed.
    """
    for told in differences(root, besides):
        raise ValueError(told)


def differences(root: str | os.PathLike, besides: Collection[str] = ()) -> Iterator[str]:
    """Everything in which a folder differs from its manifest, in words.

    Args:
        besides: as `write_manifest` takes it.

    Raises:
        FileNotFoundError: there is no manifest.
        ValueError: it is damaged, or the folder holds what is no plain file.
    """
    root = Path(root)
    entries = load_manifest(root)
    there = set(_names(root, besides))
    for name in sorted(set(entries) - there):
        yield f"{root / name} is missing; {MANIFEST} lists it"
    for name in sorted(there - set(entries)):
        yield f"{root / name} is not listed in {MANIFEST}"
    for name in sorted(there & set(entries)):
        try:
            check_entry(root / name, entries[name])
        except ValueError as error:
            yield str(error)


def check_entry(path: Path, entry: Entry, *, content: bool = True) -> None:
    """Compare a file with what a manifest tells of it; the size first, which costs nothing.

    Args:
        content: look at the bytes too.

    Raises:
        ValueError: they differ.
    """
    if (size := path.stat().st_size) != entry.bytes:
        raise ValueError(f"{path} has {size:,} bytes, {MANIFEST} tells of {entry.bytes:,}: damaged, or changed since")
    if content and Entry.of(path).sha256 != entry.sha256:
        raise ValueError(f"{path} does not match its SHA-256 in {MANIFEST}: damaged, or changed since")


def _names(root: Path, besides: Collection[str]) -> Iterator[str]:
    """Paths of the files below a folder that are part of the run, "/" between their parts."""
    for folder, folders, files in os.walk(root):
        folders[:] = [n for n in folders if not (n.startswith(".") or (Path(folder) == root and n in besides))]
        for name in (*folders, *files):
            path = Path(folder, name)
            if path.is_symlink() or not (path.is_dir() or path.is_file()):
                raise ValueError(f"{path} is no plain file or folder: a run holds only these")
        for name in files:
            told = Path(folder, name).relative_to(root).as_posix()
            if not name.startswith(".") and told not in BESIDE:
                yield told
