"""How good the weights are by themselves: deterministic rollouts of held-out flights of two kinds."""

import jax.numpy as jnp
import numpy as np

from owm.data import Episodes, Windows
from owm.evaluation.prediction import window_errors
from owm.model.world_model import LearnedWorldModel, Params
from owm.training.config import TrainConfig

SCORE_UNITS = (0.1, 0.05, float(np.deg2rad(1.0)), float(np.deg2rad(0.1)))
"""Position m, velocity m/s, attitude rad and rate rad/s that weigh alike in the validation score."""
PLANNER_STYLE = ("excite",)
"""Policies whose actions are like those of a planner's candidates; all others are behaviour."""


def validation_sets(config: TrainConfig, episodes: Episodes) -> dict[str, Windows]:
    """Return fixed windows of behaviour and of planner-style flights; a kind with no long enough flight is left out.

    Raises:
        ValueError: there are none of either kind.
    """
    length, sets = config.model.history_length + config.validation_horizon, {}
    for name, others in (("behaviour", True), ("planner", False)):
        part = episodes.flown_by(PLANNER_STYLE, others=others)
        if part is not None and len(part.starts(length, check=False)):
            sets[name] = part.windows(length, config.validation_windows, seed=config.seed)
    if not sets:
        episodes.starts(length)
    return sets


def validate(model: LearnedWorldModel, params: Params, sets: dict[str, Windows]) -> dict[str, float]:
    """Score autoregressive, deterministic predictions against the measurements; lower is better.

    A kind's score is the mean over windows and horizons of the four error norms in `SCORE_UNITS`, added up; `score`,
    which chooses the best weights, is the mean over the kinds. Errors are those at the last horizon.
    """
    line = {}
    for name, windows in sets.items():
        context = jnp.full(windows.observation.shape[0], model.history_length, jnp.int32)
        _, error = window_errors(model, params, windows, context)
        error = np.asarray(error, np.float64)
        last = error[:, -1].mean(axis=0)
        line |= {
            f"{name}/score": float(np.sum(error.mean(axis=(0, 1)) / np.asarray(SCORE_UNITS))),
            f"{name}/position_m": float(last[0]),
            f"{name}/velocity_mps": float(last[1]),
            f"{name}/attitude_deg": float(np.rad2deg(last[2])),
            f"{name}/rate_degps": float(np.rad2deg(last[3])),
        }
    return {"score": float(np.mean([line[f"{name}/score"] for name in sets]))} | line
