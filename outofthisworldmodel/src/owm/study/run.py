"""Fly a matrix into one folder, port by port, so that a killed run goes on where it was."""

import inspect
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from owm import __version__
from owm.catalogue.policies import NAMES, ONLINE_PREFIX, checkpoint_folder, kind_of, load_model, load_policy, own_class
from owm.planning.config import PlannerConfig
from owm.scores.coasting import add_coasts
from owm.scores.docking import fly_episodes, trials
from owm.scores.flights import Flights, join
from owm.stages import source_digest
from owm.study.conditions import CONDITIONS, Condition
from owm.study.matrix import PLANNERS, Matrix, Row, row_name, rows_of
from owm.study.workers import fly_side_by_side, missing_flights, spell
from owm_envs.files import write_atomically
from owm_envs.words import unknown


@dataclass
class Pace:
    """How long flights take, to say how long the rest will."""

    seconds: dict[tuple[str, str | None], list[tuple[float, int]]] = field(default_factory=dict)

    def add(self, row: Row, seconds: float, flights: int) -> None:
        """Note what flights of a row took."""
        self.seconds.setdefault((row.label, row.planner), []).append((seconds, flights))

    def left(self, rows: list[tuple[Row, int]]) -> float | None:
        """Seconds that flights of some rows will take; None before anything has flown.

        Args:
            rows: with the flights that are left of each.
        """
        if not self.seconds:
            return None
        return sum(self._each(row) * flights for row, flights in rows)

    def _each(self, row: Row) -> float:
        # A row's first port waits for the compiler.
        settled = {key: notes[1:] or notes for key, notes in self.seconds.items()}
        same = settled.get((row.label, row.planner))
        alike = same or [n for (label, _), notes in settled.items() if label == row.label for n in notes]
        notes = alike or [n for notes in settled.values() for n in notes]
        return sum(s for s, _ in notes) / sum(n for _, n in notes)


Report = Callable[[int, int, str, str], None]
"""Called with flights done, flights in all, what is flying, and how far it is."""


def run_matrix(
    matrix: Matrix,
    out: Path,
    *,
    conditions: Mapping[str, Condition] = CONDITIONS,
    slots: int = 50,
    fresh: bool = False,
    fly: bool = True,
    processes: int = 1,
    report: Report = lambda *_: None,
) -> dict[tuple[str, str | None, str], list[Flights]]:
    """Fly what has not been flown, port by port, and read all of it.

    Args:
        matrix: what to fly.
        out: folder; the flights of each row and port are kept below `flights` as soon as they have landed.
        conditions: by name.
        slots: most flights side by side; a port's flights all fly at once if they are no more.
        fresh: fly again what was flown with other settings, instead of refusing.
        fly: or only read the rows that are complete.
        processes: that fly, a row each at a time, on equal shares of the cores.
        report: progress.

    Returns:
        Flights by (label, planner, condition), one entry a trained seed.

    Raises:
        ValueError: a condition or policy is unknown, or the folder holds flights of other settings.
        FileNotFoundError: there is no policy at a path.
        RuntimeError: one of several processes has died.
    """
    for name, count in (("slots", slots), ("processes", processes)):
        if count < 1:
            raise ValueError(f"{name} must be at least 1, got {count}")
    rows = rows_of(matrix)
    for row in rows:
        if row.condition not in conditions:
            raise ValueError(unknown("condition", row.condition, conditions))
    stores = [Store(out, row, conditions[row.condition], matrix, fresh=fresh) for row in rows]
    to_fly = [store for store in stores if fly and store.missing()]
    planned = {store.row.source: store.condition.told() for store in to_fly if store.row.planner}
    for source, told in planned.items():
        load_model(source, told)  # so that one that cannot be read is told of now, not after an hour of flying
    total = sum(row.flights for row in rows) * len(matrix.ports)
    if processes > 1 and to_fly:
        fly_side_by_side(to_fly, slots, processes, lambda left, *what: report(total - left, total, *what))
    else:
        _fly_in_turn(stores, to_fly, slots, total, report)
    flown: dict[tuple, list[Flights]] = {}
    for store in stores:
        if not store.missing():
            flown.setdefault(store.row.key, []).append(store.load())
    done = total - missing_flights(stores)
    report(done, total, "all flown" if done == total else "the rest has not been flown", "")
    return flown


def _fly_in_turn(stores: list["Store"], to_fly: list["Store"], slots: int, total: int, report: Report) -> None:
    pace = Pace()
    for store in stores:
        for seconds in store.seconds.values():
            pace.add(store.row, seconds, store.row.flights)
    for store in to_fly:
        for port in store.missing():
            left = pace.left([(s.row, s.row.flights * len(s.missing())) for s in to_fly])
            done = total - missing_flights(to_fly)
            ahead = "" if left is None else f", about {spell(left)} left"
            note = f"row {stores.index(store) + 1}/{len(stores)}: {row_name(*store.row.key)} to {port}{ahead}"
            report(done, total, note, "")

            def told(before, decision, decisions, running, done=done, note=note):
                report(done + before, total, note, f"decision {decision}/{decisions}, {running} flying")

            pace.add(store.row, store.fly(port, slots, told), store.row.flights)
        store.policy = None  # its slots and programs are of no more use


class Store:
    """The flights of one row on disk, a file a port, with a fingerprint of all that they depend on.

    Raises:
        ValueError: the folder holds flights of other settings.
    """

    def __init__(self, out: Path, row: Row, condition: Condition, matrix: Matrix, *, fresh: bool = False):
        self.row, self.condition, self.matrix = row, condition, matrix
        self.folder = out / "flights" / row.folder
        self.policy: Any = None
        settings = self._settings()
        digest = sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]
        self.facts = {"fingerprint": digest, "settings": settings, "version": __version__, "ports": {}}
        path = self.folder / "row.json"
        if not path.is_file():
            return
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["fingerprint"] == digest:
            self.facts = found
        elif fresh:
            shutil.rmtree(self.folder)
        else:
            changed = [k for k in settings if settings[k] != found["settings"].get(k)]
            raise ValueError(
                f"{self.folder} holds flights with another {', '.join(changed)}: they cannot be mixed; "
                "choose another --out, or fly again with --fresh"
            )

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each port flown."""
        return {port: facts["seconds"] for port, facts in self.facts["ports"].items()}

    def missing(self) -> list[str]:
        """Ports not flown yet."""
        return [port for port in self.matrix.ports if not (self.folder / f"{port}.npz").is_file()]

    def fly(self, port: str, slots: int, progress: Callable[..., None]) -> float:
        """Fly to one port and keep the flights; the wall time it took, s."""
        began, row, matrix = time.perf_counter(), self.row, self.matrix
        slots = min(slots, row.flights)
        if self.policy is None:
            planner = PlannerConfig(**PLANNERS[row.planner]) if row.planner else None
            chart = _field(self.condition.map)
            self.policy = load_policy(row.source, self.condition.told(), slots, matrix.seed, planner, chart)
        self._keep_facts()
        seeds, ports = trials([port], row.flights, matrix.seed)
        flown = fly_episodes(
            self.policy, self.condition.flown(), seeds, ports, progress, slots=slots, name=row_name(*row.key)
        )
        flown = add_coasts(flown, _field(None))
        flown.save(self.folder / f"{port}.npz")
        seconds = time.perf_counter() - began
        self.facts["ports"][port] = {"seconds": round(seconds, 2), "source": source_digest()[:16]}
        self._keep_facts()
        return seconds

    def load(self) -> Flights:
        """All ports' flights."""
        parts = [Flights.load(self.folder / f"{port}.npz") for port in self.matrix.ports]
        return replace(join(parts), policy=row_name(*self.row.key))

    def _keep_facts(self) -> None:
        write_atomically(self.folder / "row.json", lambda file: json.dump(self.facts, file, indent=1), text=True)

    def _settings(self) -> dict[str, Any]:
        boxes = self.condition.map_boxes()
        return {
            "policy": content_digest(self.row.source),
            "planner": PlannerConfig(**PLANNERS[self.row.planner]).model_dump() if self.row.planner else None,
            "told": self.condition.told().model_dump(mode="json"),
            "environment": self.condition.flown().model_dump(mode="json"),
            "map": "true" if boxes is None else sha256(np.ascontiguousarray(boxes).tobytes()).hexdigest()[:16],
            "flights": self.row.flights,
            "seed": self.matrix.seed,
        }


def content_digest(source: str) -> str:
    """Fingerprint of a policy: its name, or what its checkpoint holds."""
    if source in NAMES:
        return source
    if kind_of(source) == "user's own":
        return sha256(source.encode() + Path(inspect.getfile(own_class(source))).read_bytes()).hexdigest()[:16]
    path = source.removeprefix(ONLINE_PREFIX)
    folder = checkpoint_folder(path)
    sha = sha256(source.removesuffix(path).encode())
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        sha.update(file.relative_to(folder).as_posix().encode() + file.read_bytes())
    return sha.hexdigest()[:16]


@lru_cache(maxsize=2)
def _field(change):
    """The field of the hull, or of a changed one; 150 MB each, so few are kept."""
    from owm_envs.field import load_field
    from owm_envs.station import hull_boxes

    return load_field(boxes=None if change is None else change(hull_boxes()))
