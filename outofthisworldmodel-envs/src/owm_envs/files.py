"""Files and folders that are either whole or not there, and text as editors leave it."""

import codecs
import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping
from hashlib import file_digest, sha256
from pathlib import Path, PurePosixPath
from typing import Any

try:
    import fcntl
except ImportError:  # Windows, where nobody can remove what another has open
    fcntl = None

JOURNAL = ".publishing"
"""Lies in a finished folder while its contents move out of it one by one, and names them."""
LOCK = ".lock"
"""Lies in a folder that a process works in, or has worked in."""
_LEFT = re.compile(r"\.(.+)\.\d+\.partial")
"""Names of what is being written, or was when its writer was killed; the group is the name that it is to get."""
MOST_BYTES = 2**28
"""Of a file that a person names: a larger one is a mistake."""


@contextlib.contextmanager
def staged(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """An empty file or folder beside `path`, to be filled and moved there; what is left of it in the end goes.

    Once that is done, so does what killed writers left of the same. What living ones are at is locked, and stays.
    """
    while True:
        partial = path.with_name(f".{path.name}.{secrets.randbits(62)}.partial")
        partial.mkdir() if folder else partial.touch(exist_ok=False)
        with _locked(partial, wait=True):
            if not partial.exists():  # taken for left before it was locked
                continue
            try:
                yield partial
            finally:
                remove(partial)
            break
    # Not before: what was left of a folder may be the last whole one.
    for left in [place for place in os.listdir(path.parent) if (was := _LEFT.fullmatch(place)) and was[1] == path.name]:
        with contextlib.suppress(OSError), _locked(path.parent / left):
            remove(path.parent / left)


@contextlib.contextmanager
def _locked(path: Path, *, wait: bool = False) -> Iterator[None]:
    """Hold a file or folder; OSError if another does, unless it is to be waited for."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError) if wait else contextlib.nullcontext():  # some file systems have no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        os.close(descriptor)


def settle(path: Path) -> None:
    """Have the bytes of a file, or of all files below a folder, on the disk: before a name leads to them."""
    for file in [path] if path.is_file() else path.rglob("*"):
        if file.is_file():
            with open(file, "r+b" if os.name == "nt" else "rb") as opened:
                os.fsync(opened.fileno())


def write_atomically(path: str | os.PathLike, write: Callable[[Any], Any], *, text: bool = False) -> None:
    """Let `write` fill a file beside `path`, then move it into place; folders on the way are made, links followed.

    Args:
        write: takes the open file.
        text: open it as UTF-8 text instead of bytes.
    """
    path = Path(path).resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    with staged(path) as partial:
        with open(partial, "w", encoding="utf-8", newline="") if text else open(partial, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)


_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16's, with which it begins
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def plain_file(path: str | os.PathLike, most: int = MOST_BYTES) -> Path:
    """The path of a file to read, once it is known to be one that has an end.

    Args:
        most: bytes that it may have.

    Raises:
        TypeError: it is no path: a number would be an open file of the process, 0 its standard input.
        FileNotFoundError, OSError: there is no such file.
        ValueError: it is a folder, a pipe or a device, or too large.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"a file must be given by its path, got {path!r}")
    try:
        about = os.stat(path)
    except ValueError as error:  # of a path that no system takes
        raise ValueError(f"{path!r} is no path: {error}") from None
    if not stat.S_ISREG(about.st_mode):
        kind = "a folder" if stat.S_ISDIR(about.st_mode) else "a pipe or device"
        raise ValueError(f"{os.fspath(path)} is {kind}, not a file: name one that is kept on disk")
    if about.st_size > most:
        raise ValueError(f"{os.fspath(path)} has {about.st_size:,} bytes; no such file has more than {most:,}")
    return Path(path)


def read_text(path: str | os.PathLike) -> str:
    """The text of a file that a person edits: UTF-8, or what its byte-order mark says, as Windows' editors write.

    Raises:
        TypeError, OSError, ValueError: as `plain_file`, or the file cannot be read.
        ValueError: it is neither.
    """
    data = plain_file(path).read_bytes()
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


def inner_path(name: str) -> PurePosixPath:
    """A path that was written elsewhere, "/" between its parts, once it is known to stay inside a folder everywhere.

    Raises:
        ValueError: it is absolute, goes up, or means something else on another system.
    """
    parts = name.split("/")
    odd = any(part in ("", ".", "..") or len(part.encode(errors="replace")) > 255 for part in parts)
    if not name or odd or re.search(r"[\\:\0]", name):
        raise ValueError(f"the path {name[:60]!r} may lead out of its folder: refused")
    return PurePosixPath(name)


def output_file(path: str | os.PathLike, suffix: str) -> Path:
    """Where a file is to go, before any work is done for it: absolute, "~" and links followed.

    Args:
        suffix: that its name must have, such as ".html".

    Raises:
        ValueError: it has another one, or is a folder's.
        NotADirectoryError, PermissionError: as `output_folder`.
    """
    path = Path(path).expanduser()
    if path.suffix.lower() != suffix or path.is_dir():
        raise ValueError(f"out must be the name of a file that ends in {suffix}, got {path}")
    return output_folder(path.parent) / path.name


class FolderTaken(FileExistsError, ValueError):
    """An output folder holds another run's results, or files of something else: told before any work is done."""


def strangers(folder: Path, known: Collection[str] = ()) -> list[str]:
    """What lies in a folder beside what is known to, a lock, and what a killed writer left half written."""
    if not folder.is_dir():
        return []
    return sorted(name for name in os.listdir(folder) if name not in {*known, LOCK} and not _LEFT.fullmatch(name))


def check_free(folder: Path, known: Collection[str] = ()) -> None:
    """Refuse a folder that holds anything but what is known to.

    Raises:
        FolderTaken: it does.
    """
    if others := strangers(folder, known):
        told = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
        raise FolderTaken(
            f"{folder} holds files of something else ({told}): choose another folder (--out), or remove them"
        )


def remove(path: Path) -> None:
    """Remove a file, a link or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def publish(finished: Path, folder: Path) -> None:
    """Let a finished folder take the place of one that is not there, or empty.

    In one step, but where a folder has to stay what it is, as the current one and a mount do: its contents move then,
    JSON last, and the same call goes on where it was killed. What killed writers left in the middle goes.

    Raises:
        FolderTaken: the folder holds something else.
    """
    if not any(finished.iterdir()):  # killed at the last step of all
        return finished.rmdir()
    names = published(finished)
    check_free(folder, names)
    for left in [*finished.rglob(".*.partial"), *folder.glob(".*.partial")]:
        if _LEFT.fullmatch(left.name):
            remove(left)
    if not names and not _stays(folder):
        if folder.is_dir():
            folder.rmdir()
        os.replace(finished, folder)
        return
    names = names or {child.name for child in finished.iterdir()}
    write_atomically(finished / JOURNAL, lambda file: file.write("\n".join(names)), text=True)
    for name in sorted(names, key=lambda name: name.endswith(".json")):
        if not (folder / name).exists():
            _move(finished / name, folder / name)
        remove(finished / name)  # where it was copied
    (finished / JOURNAL).unlink()
    finished.rmdir()


def published(finished: Path) -> set[str]:
    """Names of what a call of `publish` has begun to move out of a folder.

    Raises:
        ValueError: one of them is no name of something in that folder.
    """
    try:
        names = set((finished / JOURNAL).read_text(encoding="utf-8").splitlines())
    except OSError:
        return set()
    for name in names:
        if len(inner_path(name).parts) > 1:
            raise ValueError(f"{finished / JOURNAL} names {name!r}, which is not in its folder: refused")
    return names


def _move(source: Path, target: Path) -> None:
    """Move a file or folder, also to another disk: at its new place it is whole or not there."""
    try:
        os.rename(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with staged(target, folder=source.is_dir()) as partial:
            shutil.copytree(source, partial, dirs_exist_ok=True) if source.is_dir() else shutil.copy2(source, partial)
            settle(partial)
            os.rename(partial, target)


def _stays(folder: Path) -> bool:
    """Whether a folder cannot be exchanged for another: only its contents can."""
    if not folder.is_dir():
        return False
    return folder == Path.cwd() or os.path.ismount(folder) or not os.access(folder.parent, os.W_OK | os.X_OK)


def slug(name: str) -> str:
    """A name as part of a file's name: letters and digits of any script; several names may have the same."""
    return re.sub(r"[^\w-]+", "_", unicodedata.normalize("NFC", name)).strip("_") or "policy"


def fingerprint(path: Path) -> str | None:
    """SHA-256 of a file, or of a folder's files and their names, those that begin with a dot left out; else None."""
    if path.is_file():
        with open(path, "rb") as file:
            return file_digest(file, "sha256").hexdigest()
    if not path.is_dir():
        return None
    files = sorted(file for file in path.rglob("[!.]*") if file.is_file())
    told = [f"{fingerprint(file)} {file.relative_to(path).as_posix()}\n" for file in files]
    return sha256("".join(told).encode(errors="surrogateescape")).hexdigest()


def replace_folder(path: str | os.PathLike, contents: Mapping[str, bytes]) -> Path:
    """Write a folder of files, whole or not at all, in place of none, an empty one, or one that holds only such files.

    Where a folder has to stay what it is, as the current one and a mount do, each file is whole or not there.

    Returns:
        Where it is: "~" and links followed.

    Raises:
        NotADirectoryError, PermissionError: as `output_folder`.
        FolderTaken: the folder holds other files, which stay.
    """
    folder = output_folder(path)
    check_free(folder, contents)
    if _stays(folder):
        for name, data in contents.items():
            write_atomically(folder / name, lambda file, data=data: file.write(data))
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with staged(folder, folder=True) as stage:
        new, old = stage / "new", stage / "old"
        new.mkdir()
        for name, data in contents.items():
            (new / name).write_bytes(data)
        settle(new)
        try:
            if folder.exists():
                os.rename(folder, old)
            os.rename(new, folder)
        finally:
            if old.exists() and not folder.exists():
                os.rename(old, folder)
    return folder
