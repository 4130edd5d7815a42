"""A declared table of flights: policies times planner variants times conditions."""

import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator, model_validator

from owm.catalogue.policies import is_planned, kind_of
from owm.planning.config import PlannerConfig
from owm_envs.config.parts import Frozen
from owm_envs.files import read_text, slug
from owm_envs.station import PORT_NAMES, port_index
from owm_envs.words import checked_seed, mistakes, unknown

PLANNERS: dict[str, dict[str, Any]] = {
    "geodesic": {},
    "geodesic, no corrector": {"corrector": False},
    "plain": {"objective": "plain"},
    "plain, no corrector": {"objective": "plain", "corrector": False},
    "straight": {"objective": "straight"},
    "safe": {"objective": "safe"},
    "0.25 s late": {"latency": 1},
    "0.5 s late": {"latency": 2},
}
"""Variants of the planner: what differs from the standard `PlannerConfig`."""


def planner_of(name: str) -> PlannerConfig:
    """A variant of the planner.

    Raises:
        ValueError: there is none of this name, naming the nearest.
    """
    if name not in PLANNERS:
        raise ValueError(unknown("planner variant", name, PLANNERS))
    return PlannerConfig(**PLANNERS[name])


Count = Annotated[int, Field(ge=1, le=10**6)]


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
    flights: Count | None = None
    """To each port; the matrix's when None."""
    fewer: dict[str, Count] = Field(default_factory=dict)
    """Flights to each port of single rows, by "policy", "planner" or "policy, planner": the least that applies."""
    seeds: Count | None = None
    """Trained seeds to fly of policies that have several; all when None."""
    against: tuple[str, ...] = ()
    """Policies to compare every other with, start by start."""
    figures: bool = False
    """Draw curves by tolerance, by port and by range."""
    draw: tuple[str, ...] = ()
    """Rows of these, by the names that the report gives them; those of the first planner variant when empty."""
    trajectories: tuple[str, ...] = ()
    """Rows to draw, by the names that the report gives them."""

    @field_validator("planners")
    @classmethod
    def _known(cls, value):
        for name in value:
            planner_of(name)
        return value


class Matrix(Frozen):
    """What to fly."""

    title: str = "Docking at the ISS: evaluation"
    seed: int = 0
    """Decides starts and the policies' own draws."""
    flights: Count = 50
    """To each port."""
    ports: tuple[str, ...] = PORT_NAMES
    policies: dict[str, str | tuple[str, ...]]
    """Label to a name or folder, as `load_policy` takes it, or to the folders of several trained seeds."""
    studies: tuple[Study, ...]

    _seed = field_validator("seed")(checked_seed)

    @field_validator("ports")
    @classmethod
    def _ports(cls, value):
        for name in value:
            port_index(name)
        if again := twice(value):
            raise ValueError(f"ports must differ, got {again!r} twice")
        return value

    @model_validator(mode="after")
    def _labels(self) -> "Matrix":
        for label in self.policies:
            if not (sources := self.sources(label)) or twice(sources):
                raise ValueError(f"policy {label!r} must have a source, or several different ones, got {sources}")
        if again := twice(slug(study.title).casefold() for study in self.studies):
            raise ValueError(f"titles of studies must differ in letters and digits, got {again!r} twice")
        for study in self.studies:
            for label in (*study.policies, *study.against):
                if label not in self.policies:
                    raise ValueError(unknown("policy label", label, self.policies))
        return self

    def sources(self, label: str) -> tuple[str, ...]:
        """Names or folders behind a label, one a trained seed."""
        source = self.policies[label]
        return (source,) if isinstance(source, str) else source


def read_matrix(path: Path) -> Matrix:
    """Read a matrix from TOML.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no valid matrix, saying where.
    """
    try:
        return Matrix.model_validate(tomllib.loads(read_text(path)))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from None
    except ValidationError as error:
        raise ValueError(f"{path} is no evaluation matrix: {mistakes(error, Matrix)}") from None


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


def twice(names: Iterable[str]) -> str | None:
    """The first name that comes again."""
    return next((name for name, count in Counter(names).items() if count > 1), None)


def rows_of(matrix: Matrix) -> list[Row]:
    """Every row once, flown as often as the study that asks most of it.

    Raises:
        ValueError: two rows would have one folder, or one name in the report.
        ValueError, FileNotFoundError: a policy is unknown.
    """
    rows: dict[tuple, Row] = {}
    for study in matrix.studies:
        for label, planner, condition in study_keys(matrix, study):
            asked = flights_asked(matrix, study, (label, planner, condition))
            for copy, source in enumerate(matrix.sources(label)[: study.seeds]):
                key = (label, planner, condition, copy)
                flights = max(asked, rows[key].flights if key in rows else 0)
                rows[key] = Row(label, source, copy, planner, condition, flights)
    _check_apart([(row.folder, row) for row in rows.values()])
    _check_apart([(slug(row_name(*row.key)), row) for row in rows.values() if not row.copy])
    return list(rows.values())


def _check_apart(named: Iterable[tuple[str, Row]]) -> None:
    """Refuse rows whose names are the same, or would be where a file system knows no capital letters."""
    known: dict[str, Row] = {}
    for name, row in named:
        other = known.setdefault(name.casefold(), row)
        if other is not row:
            raise ValueError(
                f"policies {other.label!r} and {row.label!r} would share the name {name!r} in folder and report: "
                "rename one of them, so that they differ in letters or digits"
            )


def flights_asked(matrix: Matrix, study: Study, key: tuple[str, str | None, str]) -> int:
    """Flights to each port that a study wants of a row."""
    label, planner, _ = key
    known = [study.fewer[k] for k in (label, planner, f"{label}, {planner}") if k in study.fewer]
    return min([study.flights or matrix.flights, *known])


def study_keys(matrix: Matrix, study: Study) -> Iterator[tuple[str, str | None, str]]:
    """Label, planner variant and condition of a study's rows, in the order of its tables."""
    for condition in study.conditions:
        for label in dict.fromkeys((*study.policies, *study.against)):
            planned = is_planned(kind_of(matrix.sources(label)[0]))
            for planner in study.planners if planned else (None,):
                yield label, planner, condition
