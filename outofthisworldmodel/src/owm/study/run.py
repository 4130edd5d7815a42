"""Fly a matrix into one folder, port by port, so that a killed run goes on where it was."""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from owm import __version__
from owm.catalogue.policies import OWN, content_digest, kind_of, load_model, load_policy
from owm.scores.coasting import add_coasts
from owm.scores.docking import fly_episodes, trials
from owm.scores.flights import Flights, join
from owm.stages import source_digest
from owm.study.conditions import CONDITIONS, Condition
from owm.study.matrix import Matrix, Row, planner_of, row_name, rows_of
from owm.study.workers import fly_side_by_side, missing_flights, spell
from owm_envs.claims import Claim
from owm_envs.files import FolderTaken, output_folder, remove
from owm_envs.policies import SlotPolicy
from owm_envs.policies.geodesic import field_of
from owm_envs.station import PORT_NAMES, port_index
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


_ROWS = "flights/*/*/*/row.json"
"""Where `Row.folder` puts what a row's flights depend on."""
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
    command: str = "run_matrix",
    report: Report = lambda *_: None,
) -> dict[tuple[str, str | None, str], list[Flights]]:
    """Fly what has not been flown, port by port, and read all of it.

    Args:
        matrix: what to fly.
        out: folder; the flights of each row and port are kept below `flights` as soon as they have landed.
        conditions: by name.
        slots: most flights side by side; a port's flights all fly at once if they are no more.
        fresh: replace flights of other settings, and those that are not asked for, instead of refusing.
        fly: or only read the rows that are complete.
        processes: that fly, a row each at a time, on equal shares of the cores.
        command: what the folder is one of.
        report: progress.

    Returns:
        Flights by (label, planner, condition), one entry a trained seed.

    Raises:
        ValueError: a condition or policy is unknown.
        FolderTaken: the folder holds something else, flights of other settings, or some that are not asked for: a
            report of this matrix would leave them out.
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
    flown_before = any(output_folder(out).glob(_ROWS))  # perhaps by a version that did not claim the folder
    claim = Claim(out, {"command": command}, besides=os.listdir(output_folder(out)) if flown_before else ())
    stores = [Store(claim.folder, row, conditions[row.condition], matrix, fresh=fresh) for row in rows]
    planned = {store.row.source: store.condition.told() for store in stores if store.row.planner}
    for source, told in planned.items() if fly else ():
        load_model(source, told)  # so that one that cannot be read is told of now, not after an hour of flying
    with claim:
        missing_flights(stores)  # once more: another process may have been at it
        _settle_rest(claim.folder, stores, fresh)
        to_fly = [store for store in stores if fly and store.missing()]
        claim.note()
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


def _settle_rest(out: Path, stores: list["Store"], fresh: bool) -> None:
    """Refuse flights in the folder that no store asks for, or remove them."""
    asked = {store.folder / _file(port) for store in stores for port in store.matrix.ports}
    asked |= {store.claim.file for store in stores}
    rest = {file for row in out.glob(_ROWS) for file in (row, *row.parent.glob("[!.]*.npz"))} - asked
    if rest and not fresh:
        one = min(rest, key=lambda file: (file.suffix != ".npz", file)).relative_to(out / "flights").with_suffix("")
        raise FolderTaken(
            f"{out} holds flights that are not asked for now ({one}): choose another folder (--out), ask for them as "
            "well, or have them removed by --fresh"
        )
    for file in rest:
        remove(file)


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
    """The flights of one row on disk, a file a port, and all that they depend on.

    Files that were damaged since they were noted, or never were, count as missing: the same flights are flown again.

    Raises:
        FolderTaken: the folder holds flights of other settings.
    """

    def __init__(self, out: Path, row: Row, condition: Condition, matrix: Matrix, *, fresh: bool = False):
        self.row, self.condition, self.matrix = row, condition, matrix
        self.policy: Any = None
        made = [_file(port) for port in PORT_NAMES]
        self.claim = Claim(
            out / "flights" / row.folder,
            {"settings": self._settings()},
            "row.json",
            besides=made,
            made=made,
            facts={"ports": {...: {"seconds": (int, float), "source": str}}},
            replace=fresh,
            renew=True,
            instead="or fly again with --fresh",
        )
        self.folder = self.claim.folder

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each port flown."""
        return {port: facts["seconds"] for port, facts in self._ports().items()}

    def missing(self) -> list[str]:
        """Ports not flown yet."""
        return [port for port in self.matrix.ports if not self.claim.holds(_file(port))]

    def fly(self, port: str, slots: int, progress: Callable[..., None]) -> float:
        """Fly to one port and keep the flights; the wall time it took, s."""
        began, row, matrix, told = time.perf_counter(), self.row, self.matrix, self.condition.told()
        slots = min(slots, row.flights)
        if self.policy is None:
            planner = planner_of(row.planner) if row.planner else None
            chart = _field(self.condition.map) if told.target.hold is None else field_of(told)
            self.policy = load_policy(row.source, told, slots, matrix.seed, planner, chart)
        if isinstance(self.policy, SlotPolicy):
            # Draws follow the number of the episode: that of a run to all ports in turn, whatever has been flown.
            self.policy.restart(port_index(port) * -(-row.flights // slots))
        self.claim.note(version=__version__, ports=self._ports())
        seeds, ports = trials([port], row.flights, matrix.seed)
        flown = fly_episodes(
            self.policy, self.condition.flown(), seeds, ports, progress, slots=slots, name=row_name(*row.key)
        )
        if not told.structure.turning:  # what coasts beside a target that turns is not looked at
            flown = add_coasts(flown, _field(None))
        flown.save(self.folder / _file(port))
        seconds = time.perf_counter() - began
        facts = {"seconds": round(seconds, 2), "source": source_digest()[:16]}
        self.claim.seal(_file(port), ports={**self._ports(), port: facts})
        if kind_of(row.source) == OWN:
            self.policy = None  # who knows what it keeps from one port to the next
        return seconds

    def load(self) -> Flights:
        """All ports' flights."""
        parts = [Flights.load(self.folder / _file(port)) for port in self.matrix.ports]
        return replace(join(parts), policy=row_name(*self.row.key))

    def _ports(self) -> dict[str, dict[str, Any]]:
        return (self.claim.found or {}).get("ports", {})

    def _settings(self) -> dict[str, Any]:
        boxes = self.condition.map_boxes()
        return {
            "policy": content_digest(self.row.source),
            "planner": planner_of(self.row.planner).model_dump() if self.row.planner else None,
            "told": self.condition.told().model_dump(mode="json"),
            "environment": self.condition.flown().model_dump(mode="json"),
            "map": "true" if boxes is None else sha256(np.ascontiguousarray(boxes).tobytes()).hexdigest()[:16],
            "flights": self.row.flights,
            "seed": self.matrix.seed,
        }


def _file(port: str) -> str:
    """Where the flights to a port lie."""
    return f"{port}.npz"


@lru_cache(maxsize=2)
def _field(change):
    """The field of the hull, or of a changed one; 150 MB each, so few are kept."""
    from owm_envs.field import load_field
    from owm_envs.station import hull_boxes

    return load_field(boxes=None if change is None else change(hull_boxes()))
