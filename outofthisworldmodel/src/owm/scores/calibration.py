"""Whether the spread of sampled predictions is the spread of outcomes about them, by horizon.

The pure scores (`central_coverage`, `crps`, `score_samples`) take samples along the first axis, from wherever they are;
`calibration` draws them from a `WorldModel` by stepping it with keys.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from owm.data.windows import Windows, history_of
from owm.interface import History, WorldModel, roll_out
from owm.motion.kinematics import view_error
from owm.scores.prediction import QUANTITIES, UNITS, check_windows
from owm_envs.task.sensors import STATE

LEVELS = (0.5, 0.9, 0.99)
"""Probabilities whose central intervals are scored."""


def central_coverage(
    samples: Float[Array, "S *n"], outcome: Float[Array, "*n"], levels: Sequence[float] = LEVELS
) -> Bool[Array, "*n L"]:
    """Return whether the outcome lies in the samples' central interval of each probability.

    The interval ends at the order statistics number `(1 - level) / 2 (S + 1)` from either end, interpolated: if the
    outcome is one more draw of what the samples are drawn from, it lies within with just that probability.

    Raises:
        ValueError: too few samples to tell a level: `(1 + level) / (1 - level)` are needed.
    """
    count = samples.shape[0]
    least = max((1 + level) / (1 - level) for level in levels)
    if count < least - 1e-6:
        raise ValueError(f"levels {tuple(levels)} need at least {round(least)} samples, got {count}")
    ordered = jnp.sort(samples, axis=0)

    def order_statistic(number: float) -> Array:
        below = min(int(number + 1e-6), count - 1)
        part = jnp.asarray(max(number - below, 0.0), samples.dtype)
        return ordered[below - 1] + part * (ordered[below] - ordered[below - 1])

    tails = [0.5 * (1 - level) * (count + 1) for level in levels]
    inside = [(order_statistic(t) <= outcome) & (outcome <= order_statistic(count + 1 - t)) for t in tails]
    return jnp.stack(inside, axis=-1)


def crps(samples: Float[Array, "S *n"], outcome: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the continuous ranked probability score, estimated without bias from at least two samples.

    It has the unit of the outcome; lower is better; without spread it is the absolute error. A single estimate may be
    negative. Source: Ferro (2014), Q. J. R. Meteorol. Soc. 140, sec. 3.
    """
    count = samples.shape[0]
    # sum_{i<j} |x_i - x_j| from the order statistics: x_(i) is the larger one i - 1 times, the smaller one S - i times.
    weight = (2.0 * np.arange(1, count + 1) - count - 1).reshape(-1, *[1] * (samples.ndim - 1))
    apart = jnp.sum(jnp.asarray(weight, samples.dtype) * jnp.sort(samples, axis=0), axis=0)
    return jnp.mean(jnp.abs(samples - outcome), axis=0) - apart / (count * (count - 1))


class Scores(NamedTuple):
    """Scores of the 12 components of `view_error`: position m, velocity m/s, attitude rad, rate rad/s, three axes each.

    Attributes:
        inside: whether the outcome lies in each central interval.
        crps: fair continuous ranked probability score.
        variance: of the outcome about the mean of the samples as the samples have it: their unbiased variance, times
            `1 + 1 / S` for what so few samples do not tell of their mean.
        square_error: of the mean of the samples; equals `variance` on average if the spread is right.
    """

    inside: Bool[Array, "*n 12 L"]
    crps: Float[Array, "*n 12"]
    variance: Float[Array, "*n 12"]
    square_error: Float[Array, "*n 12"]


def score_samples(
    samples: Float[Array, "S *n 13"], outcome: Float[Array, "*n 13"], levels: Sequence[float] = LEVELS
) -> Scores:
    """Score sampled views against one outcome, which may be the truth or a measurement.

    Errors are scored, not views, so attitude is a rotation vector and the sign of a quaternion does not matter.
    """
    error = jnp.vectorize(view_error, signature="(v),(v)->(e)")(samples, outcome)
    count = samples.shape[0]
    mean = jnp.mean(error, axis=0)
    variance = jnp.sum((error - mean) ** 2, axis=0) * ((1 + 1 / count) / (count - 1))
    zero = jnp.zeros_like(mean)
    return Scores(central_coverage(error, zero, levels), crps(error, zero), variance, mean**2)


def sample_views(
    model: WorldModel, params: Any, key: Key[Array, ""], history: History, actions: Float[Array, "F 6"], count: int
) -> Float[Array, "S F 13"]:
    """Draw `count` trajectories under given actions by stepping the model with keys."""
    start = model.encode(params, history)

    def trajectory(key: Array) -> Array:
        return roll_out(model, params, start, actions, keys=jax.random.split(key, actions.shape[0]))

    return jax.vmap(trajectory)(jax.random.split(key, count))


@dataclass(frozen=True)
class Calibration:
    """Scores by horizon (F) and group (4), means over windows and the group's axes, in the units of `QUANTITIES`.

    Attributes:
        name: of the model.
        horizons: steps ahead.
        dt: seconds a step.
        outcome: "truth" or "measurement".
        levels: nominal probabilities.
        coverage: (F, 4, L) fraction of outcomes within the central intervals of those probabilities.
        crps: (F, 4) of one axis.
        spread: (F, 4) root mean square of the vector from the samples' mean to an outcome, as the samples have it.
        error: (F, 4) the same as it was; `spread / error` is one for a right spread, less for an overconfident one.
    """

    name: str
    horizons: tuple[int, ...]
    dt: float
    outcome: str
    levels: tuple[float, ...]
    coverage: np.ndarray
    crps: np.ndarray
    spread: np.ndarray
    error: np.ndarray

    def rows(self) -> list[dict[str, Any]]:
        """Return one plain mapping a horizon, ready for JSON or a table."""
        rows = []
        for i, horizon in enumerate(self.horizons):
            row: dict[str, Any] = {"model": self.name, "horizon": horizon, "seconds": horizon * self.dt}
            row["outcome"] = self.outcome
            for k, quantity in enumerate(QUANTITIES):
                for level, covered in zip(self.levels, self.coverage[i, k]):
                    row[f"{quantity}_coverage_{100 * level:g}"] = float(covered)
                for score in ("crps", "spread", "error"):
                    row[f"{quantity}_{score}"] = float(getattr(self, score)[i, k])
            rows.append(row)
        return rows


def calibration(
    model: WorldModel,
    windows: Windows,
    horizons: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64),
    *,
    samples: int = 199,
    outcome: Literal["truth", "measurement"] = "truth",
    levels: tuple[float, ...] = LEVELS,
    seed: int = 0,
    batch: int = 16,
) -> Calibration:
    """Score the spread of a model's samples under the true future actions.

    A model trained to predict measurements has their noise in its samples: score those against the measurement.

    Args:
        model: any world model; one that ignores its keys gets a coverage of zero.
        windows: of at least `model.history_length + max(horizons)` views.
        horizons: steps ahead to report, ascending.
        samples: trajectories a window.
        outcome: what to score against.
        levels: probabilities of the central intervals.
        seed: of the samples.
        batch: windows scored at once.

    Raises:
        ValueError: if the windows are too short, there are none, or too few samples for the levels.
    """
    if outcome not in ("truth", "measurement"):
        raise ValueError(f"outcome must be 'truth' or 'measurement', got {outcome!r}")
    length = model.history_length + max(horizons)
    count = check_windows(windows, length)
    batch = min(batch, count)
    index = np.asarray(horizons) - 1
    actual = windows.truth if outcome == "truth" else windows.observation[STATE]
    sums = None
    for first in range(0, count, batch):
        # The last batch is filled up with earlier windows, so that one shape is compiled.
        rows = np.minimum(np.arange(first, first + batch), count - 1)
        keys = jax.vmap(lambda row: jax.random.fold_in(jax.random.key(seed), row))(jnp.asarray(rows, jnp.int32))
        seen = {name: values[rows, :length] for name, values in windows.observation.items()}
        inputs = (seen, windows.action[rows, : length - 1], actual[rows, :length])
        scores = _window_scores(model, model.params, keys, *inputs, samples, levels)
        part = [np.asarray(x[: count - first, index], np.float64).sum(axis=0) for x in scores]
        sums = part if sums is None else [a + b for a, b in zip(sums, part)]
    inside, ranked, variance, square = (x.reshape(len(horizons), 4, 3, *x.shape[2:]) / count for x in sums)
    return Calibration(
        model.name,
        tuple(horizons),
        model.dt,
        outcome,
        tuple(levels),
        coverage=inside.mean(axis=2),
        crps=ranked.mean(axis=2) * UNITS,
        spread=np.sqrt(variance.sum(axis=2)) * UNITS,
        error=np.sqrt(square.sum(axis=2)) * UNITS,
    )


@partial(jax.jit, static_argnames=("model", "samples", "levels"))
def _window_scores(model, params, keys, observation, action, actual, samples, levels) -> Scores:
    def one(key: Array, observation: dict[str, Array], action: Array, actual: Array) -> Scores:
        length = model.history_length
        history = history_of(observation, action, length, length)
        drawn = sample_views(model, params, key, history, action[length - 1 :], samples)
        return score_samples(drawn, actual[length:], levels)

    return jax.vmap(one)(keys, observation, action, actual)
