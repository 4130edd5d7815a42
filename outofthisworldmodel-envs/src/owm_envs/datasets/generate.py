"""Record a dataset: whole episodes in seed order, in batches that a killed run can be resumed from."""

import errno
import math
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from owm_envs.claims import Claim
from owm_envs.config import DockingConfig
from owm_envs.datasets.card import dataset_card
from owm_envs.datasets.writer import SplitWriter
from owm_envs.episode import POLICY_NAMES, Episode
from owm_envs.files import JOURNAL, check_free, output_folder, publish, published, remove, strangers, write_atomically
from owm_envs.station.ports import PORT_NAMES, TRAIN_PORTS, port_index
from owm_envs.words import checked_seed

if TYPE_CHECKING:
    from owm_envs.task.sensors import Sensor

FORMAT = 1
"""Raised whenever equal requests would record other episodes."""
BEHAVIOUR_MIX = {"random": 0.30, "orbit": 0.35, "dock": 0.35}
"""Share of each policy among the train episodes. Source: the paper's data generation."""
BYTES_PER_TRANSITION = 300
"""Upper estimate of a transition on disk without pixels, measured."""
_CHUNK_BYTES = 2**27
"""Of pixels and the like that a chunk of a rollout may hold."""


@dataclass(frozen=True)
class Request:
    """What to record. Train flies the mix at the configured train ports, val flies dock at every configured port.

    `planner_style` is the share of train episodes flown by "excite"; the rest keeps the mix.
    """

    transitions: int = 20_000
    val_transitions: int = 2_000
    seed: int = 0
    planner_style: float = 0.0
    episodes_per_batch: int = 64

    def __post_init__(self):
        for name in ("transitions", "val_transitions", "episodes_per_batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.planner_style <= 1:
            raise ValueError(f"planner_style must be from 0 to 1, got {self.planner_style}")
        checked_seed(self.seed, bits=32)


class Flight(NamedTuple):
    """What an episode of a split is to be: its policy and port."""

    policy: str
    port: int


def train_flights(request: Request, config: DockingConfig) -> Iterator[Flight]:
    """The endless sequence of train flights.

    Policies and ports are spread evenly from the first episode on, not drawn one by one, so that a small dataset has
    its share of each: policies by a golden-ratio sequence through the mix, ports by shuffled rounds.
    """
    ports = [port_index(name) for name in config.ports if name in TRAIN_PORTS]
    if not ports:
        raise ValueError(f"ports must name at least one train port ({', '.join(TRAIN_PORTS)}), got {config.ports}")
    shares = {name: share * (1 - request.planner_style) for name, share in BEHAVIOUR_MIX.items()}
    shares["excite"] = request.planner_style
    names, edges = list(shares), np.cumsum(list(shares.values()))
    draws = np.random.default_rng([request.seed, 0])
    place = draws.random()
    while True:
        for port in draws.permutation(ports):
            choice = int(np.searchsorted(edges, place * edges[-1], side="right"))
            yield Flight(names[min(choice, len(names) - 1)], int(port))
            place = (place + 0.6180339887498949) % 1.0


def val_flights(request: Request, config: DockingConfig) -> Iterator[Flight]:
    """The endless sequence of val flights: dock at each configured port in turn."""
    while True:
        for name in config.ports:
            yield Flight("dock", port_index(name))


class Progress(NamedTuple):
    """How far a split is; `done` includes an estimate for the batch in flight."""

    split: str
    done: int
    target: int


def generate(
    out: str | Path,
    config: DockingConfig,
    request: Request,
    *,
    sensors: "Sequence[Sensor]" = (),
    announce: Callable[[str], None] = lambda message: None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> dict:
    """Record `out/train` and `out/val`, each a LeRobot v3 dataset.

    Everything is written below `out.partial`, which becomes `out` in one step at the end. A run that was killed is
    resumed, batch by batch, by the same call; its result is the same as if it had not been. A finished one is kept.

    Args:
        out: folder to make; new or empty.
        sensors: what chasers carry beside relative navigation; each is a column `observation.NAME` more.
        announce: told in words what begins.
        progress: told how far it is.

    Returns:
        Counts of episodes, transitions, policies and outcomes of each split, as in `generation.json`.

    Raises:
        FolderTaken: `out` holds something else, or an unfinished run of other settings stands in its way.
        ValueError: no train port is configured.
        OSError: the disk is full.
    """
    out = output_folder(out)
    partial = out.with_name(out.name + ".partial")
    settings = {"format": FORMAT, "request": asdict(request), "environment": config.model_dump(mode="json")}
    settings["sensors"] = [repr(sensor) for sensor in sensors] or None
    moved = published(partial)
    done = Claim(out, settings, "generation.json", besides=moved)
    if result := (done.found or {}).get("result"):
        if partial.is_dir() and not strangers(partial, [JOURNAL]):
            remove(partial)  # the last that was left to do when the run was killed
        announce(f"{out} is complete already")
        return result
    check_free(out, moved)
    claim = Claim(partial, settings, "generation.json")
    if result := (claim.found or {}).get("result"):
        publish(partial, out)  # all that was left to do
        return result
    flights = {"train": train_flights(request, config), "val": val_flights(request, config)}
    next(train_flights(request, config))  # refuse a configuration without train ports before anything is written
    targets = {"train": request.transitions, "val": request.val_transitions}
    least = {"train": 1, "val": len(config.ports)}

    parts = _parts(config, sensors)
    _check_space(partial, config, targets, least, parts)
    if claim.found:
        announce(f"resuming {partial}")
    claim.note()
    try:
        summary = {}
        writers = {}
        spill = partial / "spill"  # what a killed run left there is of no use
        shutil.rmtree(spill, ignore_errors=True)
        spill.mkdir()
        recorder = _Recorder(config, request, sensors, parts, spill, announce, progress)
        for split in ("train", "val"):
            writers[split] = SplitWriter(partial / split, 1 / config.decision_dt, parts)
            recorder.record(split, writers[split], flights[split], targets[split], least[split])
        statistics = writers["train"].statistics()
        for split, writer in writers.items():
            writer.finish(statistics)
            summary[split] = _summary(partial / split, writer)
        shutil.rmtree(spill)
        texts = {"config.toml": config.to_toml(), "README.md": dataset_card(config, request, summary, parts)}
        for name, text in texts.items():
            write_atomically(partial / name, lambda file, text=text: file.write(text), text=True)
        claim.note(policies=list(POLICY_NAMES), result=summary)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise OSError(
                errno.ENOSPC, f"the disk is full; free some space and run the same again to go on from {partial}"
            ) from None
        raise
    publish(partial, out)
    return summary


def _parts(config: DockingConfig, sensors: "Sequence[Sensor]") -> dict[str, Any]:
    """Shape and dtype of what is observed beside the state part; JAX is started only if there is anything."""
    if not sensors and not config.has_pixels:
        return {}
    from owm_envs.env import DockingEnv
    from owm_envs.task.sensors import STATE

    parts = DockingEnv(config, sensors=sensors).observation_parts
    return {name: part for name, part in parts.items() if name != STATE}


def _check_space(partial: Path, config: DockingConfig, targets: dict, least: dict, parts: dict) -> None:
    longest = config.horizon_decisions
    expected = sum(max(targets[split], least[split] * longest) for split in targets) + longest
    there = sum(file.stat().st_size for file in partial.rglob("*") if file.is_file())
    disk = next(folder for folder in partial.absolute().parents if folder.exists())
    needed, free = expected * (BYTES_PER_TRANSITION + _frame_bytes(parts)) - there, shutil.disk_usage(disk).free
    if needed > free:
        raise OSError(
            errno.ENOSPC, f"{expected:,} transitions may take {needed / 1e6:,.0f} MB; {free / 1e6:,.0f} MB are free"
        )


def _frame_bytes(parts: dict[str, Any]) -> int:
    return sum(math.prod(part.shape) * np.dtype(part.dtype).itemsize for part in parts.values())


class _Recorder:
    """Flies batches of the planned flights; the simulator is built and compiled at the first one needed."""

    def __init__(
        self,
        config: DockingConfig,
        request: Request,
        sensors: "Sequence[Sensor]",
        parts: dict[str, Any],
        spill: Path,
        announce: Callable[..., None],
        progress: Callable[..., None],
    ):
        self.config, self.request, self.sensors, self.spill = config, request, sensors, spill
        self.announce, self.progress = announce, progress
        self.longest = config.horizon_decisions
        # Episodes that end early are about a seventh; batches of equal size waste the fewest flights.
        likely = math.ceil(1.15 * request.transitions / self.longest)
        batches = math.ceil(likely / request.episodes_per_batch)
        self.batch = min(request.episodes_per_batch, 8 * math.ceil(likely / batches / 8))
        # Decisions a chunk: the usual number, or what pixels leave room for.
        self.chunk = max(8, min(360, _CHUNK_BYTES // max(1, self.batch * _frame_bytes(parts))))
        self._env = None

    def record(self, split: str, writer: SplitWriter, flights: Iterator[Flight], target: int, least: int) -> None:
        """Fly until the split has whole episodes for `target` transitions and at least `least` of them."""
        planned = writer.episodes
        for _ in range(planned):
            next(flights)
        while writer.transitions < target or writer.episodes < least:
            before = writer.transitions
            self.progress(Progress(split, min(before, target), target))
            remaining = max(target - before, 0)
            batch = [next(flights) for _ in range(self.batch)]

            def flown(steps, running, before=before, remaining=remaining):
                share = min(1.0, steps / self.longest)
                self.progress(Progress(split, int(min(before, target) + share * remaining), target))

            with closing(self._fly(split, writer.episodes, batch, flown)) as flown_by:
                writer.write(_enough(flown_by, target - before, least - writer.episodes))
        self.progress(Progress(split, target, target))

    def _fly(self, split, first, batch, flown):
        import jax

        from owm_envs.env import DockingEnv
        from owm_envs.policies import make_policy
        from owm_envs.rollout import episodes, rollout

        if self._env is None:
            self.announce("compiling the simulator, once; this takes a while")
            self._env = DockingEnv(self.config, sensors=self.sensors)
            names = [*BEHAVIOUR_MIX, *(["excite"] if self.request.planner_style else [])]
            self._policies = {name: make_policy(name, self._env) for name in names}
        names = list(self._policies)
        base = jax.random.fold_in(jax.random.key(np.uint32(self.request.seed)), ("train", "val").index(split))
        numbers = np.arange(first, first + len(batch), dtype=np.uint32)
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(base, numbers)
        chunks = rollout(
            self._env,
            list(self._policies.values()),
            keys,
            np.array([flight.port for flight in batch]),
            which=np.array([names.index(flight.policy) for flight in batch]),
            chunk=self.chunk,
            progress=flown,
        )
        return episodes(chunks, spill=self.spill)


def _enough(episodes: Iterator[Episode], transitions: int, least: int) -> Iterator[Episode]:
    """The first episodes that hold so many transitions, and at least so many of them.

    In seed order, never those that ended first: that would favour collisions.
    """
    for count, episode in enumerate(episodes):
        if transitions <= 0 and count >= least:
            return
        transitions -= len(episode)
        yield episode


def _summary(folder: Path, writer: SplitWriter) -> dict:
    import pyarrow.parquet as pq

    from owm_envs.task.events import Outcome

    columns = ["policy", "port", "outcome"]
    table = pq.read_table(folder / "data", columns=columns, filters=[("frame_index", "==", 0)])
    policies, ports, outcomes = (table[name].to_pylist() for name in columns)
    return {
        "episodes": writer.episodes,
        "transitions": writer.transitions,
        "policies": dict(Counter(POLICY_NAMES[i] for i in policies)),
        "ports": dict(Counter(PORT_NAMES[i] for i in ports)),
        "outcomes": dict(Counter(Outcome(i).name.lower() for i in outcomes)),
    }
