"""What `owm evaluate prediction` does: predictors by their names, on the same held-out windows of several datasets."""

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import jax

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.ekf import HELD_COMMANDS, RECORDED_COMMANDS, ErrorStateEKF
from owm.baselines.exact import ExactDynamics
from owm.baselines.least_squares import fit_least_squares
from owm.catalogue.hub import checkpoint_folder
from owm.catalogue.policies import ZEROED_PREFIX, content_digest, read_model, zeroed
from owm.console import announce, bar
from owm.data.recordings import at_model_rate, corpus_facts, read_recordings, training_episodes
from owm.data.windows import Episodes
from owm.model.world_model import LearnedWorldModel
from owm.report.plots import calibration_figure, prediction_figure
from owm.report.tables import calibration_table, error_table
from owm.report.terminal import print_table
from owm.scores.calibration import Calibration, calibration
from owm.scores.prediction import PredictionError, prediction_error
from owm.training.validation import PLANNER_STYLE
from owm_envs.claims import Claim
from owm_envs.config import DockingConfig, load_config
from owm_envs.datasets.fetch import local_dataset
from owm_envs.figures import save_figure
from owm_envs.files import write_atomically

BASELINES = ("constant-velocity", "least-squares", "ekf", "exact")
"""Scored beside what is asked for."""
NAMED = (*BASELINES, "least-squares-action-only")
"""Predictors that need no checkpoint; those of least squares are fitted to the dataset's train split."""
FILES = ("prediction.json", "prediction.png")
"""Of the scores; beside them `calibration.png`, where something is calibrated."""
HORIZONS = tuple(range(1, 65))
SPREAD_HORIZONS = (1, 2, 4, 8, 16, 32, 64)


def evaluate_prediction(
    models: Sequence[str],
    data: Sequence[Path],
    *,
    split: str | None = None,
    windows: int = 256,
    spread_windows: int = 48,
    samples: int = 199,
    seed: int = 0,
    out: Path = Path("runs/prediction"),
) -> tuple[dict[str, list[PredictionError]], dict[str, list[Calibration]]]:
    """Score open-loop predictions of behaviour and of planner-style flights; print tables, write JSON and pictures.

    Args:
        models: of `NAMED`, or folders of checkpoints, "zeroed:" before them or not; `BASELINES` are scored beside them
            on the same instants, the filter with the longest of their histories.
        data: datasets, each a folder or one of the hub's.
        split: one of theirs; by default the flights that training sets aside.
        windows: of each kind in each dataset, for the errors.
        spread_windows: for the calibration of those whose steps are samples.
        samples: trajectories of each of these.
        seed: decides the windows.
        out: folder for the files.

    Returns:
        Errors and calibrations by "dataset, kind"; nothing where `out` holds them already.

    Raises:
        ValueError, FileNotFoundError: no such model, dataset or split, or episodes too short.
        FolderTaken: `out` holds other scores or something else.
    """
    for option, value in (("windows", windows), ("spread_windows", spread_windows)):
        if value < 1:
            raise ValueError(f"{option} must be at least 1, got {value}")
    for name in models:
        if name not in NAMED:
            checkpoint_folder(name.removeprefix(ZEROED_PREFIX), "predictor", NAMED)
    folders = _folders(data)
    asked = {"command": "owm evaluate prediction", "split": split, "windows": windows, "samples": samples, "seed": seed}
    asked |= {"models": {name: name if name in NAMED else content_digest(name) for name in models}}
    asked |= {"spread_windows": spread_windows, "data": [_told(folder) for folder in folders.values()]}
    errors: dict[str, list[PredictionError]] = {}
    spreads: dict[str, list[Calibration]] = {}
    with Claim(out, asked) as claim:
        if claim.found and claim.found.get("done") and claim.holds(*FILES):
            announce(f"{claim.folder} holds these scores already")
            return {}, {}
        files: list[Path] = []
        for called, path in folders.items():
            train, held_out = training_episodes(path, phases=1)
            if split is not None:
                held_out = at_model_rate(read_recordings(path, split))
            config = dataset_config(path)
            for kind, others in (("behaviour", True), ("planner-style", False)):
                part = held_out.flown_by(PLANNER_STYLE, others=others)
                if part is None:
                    announce(f"{called} holds no {kind} flights")
                    continue
                group = f"{called}, {kind}"
                held = HELD_COMMANDS if kind == "planner-style" else RECORDED_COMMANDS
                scored = {name: predictor(name, config, train, held) for name in (*models, *BASELINES)}
                counts = {"windows": windows, "spread_windows": spread_windows, "samples": samples, "seed": seed}
                errors[group], spreads[group] = _score(group, scored, part, **counts)
                print_table(error_table(errors[group]), f"{group}: mean prediction error")
                if spreads[group]:
                    print_table(calibration_table(spreads[group]), f"{group}: samples against outcomes")
                claim.note(done=False)
                files = write_predictions(errors, spreads, claim.folder)
        claim.seal(*(file.name for file in files), done=True)
    for file in files:
        print(file)
    return errors, spreads


def _folders(data: Sequence[Path]) -> dict[str, Path]:
    """Where datasets lie, by what to call them: their folders' names where these tell them apart.

    Raises:
        ValueError: one of them is named twice.
    """
    folders = {os.fspath(path): local_dataset(path) for path in data}
    if len({folder.resolve() for folder in folders.values()}) < len(data):
        raise ValueError(f"name each dataset once, got {', '.join(map(str, data))}")
    short = [Path(path).name for path in folders]
    return dict(zip(short if len(set(short)) == len(short) else folders, folders.values()))


def _score(
    group: str, models: dict[str, Any], part: Episodes, *, windows: int, spread_windows: int, samples: int, seed: int
) -> tuple[list[PredictionError], list[Calibration]]:
    """Score models on the same instants, whatever each wants to know of what went before."""
    history = max(model.history_length for model in models.values())
    models = models | {"ekf": replace(models["ekf"], history_length=history)}
    errors, spreads = [], []
    names = [model.name for model in models.values()]
    with bar(f"predicting {group}", "models") as update:
        for done, (asked, model) in enumerate(models.items()):
            update(done, len(models), model.name)
            called = model.name if names.count(model.name) == 1 else asked
            whole, own = history + max(HORIZONS), model.history_length + max(HORIZONS)
            with jax.enable_x64(getattr(model, "precision", "float32") == "float64"):
                drawn = part.windows(whole, windows, seed=seed).last(own)
                errors.append(replace(prediction_error(model, drawn, HORIZONS), name=called))
                if outcome := sampled_outcome(model):
                    drawn = part.windows(whole, spread_windows, seed=seed + 1).last(own)
                    told = calibration(model, drawn, SPREAD_HORIZONS, samples=samples, outcome=outcome, seed=seed)
                    spreads.append(replace(told, name=called))
        update(len(models), len(models))
    return errors, spreads


def _told(path: Path) -> str:
    """Fingerprint of what a dataset says of itself, the statistics of its numbers among it."""
    files = sorted(Path(path).rglob("*.json"))
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def write_predictions(
    errors: dict[str, list[PredictionError]], spreads: dict[str, list[Calibration]], out: Path
) -> list[Path]:
    """Write what is scored so far as JSON and pictures."""
    files = [out / name for name in FILES]
    rows = {
        key: [{"group": group} | row for group, each in groups.items() for scored in each for row in scored.rows()]
        for key, groups in (("error", errors), ("calibration", spreads))
    }
    write_atomically(files[0], lambda file: json.dump(rows, file, indent=1), text=True)
    save_figure(prediction_figure(errors), files[1])
    if any(spreads.values()):
        files.append(out / "calibration.png")
        save_figure(calibration_figure(spreads), files[2])
    return files


def predictor(name: str, config: DockingConfig, train: Episodes, process_noise: tuple[float, ...]) -> Any:
    """Return a world model by its name or folder.

    Args:
        name: of `NAMED`, or the folder of a checkpoint, which the model is then called by, with or without "zeroed:".
        config: what the dataset was recorded in: exact dynamics and filter are told of it.
        train: what least squares is fitted to.
        process_noise: of the filter.

    Raises:
        ValueError, FileNotFoundError: there is no such model.
    """
    if name == "constant-velocity":
        return ConstantVelocity()
    if name == "ekf":
        return ErrorStateEKF(config, process_noise=process_noise)
    if name == "exact":
        return ExactDynamics(config.fidelity, config)
    if name in ("least-squares", "least-squares-action-only"):
        return fit_least_squares(train, motion=name == "least-squares")
    path = name.removeprefix(ZEROED_PREFIX)
    model = read_model(checkpoint_folder(path, "predictor", NAMED), name, config)
    if isinstance(model, LearnedWorldModel):
        folder = Path(path)
        model = replace(model, name=folder.parent.name if folder.name == "model" else folder.name)
    return model if path == name else zeroed(model)


def sampled_outcome(model: Any) -> str | None:
    """What a model's samples are samples of: "truth" or "measurement"; None if its steps ignore their keys."""
    if isinstance(model, LearnedWorldModel):
        return "measurement"
    return "truth" if isinstance(model, ErrorStateEKF) else None


def dataset_config(path: Path) -> DockingConfig:
    """Return fidelity and noise of a dataset where it tells; otherwise `iss-numerical` with cooperative noise."""
    facts = corpus_facts(path)
    if "noise" not in facts:
        announce(f"{path} does not tell its noise; the filter takes it for cooperative")
    return load_config(fidelity=facts.get("fidelity", "iss-numerical"), noise=facts.get("noise", "cooperative"))
