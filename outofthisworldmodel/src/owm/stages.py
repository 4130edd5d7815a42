"""Long work in stages: each leaves its results and a marker, so that a killed run goes on where it was."""

import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from owm_envs.files import write_atomically

_STATE = "state.json"


class Stages:
    """The stages of one run in one folder.

    A run that was killed is continued if its settings are the same; a finished one, or one of other settings,
    is started over.

    Args:
        folder: of the run; empty, new, or one that an earlier run made.
        settings: everything that the results depend on, JSON-able.
        fresh: start over in any case.

    Attributes:
        resumed: names of the stages that were found done.
        seconds: wall time of each stage when it was run.
        peak: largest resident size of the processes that ran them, bytes; 0 where the system does not tell.

    Raises:
        FileExistsError: the folder holds something else.
    """

    def __init__(self, folder: Path, settings: dict[str, Any], *, fresh: bool = False):
        self.folder = folder
        self.resumed: list[str] = []
        self.seconds: dict[str, float] = {}
        self.peak = 0.0
        digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
        found = self._read(_STATE)
        if folder.exists() and any(folder.iterdir()) and found is None:
            raise FileExistsError(f"{folder} holds files of something else; choose another folder")
        if found is not None and (fresh or found.get("finished") or found.get("settings") != digest):
            for name in [*found.get("made", []), "stages"]:
                _remove(folder / name)
            found = None
        self._state = found or {"settings": digest, "finished": False, "made": []}
        self._write()

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
        new = [name for name in names if name not in self._state["made"]]
        if new:
            self._state["made"] += new
            self._write()

    def finish(self) -> None:
        """Note that the run is complete."""
        self._state["finished"] = True
        self._write()

    def _write(self) -> None:
        self._put(_STATE, self._state)

    def _put(self, name: str, content: Any) -> None:
        write_atomically(self.folder / name, lambda file: json.dump(content, file, indent=1), text=True)

    def _read(self, name: str) -> Any:
        try:
            return json.loads((self.folder / name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


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
