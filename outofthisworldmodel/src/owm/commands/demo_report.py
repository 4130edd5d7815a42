"""What `owm demo` writes about itself."""

import importlib.metadata
import itertools
import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from owm import __version__
from owm.catalogue.policies import GIVEN, GIVEN_COLUMNS
from owm.report.page import Block, Code, Picture, Table, bullets, write_report
from owm.report.paper import DIFFERENCES, paper_table
from owm.report.plots import (
    loss_figure,
    prediction_figure,
    tolerance_figure,
    trajectory_figure,
)
from owm.report.tables import (
    definitions_table,
    docking_table,
    failures,
    percent,
    port_table,
    prediction_table,
)
from owm.scores.flights import Flights, succeeded
from owm.scores.prediction import PredictionError
from owm.scores.statistics import rate
from owm.training.config import PRESETS
from owm_envs.figures import save_figure
from owm_envs.files import slug


@dataclass(frozen=True)
class Results:
    """Everything the report tells."""

    scale: str
    folder: Path
    seed: int
    size: Any
    corpus: dict
    training: dict
    metrics: list[dict]
    predictions: dict[str, list[PredictionError]]
    flights: list[Flights]
    starts: str
    checks: dict[str, bool]
    seconds: dict[str, float]
    resumed: list[str]
    peak_memory: float
    """Bytes; 0 where the system does not tell."""
    replay: Path | None = None
    """Page of one flight of the world model."""


_DIFFERENCES = (
    *DIFFERENCES,
    "**Corpus.** The paper mixes random, orbit and dock; ours adds flights with random wrenches held for 2 s, as "
    "a planner's candidates are.",
    "**Model.** Ours predicts accelerations over exact rigid-body kinematics, beside a least-squares map; the paper's "
    "model has no such prior.",
    "**Count.** The paper flies 50 times to each port, this demo {trials}: mind the intervals.",
)


def write_demo_report(results: Results) -> list[Path]:
    """Draw the figures and write `report.md` and `report.html` into the demo's folder."""
    figures = results.folder / "figures"
    pictures = {
        "tolerance": tolerance_figure(results.flights),
        "loss": loss_figure(*_curves(results.metrics), _marks(results)),
        "prediction": prediction_figure(results.predictions),
    }
    pictures |= {f"trajectories_{slug(each.policy)}": trajectory_figure(each) for each in results.flights}
    for name, figure in pictures.items():
        save_figure(figure, figures / f"{name}.png", dpi=110)
    blocks = [
        *_summary(results),
        *_docking(results, figures),
        *_failed(results),
        *_prediction(results, figures),
        *_training(results, figures),
        *_trajectories(results, figures),
        "## All definitions of success",
        definitions_table(results.flights),
        *_paper(results),
        *_run(results),
    ]
    return write_report("Docking at the ISS with a learned world model", blocks, results.folder)


def _summary(results: Results) -> list[Block]:
    model, *others = results.flights
    numbers = rate(succeeded(model, 1.0))
    counts = {each.policy: rate(succeeded(each, 1.0))["count"] for each in others}
    text = (
        "The trained world model, flown by MPPI, came within 1 m of its port's hold pose with no collision in "
        f"**{numbers['count']} of {numbers['total']} flights** ({percent(numbers)}) over all eight ports. "
        f"On the same starts: {', '.join(f'{name} {count}' for name, count in counts.items())}."
    )
    if min(counts.get(name, 0) for name in ("least-squares", "dock-geodesic")) >= max(numbers["count"], 1):
        text += (
            " Least squares in the same planner and a PD down the same field dock at least as often: here it is "
            "the map of the hull, not the network, that docks."
        )
    kept = [f"{'Kept' if ok else '**Broken**'}: {promise}." for promise, ok in results.checks.items()]
    if results.replay is not None:
        text += f" [See one of them]({results.replay.name})."
    if not results.size.must_dock:
        kept[-1] += " (Not a promise at this scale: the model is trained for seconds.)"
    return [
        text,
        f"Scale `{results.scale}`, seed {results.seed}. What this demo promises:",
        bullets(kept),
    ]


def _docking(results: Results, figures: Path) -> list[Block]:
    names = [each.policy for each in results.flights]
    rows = [GIVEN["world model" if name == "pretrained" else name] for name in names]
    if results.size.planner_style:
        rows = [row._replace(data="corpus with planner-like flights") if row.data == "corpus" else row for row in rows]
    given = Table(["policy", *GIVEN_COLUMNS], [[name, *row] for name, row in zip(names, rows)])
    count = len(results.flights[0])
    return [
        "## Docking",
        (
            f"{count} flights of each policy, {count // 8} to each port, all from the same true initial states "
            f"(digest `{results.starts}`) with the same sensor noise: `iss-numerical`, cooperative noise, 4 Hz "
            "decisions, 360 s."
        ),
        docking_table(results.flights, ["world model"]),
        Picture(
            figures / "tolerance.png",
            "Flights with no collision by their errors at closest approach; dashed: the bounds of strict success.",
        ),
        "### By port",
        port_table(results.flights),
        "### What each row was given",
        (
            "Every policy receives the noisy measurement, its port's hold pose and the thrusters' limits; none "
            "receives the truth. Beyond that:"
        ),
        given,
    ]


def _failed(results: Results) -> list[Block]:
    table = failures(results.flights)
    if not table.rows:
        return ["## What failed", "Nothing: every flight came within 1 m with no collision."]
    counts = [f"{each.policy} {int((~succeeded(each, 1.0)).sum())}" for each in results.flights]
    return [
        "## What failed",
        f"Flights that collided or never came within 1 m: {', '.join(counts)}. Each of them:",
        table,
        (
            "A flight is repeated by `reset(seed=SEED, options={'dock_port': PORT})` of the environment with "
            "cooperative noise, `steps_per_action=5` and `collision_terminates=False`."
        ),
    ]


def _prediction(results: Results, figures: Path) -> list[Block]:
    blocks: list[Block] = [
        "## Prediction",
        (
            "Open-loop predictions under the true future actions, compared with the noiseless truth; means over "
            f"{results.size.windows} windows of flights that neither training nor model selection has seen. Exact "
            "dynamics are the simulator's own equations started from the last noisy measurement: close to the "
            "floor that one measurement allows (they are given mean actions and a fixed epoch)."
        ),
        Picture(figures / "prediction.png", "Mean error against horizon."),
    ]
    for group, errors in results.predictions.items():
        blocks += [f"### {group[0].upper() + group[1:]}", prediction_table(errors)]
    return blocks


def _training(results: Results, figures: Path) -> list[Block]:
    facts, corpus, config = results.training, results.corpus, results.size.train
    model = config.model
    return [
        "## Corpus and training",
        (
            f"Corpus: {corpus['train']['transitions']:,} transitions at 20 Hz in {corpus['train']['episodes']} "
            f"episodes ({_counts(corpus['train']['policies'])}) at the five train ports, which ended as "
            f"{_counts(corpus['train']['outcomes'])}. No episode of training or selection flew to a held-out "
            "port; the prototypes that the planner's constants come from did."
        ),
        (
            f"Model: {facts['parameters']:,} trained parameters ({model.blocks} block{'s' * (model.blocks > 1)} of "
            f"width {model.width}, history of {model.history_length} measurements) over the least-squares map, "
            f"{config.steps:,} optimisation steps of {config.batch} windows on {facts['steps']:,} steps of "
            f"{model.dt} s: the recording's {results.size.phases} offsets, which overlap, at about "
            f"{facts['steps'] // results.size.phases:,} steps each. Least squares is fitted to the same "
            f"{facts['episodes']} episodes, with no network; the untrained model, at step 0, predicts as it does. "
            "Least squares here is linear in action, position and velocity: it has no products of body rates, which a "
            "larger fit could have, so the network's margin in attitude over it is no margin over the best linear "
            "regression."
        ),
        (
            f"The weights of step {facts['best_step']:,} scored best on the {facts['val_episodes']} validation "
            "episodes and were kept."
            if facts["best_step"]
            else "**No trained weights scored better on the validation episodes than the untrained model: the rows "
            "of the world model are those of least squares.**"
        ),
        Picture(
            figures / "loss.png",
            "Training losses, and where a harder one began; validation errors 16 s ahead against the measurements.",
        ),
    ]


def _trajectories(results: Results, figures: Path) -> list[Block]:
    blocks: list[Block] = [
        "## Trajectories",
        (
            "Grey: the keep-out boxes. Circles: starts. Dots: ends. Blue: hold poses and corridors. Crosses: "
            "first contact with the hull. Of several flights, the upper row shows the whole way."
        ),
    ]
    for each in results.flights:
        blocks += [
            f"### {each.policy}",
            Picture(figures / f"trajectories_{slug(each.policy)}.png", f"{each.policy}: {len(each)} flights."),
        ]
    return blocks


def _paper(results: Results) -> list[Block]:
    trials = f"{results.size.trials} time{'s' if results.size.trials > 1 else ''}"
    return [
        "## Next to the paper",
        "The paper's figures for the same task, with everything that makes this no like-for-like comparison:",
        paper_table(results.flights[:1]),
        bullets([text.format(trials=trials) for text in _DIFFERENCES]),
    ]


def _run(results: Results) -> list[Block]:
    rows = [
        [name, f"{seconds:.0f}", "earlier run" if name in results.resumed else ""]
        for name, seconds in results.seconds.items()
    ]
    known = sum(results.seconds.values())
    rows.append(["all stages", f"{known:.0f}", ""])
    memory = f"{results.peak_memory / 1e9:.2f} GB" if results.peak_memory else "not measured on this system"
    packages = ("jax", "jaxlib", "numpy", "gymnasium", "equinox", "optax", "matplotlib")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
    here, size = Path.cwd(), results.size
    # As a reader would type it, not where the author's home lies.
    folder = (results.folder.relative_to(here) if results.folder.is_relative_to(here) else results.folder).as_posix()
    presets = [f"--preset {name}" for name, preset in PRESETS.items() if preset == size.train]
    training = presets[0] if presets else f"--steps {size.train.steps}"
    recording = (
        f"owm-envs generate --config {folder}/corpus/config.toml --transitions {size.transitions} "
        f"--planner-style {size.planner_style} --episodes-per-batch {size.episodes}"
    )
    commands = "\n".join(
        [
            f"owm demo --scale {results.scale} --seed {results.seed} --out {folder}",
            "",
            "# its parts",
            f"{recording} --seed {results.seed} --out DATA",
            f"owm train --data DATA --out RUN {training} --seed {results.seed}",
            "# predictions on flights of a seed that training has not seen",
            f"{recording} --seed {results.seed + 1} --out DATA2",
            f"owm evaluate prediction RUN {folder}/least-squares oracle-mppi --data DATA2 --split train",
            f"owm evaluate docking RUN {folder}/least-squares oracle-mppi dock dock-geodesic "
            f"--flights {size.trials} --slots {size.slots} --seed {results.seed}",
            f"owm fly --policy {folder}/train --port zvezda_aft --plot",
        ]
    )
    return [
        "## How this was run",
        Table(["stage", "seconds", ""], rows, f"Wall time. Peak memory of the process: {memory}."),
        (
            f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} "
            f"processors; outofthisworldmodel {__version__}, {versions}."
        ),
        (
            f"Everything follows from seed {results.seed}: the corpus, weights, batches, the starts of all flights "
            "and the planner's draws. Starts are seeded by port and trial, away from the seeds of the corpus."
        ),
        Code(commands),
    ]


def _curves(metrics: list[dict]):
    trained = [line for line in metrics if "flow_loss" in line]
    steps = [line["step"] for line in trained]
    training = {
        "flow loss": (steps, [line["flow_loss"] for line in trained]),
        "decode loss": (steps, [line["decode_loss"] for line in trained]),
    }
    scored = [line for line in metrics if "score" in line]
    names = {"behaviour/position_m": "position, 16 s ahead [m]", "behaviour/attitude_deg": "attitude, 16 s ahead [deg]"}
    validation = {
        label: ([line["step"] for line in scored], [line[key] for line in scored]) for key, label in names.items()
    }
    return training, validation


def _marks(results: Results) -> dict[str, float]:
    """Steps from which on another loss is minimised: longer rollouts, or from predictions alone."""
    trained = [line for line in results.metrics if "rollout" in line]
    marks = {
        f"rollouts of {after['rollout']} steps": after["step"]
        for before, after in itertools.pairwise(trained)
        if before["rollout"] != after["rollout"]
    }
    config = results.size.train
    return marks | ({"teacher forcing ends": config.teacher * config.steps} if config.teacher else {})


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())
