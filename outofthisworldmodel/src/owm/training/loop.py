"""Training from episodes to a published world model, resumable at any moment."""

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from owm.data import Episodes, Windows
from owm.evaluation.prediction import window_errors
from owm.model.checkpoint import CheckpointError, load_world_model, save_world_model
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Params
from owm.training.config import TrainConfig
from owm.training.step import TrainState, initial_state, train_chunk

SCORE_UNITS = (0.1, 0.05, float(np.deg2rad(1.0)), float(np.deg2rad(0.1)))
"""Position m, velocity m/s, attitude rad and rate rad/s that weigh alike in the validation score."""


@dataclass(frozen=True)
class TrainResult:
    """What a run leaves.

    Attributes:
        model: the weights with the best validation score.
        score: that score.
        step: the step they are from.
        model_dir: where they are published.
        metrics_file: one JSON object a line, as training went.
    """

    model: LearnedWorldModel
    score: float
    step: int
    model_dir: Path
    metrics_file: Path


def train(
    config: TrainConfig,
    episodes_train: Episodes,
    episodes_val: Episodes,
    out_dir: str | os.PathLike,
    *,
    resume: bool = True,
    console: Console | None = None,
    name: str = "learned",
) -> TrainResult:
    """Train a world model and publish the weights with the best validation score as `out_dir/model`.

    The score is the mean over windows and horizons of position, velocity, attitude and rate error norms in
    `SCORE_UNITS`, of fully autoregressive, deterministic rollouts against the measurements. A killed run leaves
    no model but resumes: `out_dir/state` holds what is needed, and the same numbers follow as without the kill.

    Args:
        config: how to train; a directory that holds a run of another configuration or data is refused.
        episodes_train: statistics and windows come from here.
        episodes_val: chooses the best weights.
        out_dir: where everything goes.
        resume: continue, or return, what `out_dir` holds; otherwise start over.
        console: for progress; a quiet one silences it.
        name: what reports will call the model.

    Raises:
        ValueError: if the data doesn't fit the configuration, or `out_dir` holds another run or a damaged one.
        FloatingPointError: the loss diverged.
    """
    out = Path(out_dir)
    _check_data(config, episodes_train, episodes_val)
    fingerprint = {
        "config": config.model_dump(mode="json"),
        "train": episodes_train.digest(),
        "val": episodes_val.digest(),
    }
    if not resume and out.exists():
        for part in ("state", "model", "run.json", "metrics.jsonl"):
            _remove(out / part)
    out.mkdir(parents=True, exist_ok=True)
    _claim(out, fingerprint)
    metrics = out / "metrics.jsonl"
    if (out / "model").exists():
        model = load_world_model(out / "model", expect=config.model)
        about = json.loads((out / "model" / "config.json").read_text(encoding="utf-8"))["about"]
        return TrainResult(model, about["score"], about["step"], out / "model", metrics)

    console = Console() if console is None else console
    statistics = STREAMS[config.model.stream].fit(episodes_train)
    dtype = jnp.asarray(episodes_train.observation[:1]).dtype
    rows = (jnp.asarray(episodes_train.observation), jnp.asarray(episodes_train.action))
    history = config.model.history_length
    starts = {depth: jnp.asarray(episodes_train.starts(history + depth)) for _, depth in config.rollouts}
    validation = episodes_val.windows(history + config.validation_horizon, config.validation_windows, seed=config.seed)
    options = ocp.CheckpointManagerOptions(max_to_keep=1, enable_async_checkpointing=False, create=True)
    with ocp.CheckpointManager((out / "state").absolute(), options=options) as manager:
        state = _restore(manager, initial_state(config, dtype))
        _truncate(metrics, int(state.step) or -1)
        # The static part alone goes into compiled calls: no weights live in it.
        model = LearnedWorldModel(config.model, Params(state.network, statistics), name)
        with _progress(console) as progress:
            bar = progress.add_task("train", total=config.steps, completed=int(state.step), note="compiling")
            if int(state.step) == 0:
                # Untrained, the model is its least-squares skip: what is published never scores worse than that.
                line = {"step": 0} | validate(model, model.params, validation)
                state = _keep_best(state, line["score"])
                _append(metrics, line)
            while int(state.step) < config.steps:
                step = int(state.step)
                depth = config.rollout_at(step)
                network, optimizer, losses, norms = train_chunk(
                    config, model, state.network, state.optimizer, statistics, rows, starts[depth], state.step,
                    depth=depth, count=config.chunk,
                )  # fmt: skip
                state = state._replace(step=state.step + config.chunk, network=network, optimizer=optimizer)
                step = int(state.step)
                line = {
                    "step": step,
                    "rollout": depth,
                    "flow_loss": float(losses.flow.mean()),
                    "decode_loss": float(losses.decode.mean()),
                    "gradient_norm": float(norms.mean()),
                }
                if not np.isfinite(line["flow_loss"] + line["decode_loss"]):
                    raise FloatingPointError(f"the loss is not finite at step {step}; lower learning_rate")
                save = step % config.save_every == 0 or step >= config.steps
                if save:
                    line |= validate(model, Params(network, statistics), validation)
                    state = _keep_best(state, line["score"])
                _append(metrics, line)
                if save:
                    manager.save(step, args=ocp.args.StandardSave(state))
                note = f"F={depth} flow {line['flow_loss']:.3f} decode {line['decode_loss']:.3f}"
                best = float(state.best_score)
                progress.update(bar, completed=step, note=note + (f" best {best:.3f}" if np.isfinite(best) else ""))
    model = LearnedWorldModel(config.model, Params(state.best_network, statistics), name)
    about = {
        "score": float(state.best_score),
        "step": int(state.best_step),
        "train_steps": episodes_train.steps,
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(state.best_network)),
        "run": fingerprint,
    }
    save_world_model(model, out / "model", about=about)
    return TrainResult(model, about["score"], about["step"], out / "model", metrics)


def validate(model: LearnedWorldModel, params: Params, windows: Windows) -> dict[str, float]:
    """Score autoregressive, deterministic predictions against the measurements; lower is better."""
    context = jnp.full(windows.observation.shape[0], model.history_length, jnp.int32)
    _, error = window_errors(model, params, windows, context)
    means = np.asarray(error, np.float64).mean(axis=(0, 1))
    last = np.asarray(error[:, -1], np.float64).mean(axis=0)
    return {
        "score": float(np.sum(means / np.asarray(SCORE_UNITS))),
        "val_position_m": float(last[0]),
        "val_velocity_mps": float(last[1]),
        "val_attitude_deg": float(np.rad2deg(last[2])),
        "val_rate_degps": float(np.rad2deg(last[3])),
    }


def _keep_best(state: TrainState, score: float) -> TrainState:
    if not score < float(state.best_score):
        return state
    return state._replace(
        best_network=jax.tree.map(jnp.copy, state.network),
        best_score=jnp.asarray(score, state.best_score.dtype),
        best_step=state.step,
    )


def _check_data(config: TrainConfig, train: Episodes, val: Episodes) -> None:
    for role, episodes in (("training", train), ("validation", val)):
        if abs(episodes.dt - config.model.dt) > 1e-9:
            raise ValueError(f"{role} episodes step by {episodes.dt} s, the model by {config.model.dt} s")
    longest = max(depth for _, depth in config.rollouts)
    for role, episodes, depth in (("training", train, longest), ("validation", val, config.validation_horizon)):
        try:
            episodes.starts(config.model.history_length + depth)
        except ValueError as error:
            raise ValueError(f"{role} episodes are too short for rollouts of {depth} steps: {error}") from None


def _claim(out: Path, fingerprint: dict[str, Any]) -> None:
    """Mark the directory as this run's, or refuse it."""
    file = out / "run.json"
    if file.exists():
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
            parts = [part for part in fingerprint if found.get(part) != fingerprint[part]]
        except (ValueError, AttributeError) as error:
            raise CheckpointError(f"{file} is damaged ({error}): delete {out} or choose another folder") from error
        if parts:
            raise ValueError(
                f"{out} holds a run that differs in {', '.join(parts)}: delete it or choose another folder"
            )
        return
    if (out / "state").exists() or (out / "model").exists():
        raise CheckpointError(f"{out} holds a state or model without run.json: delete it or choose another folder")
    fresh = out / "run.json.writing"
    fresh.write_text(json.dumps(fingerprint, indent=1) + "\n", encoding="utf-8")
    os.replace(fresh, file)


def _restore(manager: ocp.CheckpointManager, state: TrainState) -> TrainState:
    step = manager.latest_step()
    if step is None:
        return state
    target = ocp.args.StandardRestore(jax.tree.map(ocp.utils.to_shape_dtype_struct, state))
    try:
        restored = manager.restore(step, args=target)
    except Exception as error:  # what is raised for a damaged file is no part of orbax's interface
        folder = manager.directory
        raise CheckpointError(
            f"{folder / str(step)} is damaged ({type(error).__name__}): delete {folder.parent} or choose another folder"
        ) from error
    # By way of NumPy: arrays that come committed to a device would have the training step compiled a second time.
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), restored)


def _append(file: Path, line: dict[str, Any]) -> None:
    with file.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line) + "\n")


def _truncate(file: Path, step: int) -> None:
    """Drop what was logged after the step that is resumed from, or everything for -1."""
    if not file.exists():
        return
    kept = []
    for text in file.read_text(encoding="utf-8").splitlines():
        try:
            if json.loads(text)["step"] <= step:
                kept.append(text)
        except (json.JSONDecodeError, KeyError):
            break  # a line cut short by the kill
    file.write_text("".join(text + "\n" for text in kept), encoding="utf-8")


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
    )
