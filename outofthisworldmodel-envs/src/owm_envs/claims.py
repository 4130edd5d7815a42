"""Whose an output folder is: a run claims one, finds its own again, and is refused another's."""

import contextlib
import json
import os
from collections.abc import Collection, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from owm_envs.files import (
    LOCK,
    FolderTaken,
    check_free,
    fingerprint,
    output_folder,
    read_text,
    remove,
    write_atomically,
)


class Claim:
    """A run's hold on its output folder: a JSON file there tells what was asked for, and what the run noted since.

    What is found there is input, perhaps from elsewhere: no link may lead out of the folder, no path is taken from the
    file, and what was sealed is compared with its digest before it is used. As a context it keeps other processes out;
    the system lets them in when this one ends, however it ends. Nothing is written before it is entered, or noted in.

    Args:
        path: of the folder: new, empty, or one that an earlier start of the same run claimed.
        asked: all that tells two runs apart, JSON-able.
        marker: name of the file.
        besides: names of what may lie in a folder that is not claimed yet.
        made: names of what the run makes there, which `start_over` removes.
        facts: forms of what it notes, to tell a damaged file: types, or tables of them in which ... is every name.
        replace: start over where another run's results are, instead of refusing them.
        renew: start over where the file is damaged, instead of refusing.
        instead: what else a user may do who is refused.

    Attributes:
        folder: where it is: "~" and links followed.
        found: what the file tells; None until the folder is claimed.

    Raises:
        NotADirectoryError, PermissionError: as `output_folder`.
        FolderTaken: the folder holds another run's results, files of something else, or a link that leads out of it;
            on entering, that another process is at work there.
    """

    def __init__(
        self,
        path: str | os.PathLike,
        asked: Mapping[str, Any],
        marker: str = "run.json",
        *,
        besides: Collection[str] = (),
        made: Collection[str] = (),
        facts: Mapping[Any, Any] | None = None,
        replace: bool = False,
        renew: bool = False,
        instead: str = "or remove it",
    ):
        self.folder = output_folder(path)
        self.file, self.made = self.folder / marker, made
        self.asked = json.loads(json.dumps(asked))
        self.found: dict[str, Any] | None = None
        self._besides, self._facts, self._instead = besides, {"sha256": {...: str}, **(facts or {})}, instead
        self._replace, self._renew = replace, renew
        self._stale = False
        self._sound: dict[str, str] = {}
        self._lock: FileLock | None = None
        self.look()

    def look(self) -> None:
        """Read the file again, which another process may have written since; raises as the constructor does."""
        self.found, self._stale = None, False
        if not self.file.exists():
            check_free(self.folder, self._besides)
        if self._besides or self.file.exists():
            _check_links(self.folder)
        if not self.file.exists():
            return
        try:
            found = json.loads(read_text(self.file))
        except (ValueError, RecursionError):
            found = None
        if damaged := not self._is_sound(found):
            why = f"{self.folder} holds a run whose {self.file.name} is damaged"
        elif differ := list(_differences(self.asked, found)):
            why = f"{self.folder} holds another run, which differs in {', '.join(differ[:4])}"
        else:
            self.found = found
            return
        self._stale = self._replace or (self._renew and damaged)
        if not self._stale:
            raise FolderTaken(f"{why}: choose another folder (--out), {self._instead}")

    def _is_sound(self, found: Any) -> bool:
        """Whether this is a file of ours, and its facts have their forms."""
        if not (found and isinstance(found, dict)):
            return False
        return all(_fits(found[name], form) for name, form in self._facts.items() if name in found)

    def __enter__(self) -> "Claim":
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = FileLock(self.folder / LOCK, timeout=0)
        try:
            self._lock.acquire()
        except Timeout:
            raise FolderTaken(
                f"another process is at work in {self.folder}: wait for it, or choose another folder (--out)"
            ) from None
        try:
            self.look()
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._lock.release()
        if not self.file.exists():  # nothing has come of it
            with contextlib.suppress(OSError):
                remove(self.folder / LOCK)
                self.folder.rmdir()

    def note(self, **facts: Any) -> None:
        """Mark the folder as this run's, with facts to be found when it is resumed."""
        if self._stale:
            self.start_over()
        self.found = {**self.asked, **(self.found or {}), **facts}
        text = json.dumps(self.found, indent=2) + "\n"
        write_atomically(self.file, lambda file: file.write(text), text=True)

    def seal(self, *names: str, **facts: Any) -> None:
        """Note facts, and digests of files and folders that now lie in this one."""
        digests = {name: digest for name in names if (digest := fingerprint(self.folder / name))}
        self.note(sha256={**(self.found or {}).get("sha256", {}), **digests}, **facts)

    def holds(self, *names: str) -> bool:
        """Whether files and folders are there as they were sealed; each is read once."""
        digests = (self.found or {}).get("sha256", {})
        return all(name in digests and self._is(name, digests[name]) for name in names)

    def _is(self, name: str, digest: str) -> bool:
        if self._sound.get(name) != digest and fingerprint(self.folder / name) == digest:
            self._sound[name] = digest
        return self._sound.get(name) == digest and (self.folder / name).exists()

    def start_over(self) -> None:
        """Remove what an earlier start has made, and its claim; files of others stay."""
        for name in [*self.made, self.file.name]:
            remove(self.folder / name)
        self.found, self._stale, self._sound = None, False, {}


def _check_links(folder: Path) -> None:
    """Refuse a folder whose links would let a run read, write or remove what lies elsewhere.

    Raises:
        FolderTaken: there is one.
    """
    for place, folders, files in os.walk(folder):
        for path in (Path(place, name) for name in (*folders, *files)):
            if path.is_symlink() and not Path(os.path.realpath(path)).is_relative_to(folder):
                raise FolderTaken(
                    f"{path} is a link that leads out of its run: put there what it leads to, or remove it"
                )


def _fits(value: Any, form: Any) -> bool:
    """Whether a JSON value has a form: a type, or a table of forms, beside which others may be there."""
    if not isinstance(form, Mapping):
        return form is object or (isinstance(value, form) and not isinstance(value, bool))
    if not (isinstance(value, dict) and value.keys() >= form.keys() - {...}):
        return False
    return all(_fits(each, form.get(name, form.get(..., object))) for name, each in value.items())


def digest(asked: Mapping[str, Any]) -> str:
    """Fingerprint of what was asked for."""
    return sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def _differences(asked: Any, found: Any, name: str = "") -> Iterator[str]:
    """Dotted names of the settings in which two runs differ."""
    if isinstance(asked, dict) and isinstance(found, dict):
        for key, value in asked.items():
            yield from _differences(value, found.get(key), f"{name}.{key}" if name else key)
    elif asked != found:
        yield name
