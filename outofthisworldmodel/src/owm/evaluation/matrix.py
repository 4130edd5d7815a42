"""A declared table of flights, policies times planner variants times conditions, flown resumably into one folder."""

import json
import shutil
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from owm import __version__
from owm.evaluation.coasting import add_coasts
from owm.evaluation.conditions import CONDITIONS, Condition
from owm.evaluation.docking import fly_episodes, trials
from owm.evaluation.flights import Flights, join
from owm.files import slug, write_atomically
from owm.planning.config import PlannerConfig
from owm.policies import is_planned, kind_of, load_policy
from owm.stages import source_digest
from owm_envs.config import unknown
from owm_envs.config_parts import Frozen
from owm_envs.station import PORT_NAMES, port_index

PLANNERS: dict[str, dict[str, Any]] = {
    "geodesic": {},
    "geodesic, no corrector": {"corrector": False},
    "plain": {"objective": "plain"},
    "plain, no corrector": {"objective": "plain", "corrector": False},
    "straight": {"objective": "straight"},
}
"""Variants of the planner: what differs from the standard `PlannerConfig`."""


class Study(Frozen):
    """One question: every policy with every planner variant under every condition."""

    title: str
    text: str = ""
    """A paragraph for the report."""
    policies: tuple[str, ...]
    """Labels of `Matrix.policies`."""
    planners: tuple[str, ...] = ("geodesic",)
    """Keys of `PLANNERS`; policies that plan with no model have none."""
    conditions: tuple[str, ...] = ("nominal",)
    """Keys of `CONDITIONS`."""
    flights: int | None = None
    """To each port; the matrix's when None."""
    fewer: dict[str, int] = Field(default_factory=dict)
    """Flights to each port of single rows, by "policy", "planner" or "policy, planner": the least that applies."""
    against: tuple[str, ...] = ()
    """Policies to compare every other with, start by start."""
    figures: bool = False
    """Draw curves by tolerance, by port and by range."""
    trajectories: tuple[str, ...] = ()
    """Rows to draw, by the names that the report gives them."""

    @field_validator("planners")
    @classmethod
    def _known(cls, value):
        for name in value:
            if name not in PLANNERS:
                raise ValueError(unknown("planner variant", name, PLANNERS))
        return value


class Matrix(Frozen):
    """What to fly."""

    title: str = "Docking at the ISS: evaluation"
    seed: int = 0
    """Decides starts and the policies' own draws."""
    flights: int = 50
    """To each port."""
    ports: tuple[str, ...] = PORT_NAMES
    policies: dict[str, str | tuple[str, ...]]
    """Label to a name or folder, as `load_policy` takes it, or to the folders of several trained seeds."""
    studies: tuple[Study, ...]

    @field_validator("ports")
    @classmethod
    def _ports(cls, value):
        for name in value:
            port_index(name)
        return value

    @model_validator(mode="after")
    def _labels(self) -> "Matrix":
        for study in self.studies:
            for label in (*study.policies, *study.against):
                if label not in self.policies:
                    raise ValueError(unknown("policy label", label, self.policies))
        return self

    def sources(self, label: str) -> tuple[str, ...]:
        """Names or folders behind a label, one a trained seed."""
        source = self.policies[label]
        return (source,) if isinstance(source, str) else source


def read_matrix(path: Path, folders: Path | None = None) -> Matrix:
    """Read a matrix from TOML; paths of policies are relative to `folders`, or to the file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no valid matrix, saying where.
    """
    base = path.parent if folders is None else folders
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
        matrix = Matrix.model_validate(values)
    except (tomllib.TOMLDecodeError, ValidationError) as error:
        raise ValueError(f"{path} is no evaluation matrix: {error}") from None

    def located(source: str) -> str:
        return str(base / source) if (base / source).exists() else source

    policies = {label: tuple(map(located, matrix.sources(label))) for label in matrix.policies}
    return matrix.model_copy(update={"policies": policies})


@dataclass(frozen=True)
class Row:
    """Flights of one policy (one trained seed of it), planner variant and condition."""

    label: str
    source: str
    copy: int
    """Which trained seed."""
    planner: str | None
    condition: str
    flights: int
    """To each port."""

    @property
    def key(self) -> tuple[str, str | None, str]:
        """What rows of several seeds share."""
        return self.label, self.planner, self.condition

    @property
    def folder(self) -> str:
        """Where its flights lie."""
        parts = [self.label if not self.copy else f"{self.label} seed {self.copy + 1}", self.condition]
        return "/".join(slug(part) for part in (*parts[:1], self.planner or "own", *parts[1:]))


def row_name(label: str, planner: str | None, condition: str = "nominal") -> str:
    """What reports call a row; standard planner and nominal condition go without saying."""
    parts = [label]
    if planner not in (None, "geodesic"):
        parts.append(planner)
    if condition != "nominal":
        parts.append(condition)
    return ", ".join(parts)


def rows_of(matrix: Matrix) -> list[Row]:
    """Every row once, flown as often as the study that asks most of it.

    Raises:
        ValueError, FileNotFoundError: a policy is unknown.
    """
    rows: dict[tuple, Row] = {}
    for study in matrix.studies:
        for label, planner, condition in study_keys(matrix, study):
            known = [study.fewer[k] for k in (label, planner, f"{label}, {planner}") if k in study.fewer]
            asked = min([study.flights or matrix.flights, *known])
            for copy, source in enumerate(matrix.sources(label)):
                key = (label, planner, condition, copy)
                flights = max(asked, rows[key].flights if key in rows else 0)
                rows[key] = Row(label, source, copy, planner, condition, flights)
    return list(rows.values())


def study_keys(matrix: Matrix, study: Study) -> Iterator[tuple[str, str | None, str]]:
    """Label, planner variant and condition of a study's rows, in the order of its tables."""
    for condition in study.conditions:
        for label in dict.fromkeys((*study.policies, *study.against)):
            planned = is_planned(kind_of(matrix.sources(label)[0]))
            for planner in study.planners if planned else (None,):
                yield label, planner, condition


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
        same = self.seconds.get((row.label, row.planner))
        alike = same or [n for (label, _), notes in self.seconds.items() if label == row.label for n in notes]
        notes = alike or [n for notes in self.seconds.values() for n in notes]
        return sum(s for s, _ in notes) / sum(n for _, n in notes)


Report = Callable[[int, int, str], None]
"""Called with flights done, flights in all and what is flying."""


def run_matrix(
    matrix: Matrix,
    out: Path,
    *,
    conditions: Mapping[str, Condition] = CONDITIONS,
    slots: int = 50,
    fresh: bool = False,
    report: Report = lambda *_: None,
) -> dict[tuple[str, str | None, str], list[Flights]]:
    """Fly what has not been flown, port by port, and read all of it.

    Args:
        matrix: what to fly.
        out: folder; the flights of each row and port are kept below `flights` as soon as they have landed.
        conditions: by name.
        slots: most flights side by side; a port's flights all fly at once if they are no more.
        fresh: fly again what was flown with other settings, instead of refusing.
        report: progress.

    Returns:
        Flights by (label, planner, condition), one entry a trained seed.

    Raises:
        ValueError: a condition or policy is unknown, or the folder holds flights of other settings.
        FileNotFoundError: there is no policy at a path.
    """
    if slots < 1:
        raise ValueError(f"slots must be at least 1, got {slots}")
    rows = rows_of(matrix)
    for row in rows:
        if row.condition not in conditions:
            raise ValueError(unknown("condition", row.condition, conditions))
    stores = [Store(out, row, conditions[row.condition], matrix, fresh=fresh) for row in rows]
    pace = Pace()
    for store in stores:
        for seconds in store.seconds.values():
            pace.add(store.row, seconds, store.row.flights)
    total = sum(row.flights for row in rows) * len(matrix.ports)
    flown: dict[tuple, list[Flights]] = {}
    for number, store in enumerate(stores):
        for port in store.missing():
            left = pace.left([(s.row, s.row.flights * len(s.missing())) for s in stores])
            done = total - sum(s.row.flights * len(s.missing()) for s in stores)
            ahead = "" if left is None else f", about {_spell(left)} left"
            note = f"row {number + 1}/{len(rows)}: {row_name(*store.row.key)} to {port}{ahead}"
            report(done, total, note)

            def told(*now, done=done, note=note, store=store):
                before, decision, decisions, _ = now
                report(done + min(store.row.flights, before), total, f"{note} (decision {decision}/{decisions})")

            pace.add(store.row, store.fly(port, slots, told), store.row.flights)
        store.policy = None  # its slots and programs are of no more use
        flown.setdefault(store.row.key, []).append(store.load())
    report(total, total, "all flown")
    return flown


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
            shutil.rmtree(self.folder, ignore_errors=True)
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
    """Fingerprint of a policy: its name, or what its file or folder holds."""
    path = Path(source)
    path = path / "model" if (path / "model" / "config.json").is_file() else path
    if not path.exists():
        return source
    sha = sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            sha.update(file.relative_to(path).as_posix().encode() + file.read_bytes())
    return sha.hexdigest()[:16]


@lru_cache(maxsize=2)
def _field(change):
    """The field of the hull, or of a changed one; 150 MB each, so few are kept."""
    from owm_envs.geodesic import load_field
    from owm_envs.station import hull_boxes

    return load_field(boxes=None if change is None else change(hull_boxes()))


def _spell(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
