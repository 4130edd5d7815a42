"""Long work in stages: each leaves its results and a marker, so that a killed run goes on where it was."""

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from owm_envs.claims import Claim
from owm_envs.files import write_atomically


class Stages:
    """The stages of one run in one folder.

    The same again goes on, or finds all done; stages that other code has made are done again.

    Args:
        path: of the run's folder; empty, new, or one that an earlier start of the run made.
        settings: everything that was asked for and that the results depend on, JSON-able.
        code: fingerprint of what else they depend on.
        fresh: start over in any case.

    Attributes:
        folder: of the run: "~" and links followed.
        resumed: names of the stages that were found done.
        seconds: wall time of each stage when it was run.
        peak: largest resident size of the processes that ran them, bytes; 0 where the system does not tell.

    Raises:
        FolderTaken: the folder holds another run, or something else.
    """

    def __init__(self, path: str | os.PathLike, settings: dict[str, Any], code: str = "", *, fresh: bool = False):
        self.resumed: list[str] = []
        self.seconds: dict[str, float] = {}
        self.peak = 0.0
        instead = "remove it, or start over with --fresh"
        self._claim = Claim(path, settings, "state.json", made=["stages"], replace=fresh, instead=instead)
        self.folder = self._claim.folder
        if self._claim.found and (fresh or self._claim.found.get("code") != code):
            self._claim.start_over()
        self._claim.note(code=code, made=(self._claim.found or {}).get("made", []))

    def run(self, name: str, outputs: Sequence[str], work: Callable[[], Any]) -> Any:
        """Do a stage unless it is done; whatever `work` returns must be JSON-able.

        Args:
            name: of the stage.
            outputs: files and folders below the run's folder that the stage makes, whole or not at all.
            work: makes them.
        """
        marker = f"stages/{name}.json"
        self.claim(*outputs)
        found = self._read(marker)
        if found is not None and all((self.folder / output).exists() for output in outputs):
            self.resumed.append(name)
        else:
            began = time.perf_counter()
            facts = work()
            found = {"seconds": time.perf_counter() - began, "peak": peak_memory() or 0.0, "facts": facts}
            self._put(marker, found)
        self.seconds[name] = found["seconds"]
        self.peak = max(self.peak, found["peak"])
        return found["facts"]

    def claim(self, *names: str) -> None:
        """Note what lies in the folder because of this run, so that starting over can remove it."""
        made = self._claim.found["made"]
        if new := [name for name in names if name not in made]:
            self._claim.note(made=[*made, *new])

    def _put(self, name: str, content: Any) -> None:
        write_atomically(self.folder / name, lambda file: json.dump(content, file, indent=1), text=True)

    def _read(self, name: str) -> Any:
        try:
            return json.loads((self.folder / name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None


def source_digest() -> str:
    """Fingerprint of the three packages' source: results of other code are not to be continued."""
    import astrojax
    import owm
    import owm_envs

    sha = hashlib.sha256()
    for package in (astrojax, owm_envs, owm):
        root = Path(package.__file__).parent
        for file in sorted(root.rglob("*.py")):
            sha.update(file.relative_to(root).as_posix().encode())
            sha.update(file.read_bytes())
    return sha.hexdigest()


def peak_memory() -> float | None:
    """The process's largest resident size so far, bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(size if sys.platform == "darwin" else size * 1024)
