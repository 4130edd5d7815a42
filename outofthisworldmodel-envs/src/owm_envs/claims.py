"""Whose an output folder is: a run claims one, finds its own again, and is refused another's."""

import json
import os
from collections.abc import Collection, Iterator, Mapping
from hashlib import sha256
from typing import Any

from owm_envs.files import FolderTaken, check_free, output_folder, read_text, remove, write_atomically


class Claim:
    """A run's hold on its output folder: a JSON file there tells what was asked for, and what the run noted since.

    Nothing is written before the first `note`.

    Args:
        path: of the folder: new, empty, or one that an earlier start of the same run claimed.
        asked: all that tells two runs apart, JSON-able.
        marker: name of the file.
        besides: names of what may lie in a folder that is not claimed yet.
        made: names of what the run makes there, which `start_over` removes.
        replace: start over where another run's results are, instead of refusing them.
        instead: what else a user may do who is refused.

    Attributes:
        folder: where it is: "~" and links followed.
        found: what the file tells; None until the folder is claimed.

    Raises:
        NotADirectoryError, PermissionError: as `output_folder`.
        FolderTaken: the folder holds another run's results, or files of something else.
    """

    def __init__(
        self,
        path: str | os.PathLike,
        asked: Mapping[str, Any],
        marker: str = "run.json",
        *,
        besides: Collection[str] = (),
        made: Collection[str] = (),
        replace: bool = False,
        instead: str = "or remove it",
    ):
        self.folder = output_folder(path)
        self.file, self.made = self.folder / marker, made
        self.asked = json.loads(json.dumps(asked))
        self.found: dict[str, Any] | None = None
        if not self.file.exists():
            check_free(self.folder, besides)
            return
        try:
            self.found = dict(json.loads(read_text(self.file)))
            differ = list(_differences(self.asked, self.found))
            why = f"{self.folder} holds another run, which differs in {', '.join(differ[:4])}" if differ else ""
        except (ValueError, TypeError):
            why = f"{self.folder} holds a run whose {marker} is damaged"
        if why and not replace:
            raise FolderTaken(f"{why}: choose another folder (--out), {instead}")
        if why:
            self.start_over()

    def note(self, **facts: Any) -> None:
        """Mark the folder as this run's, with facts to be found when it is resumed."""
        self.found = {**self.asked, **(self.found or {}), **facts}
        text = json.dumps(self.found, indent=2) + "\n"
        write_atomically(self.file, lambda file: file.write(text), text=True)

    def start_over(self) -> None:
        """Remove what an earlier start has made, and its claim; files of others stay."""
        for name in [*self.made, *(self.found or {}).get("made", ()), self.file.name]:
            remove(self.folder / name)
        self.found = None


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
