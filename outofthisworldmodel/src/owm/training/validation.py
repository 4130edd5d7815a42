"""How good the weights are by themselves: rollouts of held-out flights of two kinds, expected and sampled."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from owm.data.windows import Episodes, Windows, history_of
from owm.model.config import ModelConfig
from owm.model.world_model import LearnedWorldModel, Params
from owm.motion.kinematics import advance, to_motion, to_view, view_error
from owm.scores.calibration import sample_views
from owm.scores.prediction import window_errors
from owm.training.config import TrainConfig
from owm_envs.task.sensors import STATE

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


def _norms(a: Float[Array, "F 13"], b: Float[Array, "F 13"]) -> Float[Array, "F 4"]:
    """Norms of the four errors between views, SI."""
    return jnp.linalg.norm(jax.vmap(view_error)(a, b).reshape(-1, 4, 3), axis=-1)


def _weighed(norms: Float[np.ndarray, "B F 4"]) -> float:
    """Their mean over windows and horizons in `SCORE_UNITS`, added up."""
    return float(np.sum(np.asarray(norms, np.float64).mean(axis=(0, 1)) / np.asarray(SCORE_UNITS)))


def coasting_score(config: ModelConfig, sets: dict[str, Windows]) -> float:
    """What `validate` would say of constant velocity and body rate: a model that scores worse is of no use."""
    errors = (_coasting_errors(config, windows.observation[STATE]) for windows in sets.values())
    return float(np.mean([_weighed(error) for error in errors]))


@partial(jax.jit, static_argnames=("config",))
def _coasting_errors(config: ModelConfig, views: Float[Array, "B L 13"]) -> Float[Array, "B F 4"]:
    """Error norms of windows, SI, against their measurements."""

    @jax.vmap
    def errors(views: Float[Array, "L 13"]) -> Float[Array, "F 4"]:
        last, measured = views[config.history_length - 1], views[config.history_length :]

        def coast(motion, _):
            motion = advance(motion, jnp.zeros_like(last[:6]), config.dt)
            return motion, to_view(motion)

        return _norms(jax.lax.scan(coast, to_motion(last, last), length=len(measured))[1], measured)

    return errors(views)


@partial(jax.jit, static_argnames=("model",))
def energy_scores(model: LearnedWorldModel, params: Params, windows: Windows) -> Float[Array, "B F 4"]:
    """Score two sampled rollouts of every window against the measurements, SI: strictly proper, lower is better.

    For a model without spread it is the error. Source: Gneiting and Raftery (2007), J. Am. Stat. Assoc. 102, eq. 22.
    """

    def one(key: Array, observation: dict[str, Array], action: Array) -> Array:
        length = model.history_length
        history = history_of(observation, action, length, length)
        first, second = sample_views(model, params, key, history, action[length - 1 :], 2)
        measured = observation[STATE][length:]
        return 0.5 * (_norms(first, measured) + _norms(second, measured) - _norms(first, second))

    keys = jax.random.split(jax.random.key(0), len(windows.action))
    return jax.vmap(one)(keys, windows.observation, windows.action)


def validate(model: LearnedWorldModel, params: Params, sets: dict[str, Windows]) -> dict[str, float]:
    """Score autoregressive predictions against the measurements; lower is better.

    Of a kind, `score` is the mean over windows and horizons of the four deterministic error norms in `SCORE_UNITS`,
    added up; `energy` the same of sampled rollouts, which is lower the better their spread is. `score` alone, which
    chooses the best weights, is the mean of all of them. Errors are those at the last horizon.
    """
    line = {}
    for name, windows in sets.items():
        context = jnp.full(len(windows.action), model.history_length, jnp.int32)
        _, error = window_errors(model, params, windows, context)
        error = np.asarray(error, np.float64)
        last = error[:, -1].mean(axis=0)
        line |= {
            f"{name}/score": _weighed(error),
            f"{name}/energy": _weighed(energy_scores(model, params, windows)),
            f"{name}/position_m": float(last[0]),
            f"{name}/velocity_mps": float(last[1]),
            f"{name}/attitude_deg": float(np.rad2deg(last[2])),
            f"{name}/rate_degps": float(np.rad2deg(last[3])),
        }
    return {"score": float(np.mean([line[f"{name}/{part}"] for name in sets for part in ("score", "energy")]))} | line
