"""The PPO baseline: Stable-Baselines3 on the native vector environment, resumable, the best policy by validation."""

import csv
import io
import json
import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecNormalize

from owm.baselines.ppo.config import PPOConfig
from owm.baselines.ppo.policy import Observed, save_policy
from owm.baselines.ppo.vec_env import make_env
from owm.checkpoint import CheckpointError
from owm.training.metrics import Metrics
from owm_envs.claims import Claim
from owm_envs.files import remove, replace_folder, write_atomically
from owm_envs.shell import terminal
from owm_envs.station import TRAIN_PORTS

_VALIDATION_SEED = 2**41
"""Starts that neither training nor any evaluation flies."""
_PARAMETERS = "parameters.pt"
_SAVE_EVERY = 60.0
"""s; the most that a kill loses, but for a rollout and its update."""
_CURVE = ("step", "seconds", "steps_per_second", "train/return", "validation/return", "validation/docked")


def train_ppo(config: PPOConfig, out: Path, console: Console | None = None) -> dict[str, Any]:
    """Train to `config.steps`, or go on from the latest save; the best policy by validation return is `out/policy`.

    `out` also holds `state/STEP` (weights, the optimiser's numbers and the running statistics), `metrics.jsonl`,
    `tensorboard/`, and the learning curve as `curve.csv` and `curve.png`. Unlike a world model's, a resumed run is not
    the uninterrupted one bit for bit: episodes in flight at the kill start anew.

    Args:
        config: `steps` may be raised to go on with a finished run; all else must be as `out` has it.
        out: folder of the run.
        console: for progress.

    Returns:
        The metrics of the policy in `out/policy`.

    Raises:
        FolderTaken: `out` holds a run of another configuration, or something else.
    """
    console = terminal() if console is None else console
    with Claim(out, config.model_dump(mode="json", exclude={"steps"})) as claim:
        claim.note()
        return _train(config, claim.folder, console)


def _train(config: PPOConfig, out: Path, console: Console) -> dict[str, Any]:
    """Go on from the latest save, or begin; the folder is this process's."""
    torch.set_num_threads(1)  # a small network gains nothing from more, and they would disturb the simulation
    saves = sorted((path for path in (out / "state").glob("*") if path.name.isdigit()), key=lambda path: int(path.name))
    step = int(saves[-1].name) if saves else 0
    venv = make_env(config, config.envs, config.seed + step, training=True)
    trial = make_env(config, config.validation_episodes, _VALIDATION_SEED, training=False)
    trial.obs_rms = venv.obs_rms
    model = _resumed(config, venv, saves[-1]) if saves else _new_model(config, venv)
    spent = 0.0
    if saves:
        stored = json.loads((saves[-1] / "statistics.json").read_text(encoding="utf-8"))
        _restore_statistics(venv, stored)
        spent = stored.get("seconds", 0.0)  # older saves have none
        trial.obs_rms = venv.obs_rms
        set_random_seed(config.seed + step)
    with Metrics(out, step or -1) as metrics:
        lines = _lines(metrics.file)
        spent = max(spent, lines[-1]["seconds"] if lines else 0.0)
        exported = (out / "policy").exists()  # or it was killed while it exchanged one for a better
        best = max((line["validation/return"] for line in lines if line["step"] and exported), default=-np.inf)
        if not lines:
            lines.append({"step": 0, "seconds": 0.0, **_validate(model, trial)})
            metrics.write(lines[-1])
        every = config.validate_every * config.rollout * config.envs
        while lines[-1]["step"] < config.steps:  # what was saved since has not been validated
            began, before = time.perf_counter(), model.num_timesteps
            keep = _Saves(venv, out / "state", spent)
            model.learn(every - before % every, keep, reset_num_timesteps=False)
            # The time to validate is not the method's: it is left out of the curve.
            took = time.perf_counter() - began
            spent += took
            returns = [episode["r"] for episode in model.ep_info_buffer]
            line = {
                "step": model.num_timesteps,
                "seconds": spent,
                "steps_per_second": (model.num_timesteps - before) / took,
                **({"train/return": float(np.mean(returns))} if returns else {}),
                **_validate(model, trial),
            }
            if line["validation/return"] > best:
                best = line["validation/return"]
                _export(model, venv, out / "policy", config, line)
            lines.append(line)
            metrics.write(line)
            _save(model, venv, out / "state", spent)
            _write_curve(lines, out)
            console.print(
                f"{line['step']:>11,} of {config.steps:,} decisions  {line['steps_per_second']:7,.0f}/s  "
                f"return {line.get('train/return', np.nan):9.1f}  validation {line['validation/return']:9.1f}  "
                f"docked {line['validation/docked']:4.0%}  collided {line['validation/collided']:4.0%}"
            )
    venv.close()
    trial.close()
    return max(lines[1:], key=lambda line: line["validation/return"])


class _Saves(BaseCallback):
    """Keeps what the run goes on from between two validations, too."""

    def __init__(self, venv: VecNormalize, folder: Path, spent: float):
        super().__init__()
        self._venv, self._folder, self._spent = venv, folder, spent
        self._began = self._saved = time.monotonic()

    def _on_rollout_start(self) -> None:
        now = time.monotonic()
        if now - self._saved > _SAVE_EVERY and self.model.num_timesteps:
            _save(self.model, self._venv, self._folder, self._spent + now - self._began)
            self._saved = now

    def _on_step(self) -> bool:
        return True


def _new_model(config: PPOConfig, venv: VecNormalize) -> PPO:
    widths = list(config.network)
    return PPO(
        "MlpPolicy",
        venv,
        learning_rate=config.learning_rate,
        n_steps=config.rollout,
        batch_size=config.batch,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip,
        ent_coef=config.entropy_weight,
        vf_coef=config.value_weight,
        target_kl=config.target_kl,
        policy_kwargs={"net_arch": {"pi": widths, "vf": widths}},
        seed=config.seed,
        device="cpu",  # a small network: faster than on a GPU
    )


def _resumed(config: PPOConfig, venv: VecNormalize, save: Path) -> PPO:
    """The model of a save, of which nothing but numbers is read: Stable-Baselines3's own files may hold code.

    Raises:
        CheckpointError: the save holds anything else.
    """
    model, file = _new_model(config, venv), save / _PARAMETERS
    try:
        model.set_parameters(torch.load(file, map_location="cpu", weights_only=True), device="cpu")
    except (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, KeyError, TypeError, OSError):
        raise CheckpointError(f"{file} is damaged, or none of ours: remove {save}, and train again") from None
    model.num_timesteps = int(save.name)
    return model


def _validate(model: PPO, trial: VecNormalize) -> dict[str, float]:
    """Fly the fixed starts with the mean action: mean return, share docked and collided, median closest approach."""
    ports = np.resize(TRAIN_PORTS, trial.num_envs)
    trial.seed(_VALIDATION_SEED)
    trial.set_options([{"dock_port": str(port)} for port in ports])
    observation = trial.reset()
    ended: dict[int, dict[str, Any]] = {}
    while len(ended) < trial.num_envs:
        observation, _, done, infos = trial.step(model.predict(observation, deterministic=True)[0])
        for slot in np.flatnonzero(done).tolist():
            ended.setdefault(slot, infos[slot])
    rows = list(ended.values())
    return {
        "validation/return": float(np.mean([row["episode"]["r"] for row in rows])),
        "validation/docked": float(np.mean([row["is_success"] for row in rows])),
        "validation/collided": float(np.mean([row["collided"] for row in rows])),
        "validation/closest_m": float(np.median([row["closest_distance"] for row in rows])),
    }


def _export(model: PPO, venv: VecNormalize, folder: Path, config: PPOConfig, line: dict[str, Any]) -> None:
    """Write the actor as `owm.baselines.ppo.policy` flies it."""
    linear = [layer for layer in model.policy.mlp_extractor.policy_net if hasattr(layer, "weight")]
    weights = {"mean": venv.obs_rms.mean, "variance": venv.obs_rms.var}
    for i, layer in enumerate([*linear, model.policy.action_net]):
        weights[f"weight.{i}"] = layer.weight.detach().cpu().numpy()
        weights[f"bias.{i}"] = layer.bias.detach().cpu().numpy()
    observation = list(venv.get_attr("layout")[0].names)
    observed = Observed(env=config.env, observe_field=config.observe_field, observation=observation)
    about = {
        "noise": config.noise,
        "step": line["step"],
        "validation_return": line["validation/return"],
        "run": config.model_dump(mode="json"),
    }
    save_policy(folder, weights, observed, about)


def _save(model: PPO, venv: VecNormalize, folder: Path, spent: float) -> None:
    """Keep what the run goes on from; the folder named by the step is whole or not there."""
    file, done = io.BytesIO(), folder / str(model.num_timesteps)
    torch.save(model.get_parameters(), file)
    statistics = json.dumps(_statistics(venv) | {"seconds": spent}).encode("ascii")
    replace_folder(done, {_PARAMETERS: file.getvalue(), "statistics.json": statistics})
    for other in folder.iterdir():
        if other != done:
            remove(other)


def _statistics(venv: VecNormalize) -> dict[str, Any]:
    return {
        name: {"mean": np.asarray(part.mean).tolist(), "var": np.asarray(part.var).tolist(), "count": float(part.count)}
        for name, part in (("obs_rms", venv.obs_rms), ("ret_rms", venv.ret_rms))
    }


def _restore_statistics(venv: VecNormalize, stored: dict[str, Any]) -> None:
    for name in ("obs_rms", "ret_rms"):
        part = stored[name]
        statistics = RunningMeanStd(shape=np.shape(part["mean"]))
        statistics.mean, statistics.var = np.asarray(part["mean"]), np.asarray(part["var"])
        statistics.count = part["count"]
        setattr(venv, name, statistics)


def _lines(file: Path) -> list[dict[str, Any]]:
    if not file.exists():
        return []
    return [json.loads(text) for text in file.read_text(encoding="utf-8").splitlines()]


def _write_curve(lines: list[dict[str, Any]], out: Path) -> None:
    """Write the learning curve as CSV and picture."""
    from matplotlib.figure import Figure

    from owm_envs.figures import save_figure

    def write(file) -> None:
        rows = csv.DictWriter(file, _CURVE, extrasaction="ignore", restval="", lineterminator="\n")
        rows.writeheader()
        rows.writerows(lines)

    write_atomically(out / "curve.csv", write, text=True)
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for name, label in (("train/return", "exploring"), ("validation/return", "mean action, fixed starts")):
        points = [(line["step"], line[name]) for line in lines if name in line]
        axes.plot(*zip(*points), marker=".", label=label)
    axes.set(xlabel="decisions", ylabel="episode return", title=f"PPO, {lines[-1]['seconds'] / 60:.0f} min of training")
    axes.legend()
    save_figure(figure, out / "curve.png")
