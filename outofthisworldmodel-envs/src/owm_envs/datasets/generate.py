"""Record a dataset: episodes one by one, each safe once written, then the files made of them.

While one chunk of a batch is simulated and its frames are drawn, the one before is encoded and written.
"""

import errno
import itertools
import math
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from owm_envs.claims import Claim
from owm_envs.config import DockingConfig
from owm_envs.datasets.card import dataset_card
from owm_envs.datasets.manifest import check_manifest, write_manifest
from owm_envs.datasets.pieces import Film, Pieces
from owm_envs.datasets.recipe import SPLITS, Flight, Request, Split, batch_size, flights, splits
from owm_envs.datasets.runs import GENERATION
from owm_envs.datasets.schema import features_of, part_of
from owm_envs.datasets.versions import versions
from owm_envs.datasets.writer import Written, write_meta, write_split
from owm_envs.episode import POLICY_NAMES, Episode
from owm_envs.files import (
    LOCK,
    check_free,
    output_folder,
    publish,
    published,
    remove,
    write_atomically,
)
from owm_envs.pipeline import ahead
from owm_envs.station.ports import PORT_NAMES
from owm_envs.video import require_av
from owm_envs.words import plain

if TYPE_CHECKING:
    from owm_envs.task.sensors import Sensor

FORMAT = 2
"""Raised whenever equal requests would record other episodes, or keep them in another way until they are a dataset."""
BYTES_PER_TRANSITION = 600
"""Upper estimate of a transition on disk without pixels while it is a piece and in its dataset, measured."""
_CHUNK_BYTES = 2**26
"""Of pixels and the like that a chunk of a rollout may hold; three of them are in memory at a time."""
PIECES, _SPILL = "pieces", "spill"
_ASIDE = (PIECES, _SPILL)
"""Folders of what only the recording needs."""


class Shard(NamedTuple):
    """One of several runs that share the work: every `count`-th batch from the `index`-th on, from 0."""

    index: int
    count: int

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Read "2/4": the second of four.

        Raises:
            ValueError: it is no such thing.
        """
        first, slash, second = text.partition("/")
        if not (slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
            raise ValueError(f"shard must be like 2/4, the second of four, got {text!r}")
        return cls(int(first) - 1, int(second))

    def __str__(self) -> str:
        return f"{self.index + 1}/{self.count}"


class Progress(NamedTuple):
    """How far a split is; `done` includes an estimate for the batch in flight."""

    split: str
    done: int
    target: int
    bytes: int
    """Written so far."""


def generate(
    out: str | Path,
    config: DockingConfig,
    request: Request,
    *,
    sensors: "Sequence[Sensor]" = (),
    shard: Shard | None = None,
    announce: Callable[[str], None] = lambda message: None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> dict:
    """Record `out/train` and `out/val`, each a LeRobot v3 dataset.

    Everything is written below `out.partial`, which becomes `out` in one step at the end. A run that was killed is
    resumed by the same call, after the last episode that was whole; its result is the same to the byte as if it had
    not been. A finished one is kept.

    Args:
        out: folder to make; new or empty.
        sensors: what chasers carry beside relative navigation; each is a column `observation.NAME` more.
        shard: record only this share of the episodes; `merge` makes the dataset of all shares.
        announce: told in words what begins.
        progress: told how far it is.

    Returns:
        Counts of episodes, transitions, policies and outcomes of each split, as in `generation.json`; of a shard what
        it recorded.

    Raises:
        FolderTaken: `out` holds something else, or an unfinished run of other settings stands in its way.
        ValueError: no train port is configured, or `out` is finished but was damaged since.
        ImportError: frames are to be recorded, and PyAV is not installed.
        OSError: the disk is full.
    """
    out = output_folder(out)
    partial = out.with_name(out.name + ".partial")
    settings = settings_of(config, request, sensors, shard)
    moved = published(partial)
    done = Claim(out, settings, GENERATION, besides=moved)
    if result := (done.found or {}).get("result"):
        if moved or (partial.is_dir() and not any(partial.iterdir())):
            publish(partial, out)  # the last that was left to do when the run was killed
        _check_whole(out, shard)
        announce(f"{out} is complete already")
        return result
    check_free(out, moved)
    claim = Claim(partial, settings, GENERATION)
    if (result := (claim.found or {}).get("result")) and (moved or not _damage(partial, shard, _ASIDE)):
        _finish(partial, out, shard)
        if moved:
            _check_whole(out, shard)
        return result
    plan = splits(request, config)  # refuses what cannot be before anything is written
    parts = _parts(config, sensors)
    videos = [part_of(name) for name, feature in features_of(parts).items() if feature.is_video]
    if videos:
        require_av()
    _check_space(partial, config, plan, parts)
    if claim.found:
        announce(f"resuming {partial}")
    try:
        with claim:
            claim.note()
            remove(partial / _SPILL)  # what a killed run left there is of no use
            flyer = _Flyer(config, request, sensors, parts, videos, partial, shard, announce, progress)
            numbers = {name: flyer.record(split) for name, split in plan.items()}
            if shard is None:
                summary = _assemble(partial, numbers, 1 / config.decision_dt, parts, announce)
                texts = {"config.toml": config.to_toml(), "README.md": _card(config, request, summary, parts, settings)}
                for name, text in texts.items():
                    write_atomically(partial / name, lambda file, text=text: file.write(text), text=True)
            else:
                summary = {name: {"episodes": len(own)} for name, own in numbers.items()}
            claim.note(policies=list(POLICY_NAMES), versions=versions(), result=summary)
            if shard is None:
                write_manifest(partial, _ASIDE)  # the seal: without it the files are made again
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise OSError(
                errno.ENOSPC, f"the disk is full; free some space and run the same again to go on from {partial}"
            ) from None
        raise
    _finish(partial, out, shard)
    return summary


def _finish(partial: Path, out: Path, shard: Shard | None) -> None:
    """Clear away what only the recording needed, and publish; killed, it is done again."""
    if not published(partial):
        for name in (_SPILL, LOCK, *([PIECES] if shard is None else [])):
            remove(partial / name)
    publish(partial, out)


def _damage(folder: Path, shard: Shard | None, aside: Sequence[str] = ()) -> str | None:
    """How a finished run's files differ from what was sealed; those of a share are looked at when they are merged."""
    try:
        if shard is None:
            check_manifest(folder, aside)
    except (OSError, ValueError) as error:
        return plain(error)
    return None


def _check_whole(out: Path, shard: Shard | None) -> None:
    """Refuse a finished run that was damaged since."""
    if damage := _damage(out, shard):
        raise ValueError(f"{damage}; remove {out}, and the same command records it anew")


def settings_of(
    config: DockingConfig, request: Request, sensors: "Sequence[Sensor]" = (), shard: Shard | None = None
) -> dict[str, Any]:
    """What tells two runs apart."""
    settings = {"format": FORMAT, "request": request.settings(), "environment": config.model_dump(mode="json")}
    settings["sensors"] = [repr(sensor) for sensor in sensors] or None
    return settings if shard is None else settings | {"shard": str(shard)}


def _card(config: DockingConfig, request: Request, summary: dict, parts: dict, settings: dict) -> str:
    return dataset_card(config, request.settings(), summary, parts, sensors=settings["sensors"], versions=versions())


def _assemble(
    partial: Path, numbers: dict[str, list[int]], fps: float, parts: dict[str, Any], announce: Callable[[str], None]
) -> dict[str, dict]:
    """Make the files of the splits; give what they came to. Killed, it is done again from the pieces."""
    announce("writing the files of the dataset")
    written: dict[str, Written] = {}
    for name, own in numbers.items():
        remove(partial / name)
        written[name] = write_split(partial / name, Pieces(partial / PIECES / name), own, fps, parts)
    for name, split in written.items():
        write_meta(partial / name, split, written["train"].statistics, fps, parts)
    return {name: _summary(partial / name, split) for name, split in written.items()}


def _parts(config: DockingConfig, sensors: "Sequence[Sensor]") -> dict[str, Any]:
    """Shape and dtype of what is observed beside the state part; JAX is started only if there is anything."""
    if not sensors and not config.has_pixels and not config.navigation.quiet:
        return {}
    from owm_envs.env import DockingEnv
    from owm_envs.task.sensors import STATE

    parts = DockingEnv(config, sensors=sensors).observation_parts
    return {name: part for name, part in parts.items() if name != STATE}


def _check_space(partial: Path, config: DockingConfig, plan: dict[str, Split], parts: dict[str, Any]) -> None:
    longest = config.horizon_decisions
    expected = sum(max(split.transitions, split.episodes * longest) for split in plan.values()) + longest
    there = sum(file.stat().st_size for file in partial.rglob("*") if file.is_file())
    disk = next(folder for folder in partial.absolute().parents if folder.exists())
    # What is encoded takes a tenth at most; it is there twice while files are made.
    pixels = sum(_bytes(part) * (0.2 if _is_video(name, part) else 2.0) for name, part in parts.items())
    needed, free = expected * (BYTES_PER_TRANSITION + pixels) - there, shutil.disk_usage(disk).free
    if needed > free:
        raise OSError(
            errno.ENOSPC, f"{expected:,} transitions may take {needed / 1e6:,.0f} MB; {free / 1e6:,.0f} MB are free"
        )


def _bytes(part: Any) -> int:
    return math.prod(part.shape) * np.dtype(part.dtype).itemsize


def _is_video(name: str, part: Any) -> bool:
    return any(feature.is_video for feature in features_of({name: part}).values())


class _Flyer:
    """Flies batches of the planned flights; the simulator is built and compiled at the first one needed."""

    def __init__(
        self,
        config: DockingConfig,
        request: Request,
        sensors: "Sequence[Sensor]",
        parts: dict[str, Any],
        videos: list[str],
        folder: Path,
        shard: Shard | None,
        announce: Callable[..., None],
        progress: Callable[..., None],
    ):
        self.config, self.request, self.sensors, self.shard = config, request, sensors, shard
        self.videos, self.folder, self.announce, self.progress = videos, folder, announce, progress
        self.longest = config.horizon_decisions
        self.batch = batch_size(request, config)
        # Decisions a chunk: the usual number, or what pixels leave room for.
        frame = sum(map(_bytes, parts.values()))
        self.chunk = max(8, min(360, _CHUNK_BYTES // max(1, self.batch * frame)))
        self._env: Any = None
        self._policies: dict[str, Any] = {}

    def record(self, split: Split) -> list[int]:
        """Put away the episodes of a split, or a shard's share of them; give the numbers of those that belong to it.

        An episode depends on its number alone, so that it may be recorded in any run and order. Which is the last one
        depends on how long those before it are.
        """
        pieces = Pieces(self.folder / PIECES / split.name)
        planned, numbers, transitions = flights(split), [], 0
        # A shard ends with the batch that fills its share; what all of them leave to be recorded, `merge` does.
        share = 1 if self.shard is None else self.shard.count
        target, least = math.ceil(split.transitions / share), math.ceil(split.episodes / share)

        def tell(done: float) -> None:
            self.progress(Progress(split.name, int(min(done, target)), target, pieces.bytes))

        for batch in itertools.count():
            if transitions >= target and len(numbers) >= least:
                break
            batch_flights = list(islice(planned, self.batch))
            if self.shard is not None and batch % self.shard.count != self.shard.index:
                continue
            before = transitions

            def flown(steps: int, running: int, before: int = before) -> None:
                share = min(1.0, steps / self.longest)
                tell(min(before, target) + share * max(min(target - before, self.batch * self.longest), 0))

            tell(before)
            with closing(self._recorded(split, pieces, batch_flights, batch * self.batch, flown)) as recorded:
                for number, decisions in recorded:
                    numbers.append(number)
                    transitions += decisions
                    # In seed order, never those that ended first: that would favour collisions.
                    if self.shard is None and transitions >= target and len(numbers) >= least:
                        break
        tell(target)
        return numbers

    def _recorded(
        self, split: Split, pieces: Pieces, batch: list[Flight], first: int, flown: Callable[[int, int], None]
    ) -> Iterator[tuple[int, int]]:
        """Numbers and decisions of a batch's episodes; it is flown when one is asked for that is not there yet."""
        missing = [number for number in range(first, first + len(batch)) if number not in pieces]
        for number in range(first, missing[0] if missing else first + len(batch)):
            yield number, pieces.decisions(number)
        if not missing:
            return
        with closing(self._fly(split, batch, first, flown)) as episodes:
            for number, episode in enumerate(episodes, first):
                if number in missing:
                    pieces.put(number, episode, 1 / self.config.decision_dt)
                if number >= missing[0]:
                    yield number, pieces.decisions(number)

    def _fly(
        self, split: Split, batch: list[Flight], first: int, flown: Callable[[int, int], None]
    ) -> Iterator[Episode]:
        import jax

        from owm_envs.env import DockingEnv
        from owm_envs.policies import make_policy
        from owm_envs.rollout import episodes, rollout

        if self._env is None:
            self.announce("compiling the simulator, once; this takes a while")
            self._env = DockingEnv(self.config, sensors=self.sensors)
        names = [name for name, share in split.policies.items() if share]
        for name in names:
            if name not in self._policies:
                self._policies[name] = make_policy(name, self._env)
        spill = self.folder / _SPILL
        spill.mkdir(parents=True, exist_ok=True)
        base = jax.random.fold_in(jax.random.key(np.uint32(self.request.seed)), SPLITS.index(split.name))
        numbers = np.arange(first, first + len(batch), dtype=np.uint32)
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(base, numbers)
        chunks = rollout(
            self._env,
            [self._policies[name] for name in names],
            keys,
            np.array([flight.port for flight in batch]),
            which=np.array([names.index(flight.policy) for flight in batch]),
            chunk=self.chunk,
            progress=flown,
        )
        fps = 1 / self.config.decision_dt
        sinks = {part: lambda slot, part=part: Film(spill / f"{slot}.{part}.mp4", fps) for part in self.videos}
        return episodes(ahead(chunks), spill=spill, sinks=sinks)


def _summary(folder: Path, written: Written) -> dict:
    import pyarrow.parquet as pq

    from owm_envs.task.events import Outcome

    columns = ["policy", "port", "outcome"]
    table = pq.read_table(folder / "data", columns=columns, filters=[("frame_index", "==", 0)])
    policies, ports, outcomes = (table[name].to_pylist() for name in columns)
    return {
        "episodes": written.episodes,
        "transitions": written.transitions,
        "policies": dict(Counter(POLICY_NAMES[i] for i in policies)),
        "ports": dict(Counter(PORT_NAMES[i] for i in ports)),
        "outcomes": dict(Counter(Outcome(i).name.lower() for i in outcomes)),
    }
