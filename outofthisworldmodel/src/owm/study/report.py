"""What a matrix says: tables, comparisons and pictures of every study, as a report, CSV and JSON."""

import csv
import importlib.metadata
import itertools
import json
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from owm import __version__
from owm.catalogue.policies import GIVEN, GIVEN_COLUMNS, Given, checkpoint_folder, kind_of
from owm.checkpoint import read_header
from owm.report.page import Block, Code, Picture, Table, bullets, write_report
from owm.report.paper import DIFFERENCES, NOT_ALIKE, PLANNER_BY_PORT, PPO_BY_PORT, paper_table
from owm.report.plots import port_figure, speed_figure, tolerance_figure, trajectory_figure
from owm.report.tables import (
    condition_table,
    definitions_table,
    docking_table,
    failures,
    pace_table,
    pairs_table,
    port_table,
)
from owm.scores.docking import check_identical_starts
from owm.scores.flights import Flights, score, score_groups, speed_by_range, succeeded
from owm.scores.statistics import Pairs, holm, pair
from owm.study.conditions import CONDITIONS, Condition
from owm.study.matrix import Matrix, Study, flights_asked, row_name, study_keys
from owm_envs.figures import save_figure
from owm_envs.files import slug, write_atomically

Key = tuple[str, str | None, str]
Flown = Mapping[Key, Sequence[Flights]]
DEFINITIONS = {"1 m": (1.0, False), "strict": (0.1, True)}
"""What paired comparisons count as success, always without a collision: tolerance m, and whether bounds hold, too."""
_MOST_DRAWN, _MOST_FAILURES = 8, 40


def write_matrix_report(
    matrix: Matrix,
    flown: Flown,
    out: Path,
    *,
    conditions: Mapping[str, Condition] = CONDITIONS,
    commands: str = "",
    extra: Sequence[Block] = (),
) -> list[Path]:
    """Write `report.md`, `report.html`, `figures/`, `results.csv` and `results.json`.

    Args:
        matrix: what was flown.
        flown: as `run_matrix` gives it.
        out: folder.
        conditions: by name.
        commands: what a reader types to repeat it.
        extra: blocks to put before "How this was run", such as predictions.

    Raises:
        ValueError: rows of a study did not fly the same starts.
    """
    comparisons = {}
    blocks: list[Block] = [_opening(matrix, flown, conditions)]
    for study in matrix.studies:
        wanted = rows_flown(matrix, study, flown)
        comparisons[study.title] = compare(matrix, study, wanted)
        blocks += _study(matrix, study, wanted, out / "figures", conditions, comparisons[study.title])
    blocks += [*_given(matrix, flown), *_paper(matrix, flown), *extra, *_run(matrix, out, commands)]
    files = write_report(matrix.title, blocks, out)
    return [*files, _write_csv(flown, out), _write_json(matrix, flown, out, comparisons)]


def rows_flown(matrix: Matrix, study: Study, flown: Flown) -> Flown:
    """A study's rows, and of those that another study flies more often the first trials of each port."""
    rows = {}
    for key in study_keys(matrix, study):
        count = flights_asked(matrix, study, key)
        if key in flown:
            seeds = flown[key][: study.seeds]
            rows[key] = [each.select(_trial(each) < count) for each in seeds]
    return rows


def _trial(flights: Flights) -> Int[np.ndarray, "N"]:
    """Which flight to its port each one is, from 0, in the order of the seeds."""
    order = np.argsort(np.argsort(flights.seed, kind="stable"), kind="stable")
    return np.array([np.sum((flights.port == port) & (order < rank)) for port, rank in zip(flights.port, order)])


def compare(matrix: Matrix, study: Study, flown: Flown) -> dict[str, list[Pairs]]:
    """Every row of a study against its references under the same condition, by definition of success.

    Of a reference the row with the same planner variant is taken, or else its first.
    """
    keys = [key for key in study_keys(matrix, study) if key in flown]
    families: dict[str, list[Pairs]] = {name: [] for name in DEFINITIONS}
    for key, reference in itertools.product(keys, study.against):
        label, planner, condition = key
        known = [k for k in keys if k[0] == reference and k[2] == condition]
        same = [k for k in known if k[1] == planner] or known[:1]
        # Two references meet once.
        if label == reference or not same or label in study.against[study.against.index(reference) :]:
            continue
        for name, (tolerance, full) in DEFINITIONS.items():
            one, other = (
                (row_name(*k), flown[k][0].digest, succeeded(flown[k][0], tolerance, full=full)) for k in (key, same[0])
            )
            families[name].append(pair(one, other))
    return families


def _opening(matrix: Matrix, flown: Flown, conditions: Mapping[str, Condition]) -> str:
    count = sum(len(each) for seeds in flown.values() for each in seeds)
    nominal = f" Nominal: {conditions['nominal'].what}." if "nominal" in conditions else ""
    return (
        f"{count:,} flights to {len(matrix.ports)} ports in `iss-numerical`, 4 Hz decisions, 360 s.{nominal} Starts "
        f"are seeded by port and trial (seed {matrix.seed}), so that all rows fly the same ones, told by a digest of "
        "the true initial state. A collision is recorded and does not end a flight, but it fails every success column."
    )


def _study(matrix, study: Study, flown: Flown, figures: Path, conditions, families) -> Iterator[Block]:
    wanted = list(study_keys(matrix, study))
    keys = [key for key in wanted if key in flown]
    yield f"## {study.title}"
    if study.text:
        yield study.text
    if len(keys) < len(wanted):
        yield f"**Not flown:** {'; '.join(row_name(*key) for key in wanted if key not in flown)}."
    if not keys:
        return
    changed = [name for name in study.conditions if name != "nominal"]
    if changed:
        yield bullets([f"**{name}**: {conditions[name].what}." for name in changed])
    if len(study.conditions) > 1:
        cells = {(row_name(label, planner), condition): flown[label, planner, condition]
                 for label, planner, condition in keys}  # fmt: skip
        yield condition_table(cells, 0.1, full=True)
        yield condition_table(cells, 1.0, full=False)
        yield pace_table(cells, study.against[-1] if study.against else None)
    for condition in study.conditions:
        rows = [flown[key] for key in keys if key[2] == condition]
        if not rows:
            continue
        by_count: dict[int, list[Flights]] = {}
        for seeds in rows:
            for each in seeds:
                by_count.setdefault(len(each), []).append(each)
        for group in by_count.values():
            check_identical_starts(group)
        given = {row_name(*key): _tokens(given_of(matrix, key)) for key in keys}
        if len(study.conditions) > 1:
            yield f"### {condition}"
        table = docking_table(rows, given=given, by_split=True)
        # The columns are explained once.
        yield table if study is matrix.studies[0] and condition == study.conditions[0] else replace(table, caption="")
    if families["1 m"]:
        yield f"### {study.title}: paired comparisons"
        yield pairs_table(list(families.items()))
    first = [key for key in keys if key[2] == study.conditions[0] and key[1] in (None, study.planners[0])]
    drawn = [flown[key][0] for key in keys if row_name(*key) in study.draw] or [flown[key][0] for key in first]
    drawn = drawn[:_MOST_DRAWN]
    if study.figures:
        yield from _figures(drawn, figures, slug(study.title))
    if drawn and study.figures:
        yield f"### {study.title}: by port"
        yield port_table(drawn)
        yield f"### {study.title}: all definitions of success"
        yield definitions_table(drawn)
        yield from _failed(drawn)
    for key in keys:
        if (name := row_name(*key)) in study.trajectories:
            path = figures / f"trajectories_{slug(name)}.png"
            save_figure(trajectory_figure(flown[key][0]), path, dpi=80)
            yield Picture(path, f"{name}: {len(flown[key][0])} flights.")


def _figures(drawn: Sequence[Flights], figures: Path, name: str) -> Iterator[Block]:
    pictures = {
        "tolerance": (
            tolerance_figure(drawn),
            "Flights with no collision by their errors at closest approach; dashed: the bounds of strict success.",
        ),
        "ports": (
            port_figure(drawn, {"paper: planner": PLANNER_BY_PORT, "paper: PPO": PPO_BY_PORT}),
            f"Flights within 1 m with no collision by port; bars: 95 % Wilson intervals. {NOT_ALIKE}",
        ),
        "speed": (speed_figure(drawn), "Speed against range, all decisions: medians and the middle four fifths."),
    }
    for kind, (figure, caption) in pictures.items():
        path = figures / f"{kind}_{name}.png"
        save_figure(figure, path, dpi=100)
        yield Picture(path, caption)


def _failed(drawn: Sequence[Flights]) -> Iterator[Block]:
    table = failures([each for each in drawn if succeeded(each, 1.0).mean() >= 0.5])
    if table.rows:
        more = len(table.rows) - _MOST_FAILURES
        caption = table.caption.rstrip(".") + ", of policies that failed less than half of the time."
        caption += f" {more} more of them are left out." if more > 0 else ""
        yield Table(table.columns, table.rows[:_MOST_FAILURES], caption)


def given_of(matrix: Matrix, key: Key) -> Given:
    """What a row was given: its policy's, less what its planner variant leaves out."""
    label, planner, _ = key
    source, planner = matrix.sources(label)[0], planner or ""
    kind = kind_of(source)
    given = GIVEN[kind]
    if kind.endswith("world model"):
        config = read_header(checkpoint_folder(source)).config
        given = given._replace(motion=f"{given.motion} ({config.get('stream')} stream, {config.get('backbone')})")
    if "plain" in planner or "straight" in planner:
        given = given._replace(hull="clearance only, no field")
    if planner == "safe":
        given = given._replace(motion=f"{given.motion}; drifts by Clohessy and Wiltshire's")
    if "no corrector" in planner:
        given = given._replace(feedback="no")
    return given


def _tokens(given: Given) -> str:
    """What a row was given, in a few words for a column."""
    feedback = given.feedback.removeprefix("yes: ").replace("bias ", "")
    words = {
        given.hull.removeprefix("yes: geodesic "): not given.hull.startswith("no"),
        "keep-out sphere": "sphere" in given.hull,
        "exact dynamics": "simulator" in given.motion,
        "orbital dynamics": "Clohessy" in given.motion,
        "mass": given.mass == "yes",
        "noise model": given.noise != "no",
        feedback: feedback != "no",
        given.data.partition(" ")[0].rstrip(",").replace("flying", "reward"): given.data != "nothing",
    }
    return ", ".join(word for word, said in words.items() if said) or "goal only"


def _given(matrix: Matrix, flown: Flown) -> Iterator[Block]:
    yield "## What each row was given"
    yield (
        "Every policy receives the noisy measurement, its port's hold pose and the thrusters' limits; none receives "
        "the truth, and none is told what a condition changes, but for the noise preset. Beyond that:"
    )
    rows = {row_name(label, planner): given_of(matrix, (label, planner, "")) for label, planner, _ in flown}
    yield Table(["policy", *GIVEN_COLUMNS], [[name, *given] for name, given in rows.items()])


def _paper(matrix: Matrix, flown: Flown) -> Iterator[Block]:
    rows = [seeds for (_, planner, condition), seeds in flown.items()
            if condition in ("nominal", "near") and planner in (None, "geodesic")]  # fmt: skip
    if rows:
        yield "## Next to the paper"
        yield paper_table(rows)
        yield bullets(DIFFERENCES)


def _run(matrix: Matrix, out: Path, commands: str) -> Iterator[Block]:
    yield "## How this was run"
    if commands:
        yield Code(commands)
    packages = ("jax", "jaxlib", "numpy", "gymnasium", "equinox")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
    stores = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((out / "flights").rglob("row.json"))]
    ports = [port for store in stores for port in store.get("ports", {}).values()]
    sources, seconds = sorted({port["source"] for port in ports}), sum(port["seconds"] for port in ports)
    yield (
        f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} "
        f"processors; outofthisworldmodel {__version__}, {versions}. {seconds / 60:.0f} minutes of flying in all "
        f"processes, compilation included, by source code of digest {', '.join(sources)}. Everything follows from seed "
        f"{matrix.seed}."
    )
    yield Code(json.dumps(matrix.model_dump(mode="json", exclude_defaults=True), indent=1))


def _write_csv(flown: Flown, out: Path) -> Path:
    """One line a row and port, and pooled ones."""
    rows = []
    for (label, planner, condition), seeds in flown.items():
        for copy, each in enumerate(seeds):
            for group, scores in score_groups(each).items():
                success = scores["success"]
                rows.append(
                    {
                        "policy": label,
                        "trained_seed": copy,
                        "planner": planner or "",
                        "condition": condition,
                        "ports": group,
                        "flights": scores["collision"]["total"],
                        **{name.replace(" ", "_"): numbers["count"] for name, numbers in success.items()},
                        **{k: scores[k]["count"]
                           for k in ("collision", "escape", "timeout", "docked", "idss", "idss_or_slower")},
                        **{k: _rounded(scores[k])
                           for k in ("safe_share", "far_safe_share", "avoidable_share", "median_time", "median_delta_v",
                                     "median_angular_impulse", "least_clearance")},
                    }
                )  # fmt: skip
    path = out / "results.csv"

    def write(file):
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)

    write_atomically(path, write, text=True)
    return path


def _write_json(matrix: Matrix, flown: Flown, out: Path, comparisons) -> Path:
    content: dict[str, Any] = {
        "matrix": matrix.model_dump(mode="json"),
        "version": __version__,
        "rows": [],
        "pairs": [],
    }
    for (label, planner, condition), seeds in flown.items():
        for copy, each in enumerate(seeds):
            scores = score(each)
            content["rows"].append(
                {
                    "policy": label,
                    "trained_seed": copy,
                    "planner": planner,
                    "condition": condition,
                    "flights": len(each),
                    "starts": each.starts_digest,
                    "decision_seconds": _rounded(each.decision_seconds),
                    "scores": {k: _rounded(v) for k, v in scores.items()},
                    "speed_by_range": [{k: _rounded(v) for k, v in row.items()} for row in speed_by_range(each)],
                }
            )
    for title, families in comparisons.items():
        adjusted = iter(holm([each.p for pairs in families.values() for each in pairs]))
        for name, pairs in families.items():
            content["pairs"] += [
                {"study": title, "success": name, **vars(each), "p": _rounded(each.p), "holm": _rounded(next(adjusted))}
                for each in pairs
            ]
    path = out / "results.json"
    write_atomically(path, lambda file: json.dump(content, file, indent=1), text=True)
    return path


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, float):
        return None if value != value else float(f"{value:.5g}")
    return value
