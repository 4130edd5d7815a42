"""Training from episodes to a published world model, resumable at any moment."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from jax.sharding import Mesh
from rich.console import Console

from owm.checkpoint import CheckpointError, check_finite, read_checkpoint, read_header, save_world_model
from owm.data.windows import Episodes, Windows
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Params
from owm.training import rundir
from owm.training.autobatch import compiled_bytes, largest_batch, memory_budget
from owm.training.config import TrainConfig
from owm.training.metrics import Metrics, View
from owm.training.step import TrainState, batch_mesh, initial_state, put, train_chunk
from owm.training.validation import coasting_score, validate, validation_sets
from owm_envs.claims import Claim
from owm_envs.shell import terminal
from owm_envs.view import View as RelativeView


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
    about: Mapping[str, Any] | None = None,
    wandb: str | None = None,
) -> TrainResult:
    """Train a world model and publish the weights with the best validation score as `out_dir/model`.

    `owm.training.validation` says what the score is, `owm.training.rundir` what lies where. A killed run leaves no
    model but resumes: the same weights follow, bit for bit, as without the kill.

    Args:
        config: how to train; a directory that holds a run of another configuration or data is refused.
        episodes_train: statistics and windows come from here.
        episodes_val: chooses the best weights.
        out_dir: where everything goes.
        resume: continue, or return, what `out_dir` holds; otherwise start over.
        console: for progress; a quiet one silences it.
        name: what reports will call the model.
        about: JSON-able facts to keep beside the weights, such as `corpus`, what they were trained on.
        wandb: project of Weights & Biases to send the metrics to as well.

    Raises:
        ValueError: if the data doesn't fit the configuration or holds too little to learn from, batch, memory and
            devices don't go together, or the best weights predict no better than constant velocity.
        FolderTaken: `out_dir` holds another run or something else.
        CheckpointError: its run is damaged.
        FloatingPointError: a statistic, the loss or the validation score is not finite.
    """
    _check_data(config, episodes_train, episodes_val)
    fingerprint = {
        "config": config.model_dump(mode="json"),
        "train": episodes_train.digest(),
        "val": episodes_val.digest(),
    }
    form = {"settled": {"batch": int, "devices": int}}
    claim = Claim(out_dir, fingerprint, made=rundir.PARTS, facts=form, replace=not resume)
    out = claim.folder
    if resume and _found(claim) and (out / "model").exists():
        model = read_checkpoint(out / "model", partial(LearnedWorldModel.from_contents, expect=config.model))
        said = read_header(out / "model").about
        return TrainResult(model, said.score, said.step, out / "model", out / "metrics.jsonl")
    statistics = _fitted(config, episodes_train)
    console = terminal() if console is None else console
    with claim:
        if not resume:
            claim.start_over()
        return _go_on(config, statistics, episodes_train, episodes_val, claim, console, name, dict(about or {}), wandb)


def _found(claim: Claim) -> dict[str, int] | None:
    """Batch size and devices as an earlier start settled them, if one did."""
    return (claim.found or {}).get("settled")


def _go_on(
    config: TrainConfig,
    statistics: Any,
    episodes_train: Episodes,
    episodes_val: Episodes,
    claim: Claim,
    console: Console,
    name: str,
    about: dict[str, Any],
    wandb: str | None,
) -> TrainResult:
    """Settle batch size and devices, unless an earlier start has, train, and publish; the folder is this process's."""
    out, found = claim.folder, _found(claim)
    devices = _devices(found["devices"] if found else config.devices)
    mesh = batch_mesh(devices)
    rows = jax.tree.map(jnp.asarray, (episodes_train.observation, episodes_train.action))
    dtype = rows[1].dtype
    depths = {depth for _, depth in config.rollouts}
    starts = {depth: jnp.asarray(episodes_train.starts(config.model.history_length + depth)) for depth in depths}
    windows = len(starts[max(depths)])
    statistics, rows, starts = put(mesh, (statistics, rows, starts))

    def lowered(batch: int) -> Any:
        """The costliest step at a batch size, to be compiled."""
        settled = config.settled(windows, batch, devices)
        state = jax.eval_shape(lambda: initial_state(settled, dtype))
        model = LearnedWorldModel(config.model, Params(state.network, statistics), name)
        return train_chunk.lower(
            settled, model, state.network, state.optimizer, statistics, rows, starts[max(depths)], state.step,
            depth=max(depths), count=config.chunk, mesh=mesh,
        )  # fmt: skip

    if found is None:
        batch = config.batch
        if batch == "auto":
            budget = memory_budget(config.memory_gb)
            with console.status("finding the batch size: each try compiles a step ..."):
                batch = largest_batch(lambda b: compiled_bytes(lowered(b).compile()), budget, devices, windows)
            console.print(f"batch {batch}")
        if batch % devices:
            raise ValueError(f"batch must be a multiple of devices={devices}, got {batch}")
        found = {"batch": batch, "devices": devices}
        claim.note(settled=found)
    if not 1 <= found["batch"] <= windows:
        raise CheckpointError(f"{claim.file} is damaged: a batch of {found['batch']} windows, of {windows} in all")
    config = config.settled(windows, **found)
    said = {
        **about,
        "train_steps": episodes_train.steps,
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(lambda: initial_state(config)).network)),
        "settled": config.model_dump(mode="json", exclude={"model"}),
        "run": claim.asked,
    }
    state = _run(config, statistics, rows, starts, episodes_val, out, mesh, dtype, console, name, said, wandb)
    model = LearnedWorldModel(config.model, Params(state.best_network, statistics), name)
    trivial = coasting_score(config.model, validation_sets(config, episodes_val))
    if not float(state.best_score) < trivial:
        raise ValueError(
            f"the best weights score {float(state.best_score):.4g} in validation, constant velocity {trivial:.4g}: not "
            f"published; train for more steps, or {_MORE}"
        )
    said |= {"score": float(state.best_score), "step": int(state.best_step)}
    save_world_model(model, out / "model", about=said)
    return TrainResult(model, said["score"], said["step"], out / "model", out / "metrics.jsonl")


def _run(
    config: TrainConfig,
    statistics: Any,
    rows: tuple,
    starts: dict[int, Any],
    episodes_val: Episodes,
    out: Path,
    mesh: Mesh | None,
    dtype: Any,
    console: Console,
    name: str,
    about: dict[str, Any],
    wandb: str | None,
) -> TrainState:
    """Go from the latest save, or the beginning, to the last step; `config` is settled."""
    sets = validation_sets(config, episodes_val)
    with rundir.state_manager(out) as manager:
        state = put(mesh, rundir.restore(manager, initial_state(config, dtype)))
        step = int(state.step)
        # The static part alone goes into compiled calls: no weights live in it.
        model = LearnedWorldModel(config.model, Params(state.network, statistics), name)
        with Metrics(out, step or -1, wandb, about) as metrics, View(console, config.steps, step) as view:
            if step == 0:
                # Untrained, the model is its least-squares map: what is published never scores worse than that.
                line = {"step": 0} | _judged(model, model.params, sets, 0)
                state = _keep_best(state, line["score"])
                metrics.write(line)
                view.update(line)
            while step < config.steps:
                depth = config.rollout_at(step)
                network, optimizer, losses, norms = train_chunk(
                    config, model, state.network, state.optimizer, statistics, rows, starts[depth], state.step,
                    depth=depth, count=config.chunk, mesh=mesh,
                )  # fmt: skip
                state = state._replace(step=state.step + config.chunk, network=network, optimizer=optimizer)
                step = int(state.step)
                terms = {f"{term}_loss": float(value.mean()) for term, value in losses._asdict().items()}
                if not np.isfinite(sum(terms.values())):
                    raise FloatingPointError(f"the loss is not finite at step {step}; lower learning_rate")
                line = {"step": step, "rollout": depth, **terms, "gradient_norm": float(norms.mean())}
                save = step % config.save_every == 0 or step >= config.steps
                if save:
                    line |= _judged(model, Params(network, statistics), sets, step)
                    state = _keep_best(state, line["score"])
                    saved = LearnedWorldModel(config.model, Params(network, statistics), f"{name}, step {step}")
                    told = about | {"score": line["score"], "step": step}
                    rundir.keep_checkpoint(out, saved, step, config.keep_checkpoints, told)
                metrics.write(line)
                if save:
                    manager.save(step, args=ocp.args.StandardSave(state))
                view.update(line)
    return state


def _fitted(config: TrainConfig, episodes: Episodes) -> Any:
    """The statistics of the training episodes.

    Raises:
        FloatingPointError: one is not finite.
    """
    try:
        statistics = STREAMS[config.model.stream].fit(episodes)
        check_finite(statistics)
    except (CheckpointError, np.linalg.LinAlgError) as error:
        raise FloatingPointError(f"of the training episodes' statistics, {error}; {_MORE}") from None
    return statistics


def _judged(model: LearnedWorldModel, params: Params, sets: dict[str, Windows], step: int) -> dict[str, float]:
    """What `validate` says.

    Raises:
        FloatingPointError: the score is not finite.
    """
    line = validate(model, params, sets)
    if not np.isfinite(line["score"]):
        cause = _MORE if step == 0 else f"lower learning_rate, or {_MORE}"
        raise FloatingPointError(f"predictions diverge in validation at step {step}: the score is not finite; {cause}")
    return line


def _keep_best(state: TrainState, score: float) -> TrainState:
    if not score < float(state.best_score):
        return state
    return state._replace(
        best_network=jax.tree.map(jnp.copy, state.network),
        best_score=jnp.full_like(state.best_score, score),
        best_step=state.step,
    )


def _devices(wanted: int | None) -> int:
    """How many local devices share a batch.

    Raises:
        ValueError: there are fewer than wanted, or none is.
    """
    there = jax.local_device_count()
    if wanted is not None and not 0 < wanted <= there:
        raise ValueError(f"devices must be at most {there}, the local devices, got {wanted}")
    return wanted or there


_MORE = "record more flights, of different policies (owm-envs generate --transitions 20000 or more)"
"""What to do about data that teach nothing."""


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
    windows = len(train.starts(config.model.history_length + longest))
    if isinstance(config.batch, int) and windows < config.batch:
        raise ValueError(f"the training episodes hold {windows} windows, fewer than batch={config.batch}; {_MORE}")
    rows = train.starts(2)  # of an episode's last row the action is padding
    columns = {"force": train.action[rows, :3], "torque": train.action[rows, 3:]}
    view = RelativeView.of(train.view[rows])  # attitude varies as the rate does
    columns |= {"position": view.position, "velocity": view.velocity, "body rate": view.rate}
    still = [
        f"{name} {axis}"
        for name, numbers in columns.items()
        for axis, column in zip("xyz", numbers.T)
        if np.ptp(column) <= 1e-6 * np.abs(column).max()
    ]
    if still:
        raise ValueError(f"the training episodes never vary {', '.join(still)}: nothing can be learned of it; {_MORE}")
