"""What a run tells of its splits: the hashes of their files, and what was asked for and recorded."""

from pathlib import Path
from typing import Any, NamedTuple

from owm_envs.config import DockingConfig, load_config
from owm_envs.datasets.manifest import MANIFEST, Entry, check_entry, load_manifest
from owm_envs.datasets.parse import read_json
from owm_envs.words import short

GENERATION = "generation.json"


class Run(NamedTuple):
    """The run that a split's folder belongs to."""

    root: Path
    """Where `manifest.json` and `generation.json` lie, if there are any."""
    split: str | None
    """The split's name; None where the folder is the run."""
    entries: dict[str, Entry] | None
    """What the manifest lists; None without one."""
    generation: dict[str, Any] | None
    """`generation.json`; None without one."""
    config: DockingConfig | None
    """Of the environment, as recorded there."""

    def check(self, path: Path, *, content: bool = True) -> None:
        """Compare a file with the manifest, where there is one.

        Args:
            content: hash it; else only its size is looked at.

        Raises:
            ValueError: it differs, or is not listed.
            FileNotFoundError: it is missing.
        """
        if self.entries is None:
            return
        name = path.relative_to(self.root).as_posix()
        if name not in self.entries:
            raise ValueError(f"{path} is not listed in {self.root / MANIFEST}")
        if not path.is_file():
            raise FileNotFoundError(f"{path} is missing; {MANIFEST} lists it")
        check_entry(path, self.entries[name], content=content)

    def results(self) -> list[dict[str, Any]]:
        """What the run recorded as this split; as each of its splits, where it does not tell which this is."""
        result = (self.generation or {}).get("result")
        if not result:
            return []
        if self.split is None:
            return list(result.values())
        if self.split not in result:
            raise ValueError(f"{self.root / GENERATION} tells of no split {self.split!r}, only of {', '.join(result)}")
        return [result[self.split]]


def run_of(folder: Path) -> Run:
    """Read what is told of a split beside it, or in the folder above.

    Raises:
        ValueError: a file of the run is damaged.
    """
    folder = folder.resolve()
    beside = [root for root in (folder, folder.parent) if any((root / n).is_file() for n in (MANIFEST, GENERATION))]
    root = beside[0] if beside else folder
    split = None if root == folder else folder.name
    entries = load_manifest(root) if (root / MANIFEST).is_file() else None
    run = Run(root, split, entries, None, None)
    path = root / GENERATION
    if not path.is_file():
        return run
    run.check(path)
    generation = read_json(path, "the generation.json of a run")
    result, environment = generation.get("result"), generation.get("environment")
    if not (isinstance(result, dict) and result and all(isinstance(told, dict) for told in result.values())):
        raise ValueError(f"{path}: result must be the counts of each split, got {short(result)}")
    if not isinstance(environment, dict):
        raise ValueError(f"{path}: environment must be a configuration, got {short(environment)}")
    try:
        config = load_config(environment)
    except (ValueError, TypeError, OSError) as error:
        raise ValueError(f"{path}: environment is no configuration: {' '.join(str(error).split())}") from None
    return run._replace(generation=generation, config=config)
