"""Long work in stages: each leaves its results and a note of them, so that a killed run goes on where it was."""

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from owm_envs.claims import Claim, digest
from owm_envs.files import remove


class Stages:
    """The stages of one run in one folder, which as a context it keeps for itself.

    The same again goes on, or finds all done; stages that other code has made, or whose results were damaged since,
    are done again.

    Args:
        path: of the run's folder; empty, new, or one that an earlier start of the run made.
        settings: everything that was asked for and that the results depend on, JSON-able.
        code: fingerprint of what else they depend on.
        made: names of what the run makes in its folder: what starting over removes.
        fresh: start over in any case.

    Attributes:
        folder: of the run: "~" and links followed.
        resumed: names of the stages that were found done.
        seconds: wall time of each stage when it was run.
        peak: largest resident size of the processes that ran them, bytes; 0 where the system does not tell.

    Raises:
        FolderTaken: the folder holds another run, or something else; on entering, that another process is at work in
            it.
    """

    def __init__(
        self,
        path: str | os.PathLike,
        settings: dict[str, Any],
        code: str = "",
        *,
        made: Collection[str] = (),
        fresh: bool = False,
    ):
        self.resumed: list[str] = []
        self.seconds: dict[str, float] = {}
        self.peak = 0.0
        self._code, self._fresh = code, fresh
        form = {"stages": {...: {"seconds": (int, float), "peak": (int, float), "sha256": str}}}
        instead = "remove it, or start over with --fresh"
        self._claim = Claim(path, settings, "state.json", made=made, facts=form, replace=fresh, instead=instead)
        self.folder = self._claim.folder

    def __enter__(self) -> "Stages":
        self._claim.__enter__()
        if self._claim.found and (self._fresh or self._claim.found.get("code") != self._code):
            self._claim.start_over()
        self._claim.note(code=self._code)
        return self

    def __exit__(self, *error: object) -> None:
        self._claim.__exit__(*error)

    def run(self, name: str, outputs: Sequence[str], work: Callable[[], Any]) -> Any:
        """Do a stage unless it is done; whatever `work` returns must be JSON-able.

        Args:
            name: of the stage.
            outputs: files and folders below the run's folder that the stage makes, whole or not at all; if they were
                damaged since, they are removed and made anew.
            work: makes them, or goes on with what it left when it was killed.
        """
        notes = self._claim.found.get("stages", {})
        found = notes.get(name)
        if _is_whole(found) and self._claim.holds(*outputs):
            self.resumed.append(name)
        else:
            if found is not None:  # done, and damaged since: no work to go on with
                for output in outputs:
                    remove(self.folder / output)
                self._claim.note(stages={other: note for other, note in notes.items() if other != name})
            began = time.perf_counter()
            facts = work()
            found = {"seconds": time.perf_counter() - began, "peak": peak_memory() or 0.0, "facts": facts}
            found = json.loads(json.dumps(found))
            self._claim.seal(*outputs, stages={**notes, name: found | {"sha256": digest(found)}})
        self.seconds[name] = found["seconds"]
        self.peak = max(self.peak, found["peak"])
        return found["facts"]


def _is_whole(found: dict[str, Any] | None) -> bool:
    """Whether the note of a stage is as it was written."""
    told = dict(found or {})
    return told.pop("sha256", None) == digest(told) and told.keys() == {"seconds", "peak", "facts"}


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
