"""How far open-loop predictions are from the noiseless truth, by horizon."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from owm.data.windows import Windows, history_of
from owm.interface import WorldModel, check_complete, roll_out
from owm.motion.kinematics import view_error
from owm_envs.task.sensors import STATE

QUANTITIES = ("position_m", "velocity_mps", "attitude_deg", "rate_degps")
UNITS = np.array([1.0, 1.0, 180.0 / np.pi, 180.0 / np.pi])
"""What SI figures are multiplied by."""


@dataclass(frozen=True)
class PredictionError:
    """Norms of the four errors: `error` is (windows, horizons, 4) in the units of `QUANTITIES`."""

    name: str
    horizons: tuple[int, ...]
    dt: float
    error: np.ndarray

    def mean(self, quantity: str) -> np.ndarray:
        """Return the mean over windows at each horizon."""
        return self.error[:, :, QUANTITIES.index(quantity)].mean(axis=0)

    def median(self, quantity: str) -> np.ndarray:
        """Return the median over windows at each horizon."""
        return np.median(self.error[:, :, QUANTITIES.index(quantity)], axis=0)

    def rows(self) -> list[dict[str, Any]]:
        """Return one plain mapping a horizon, ready for JSON or a table."""
        rows = []
        for i, horizon in enumerate(self.horizons):
            row: dict[str, Any] = {"model": self.name, "horizon": horizon, "seconds": horizon * self.dt}
            for k, quantity in enumerate(QUANTITIES):
                row[f"{quantity}_mean"] = float(self.error[:, i, k].mean())
                row[f"{quantity}_median"] = float(np.median(self.error[:, i, k]))
            rows.append(row)
        return rows


@partial(jax.jit, static_argnames=("model",))
def window_errors(
    model: WorldModel, params: Any, windows: Windows, context: Array
) -> tuple[Float[Array, "B F 4"], Float[Array, "B F 4"]]:
    """Return error norms (SI) against truth and against measurement for every horizon of every window."""

    def one(window: Windows, context: Array) -> tuple[Array, Array]:
        length = model.history_length
        history = history_of(window.observation, window.action, length, context)
        predicted = roll_out(model, params, model.encode(params, history), window.action[length - 1 :])

        def norms(actual: Array) -> Array:
            error = jax.vmap(view_error)(predicted, actual[length:])
            return jnp.linalg.norm(error.reshape(-1, 4, 3), axis=-1)

        return norms(window.truth), norms(window.observation[STATE])

    return jax.vmap(one)(windows, context)


def check_windows(windows: Windows, length: int) -> int:
    """Return how many windows there are; raise ValueError if there is none or they have fewer than `length` views."""
    count, views = windows.truth.shape[:2]
    if count == 0 or views < length:
        raise ValueError(f"need at least one window of {length} views, got {count} of {views}")
    return count


def prediction_error(
    model: WorldModel,
    windows: Windows,
    horizons: tuple[int, ...] = tuple(range(1, 65)),
    *,
    context: int | None = None,
    batch: int = 256,
) -> PredictionError:
    """Score open-loop predictions under the true future actions against the noiseless truth.

    Args:
        model: any world model.
        windows: of at least `model.history_length + max(horizons)` views.
        horizons: steps ahead to report, ascending.
        context: how many of the `H` measurements the model may see; all by default.
        batch: windows scored at once.

    Raises:
        ValueError: if the windows are too short or there are none.
        TypeError: the model lacks a part of `WorldModel`.
    """
    check_complete(model)
    length = model.history_length + max(horizons)
    count = check_windows(windows, length)
    context = model.history_length if context is None else context
    if not 1 <= context <= model.history_length:
        raise ValueError(f"context must be 1 to {model.history_length}, got {context}")
    batch = min(batch, count)
    parts = []
    for first in range(0, count, batch):
        # The last batch is filled up with earlier windows, so that one shape is compiled.
        rows = np.minimum(np.arange(first, first + batch), count - 1)
        part = Windows(
            {name: values[rows, :length] for name, values in windows.observation.items()},
            windows.action[rows, : length - 1],
            windows.truth[rows, :length],
        )
        error, _ = window_errors(model, model.params, part, jnp.full(batch, context, jnp.int32))
        parts.append(np.asarray(error)[: count - first])
    error = np.concatenate(parts)[:, np.asarray(horizons) - 1] * UNITS
    return PredictionError(model.name, tuple(horizons), model.dt, error)
