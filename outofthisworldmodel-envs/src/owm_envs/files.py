"""Files and folders that are either whole or not there, and text as editors leave it."""

import codecs
import os
import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def write_atomically(path: str | os.PathLike, write: Callable[[Any], Any], *, text: bool = False) -> None:
    """Let `write` fill a file beside `path`, then move it into place; folders on the way are made.

    Args:
        write: takes the open file.
        text: open it as UTF-8 text instead of bytes.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with open(partial, "w", encoding="utf-8", newline="") if text else open(partial, "wb") as file:
            write(file)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16's, with which it begins
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def read_text(path: str | os.PathLike) -> str:
    """The text of a file that a person edits: UTF-8, or what its byte-order mark says, as Windows' editors write.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is neither.
    """
    data = Path(path).read_bytes()
    encoding = next((encoding for mark, encoding in _MARKS.items() if data.startswith(mark)), "utf-8")
    if encoding.startswith("utf-8") and b"\0" in data:
        # Of letters in UTF-16 every second byte is zero, in UTF-32 three of four.
        width = 32 if 2 * data.count(b"\0") > len(data) else 16
        order = "big" if data.startswith(b"\0") else "little"
        looks = f"UTF-{width} ({order}-endian) without a byte-order mark"
        raise ValueError(f"{os.fspath(path)} is not UTF-8 text but looks like {looks}: save it as UTF-8")
    try:
        return data.decode(encoding).replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"{os.fspath(path)} is not {encoding} text ({error.reason}): save it as UTF-8") from None


def output_folder(path: str | os.PathLike) -> Path:
    """Where results are to go, before any work is done for them: absolute, "~" and links followed.

    Raises:
        NotADirectoryError: the path, or what it lies in, is no folder.
        PermissionError: nothing can be written there.
    """
    folder = Path(path).expanduser().resolve()
    there = next(place for place in (folder, *folder.parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(f"{there} is no folder; choose another one to write to")
    if not os.access(there, os.W_OK | os.X_OK):
        raise PermissionError(f"{there} is not writable; choose another folder to write to")
    return folder


def publish(finished: Path, folder: Path) -> None:
    """Let a finished folder take the place of one that is not there, or empty.

    In one step, but where a folder has to stay what it is, as the current one and a mount do: its contents move then,
    JSON last, and the same call goes on where it was killed. What killed writers left in the middle goes.
    """
    for left in finished.rglob(".*.partial"):
        left.unlink()
    if folder.is_dir() and (folder == Path.cwd() or os.path.ismount(folder)):
        for child in sorted(finished.iterdir(), key=lambda child: child.suffix == ".json"):
            shutil.move(child, folder / child.name)
        finished.rmdir()
        return
    if folder.is_dir():
        folder.rmdir()
    os.replace(finished, folder)


def slug(name: str) -> str:
    """A name as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9-]+", "_", name).strip("_") or "policy"


def replace_folder(path: str | os.PathLike, contents: Mapping[str, bytes]) -> None:
    """Write a folder of files beside `path`, then move it into place; one that is there is replaced."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh, old = path.with_name(path.name + ".writing"), path.with_name(path.name + ".replaced")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir()
    for name, data in contents.items():
        (fresh / name).write_bytes(data)
    shutil.rmtree(old, ignore_errors=True)
    if path.exists():
        path.rename(old)
    fresh.rename(path)
    shutil.rmtree(old, ignore_errors=True)
