"""How the state part of an observation is laid out as one vector, and how a user's action becomes a wrench."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from owm_envs.task.sensors import STATE, STATE_VALID
from owm_envs.view import VIEW_NAMES, VIEW_SIZE

EPOCH_SCALE = np.array([7.0, 86_400.0])
VIEW_SCALE = np.array([225.0] * 3 + [5.0] * 3 + [1.0] * 4 + [0.05] * 3)
ERROR_SCALE = np.array([225.0] * 3 + [5.0] * 3 + [np.pi] * 3 + [0.05] * 3)

Observation = Mapping[str, Shaped[Array, "..."]] | Float[Array, "... O"]
"""Parts by name, or the state part alone, as adapters give it where there is no other."""


def part(observation: Observation, name: str) -> Array:
    """One part of an observation. Raises KeyError if it has none of that name; TypeError for pixels alone."""
    if isinstance(observation, Mapping):
        return observation[name]
    if getattr(observation, "dtype", None) == np.uint8:
        raise TypeError("the observation is of pixels alone: observation='state+pixels' has the state part beside them")
    return {STATE: observation}[name]


def seen_now(observation: Observation) -> Array | None:
    """Whether the state part was measured at this very instant, (...,); None where it always is."""
    if not isinstance(observation, Mapping) or STATE_VALID not in observation:
        return None
    return observation[STATE_VALID][..., 0].astype(bool)


@dataclass(frozen=True)
class ObservationLayout:
    """The state part of an observation: [epoch 2] + relative view 13 + [goal error 12]; and the action beside it.

    With `normalize`, the epoch is an offset from `reference_day` in weeks and days, the rest is divided by
    `VIEW_SCALE` and `ERROR_SCALE`, and actions are fractions of the wrench limits.
    """

    has_epoch: bool
    has_goal_error: bool
    normalize: bool
    reference_day: float
    wrench_limit: tuple[float, ...]

    @property
    def size(self) -> int:
        """Length of the state part."""
        return VIEW_SIZE + 2 * self.has_epoch + 12 * self.has_goal_error

    @property
    def view(self) -> slice:
        """Where in the state part the measured relative view stands."""
        start = 2 * self.has_epoch
        return slice(start, start + VIEW_SIZE)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number of the state part."""
        error = tuple(f"goal_{part}_{a}" for part in ("position", "velocity", "attitude", "rate") for a in "xyz")
        epoch = ("epoch_mjd_day", "epoch_seconds")
        return epoch * self.has_epoch + VIEW_NAMES + error * self.has_goal_error

    def observe(self, epoch: Float[Array, "2"], measured: Float[Array, "13"], error: Float[Array, "12"]) -> Array:
        """The float32 state part (`size`,)."""
        parts = []
        if self.has_epoch:
            shifted = epoch - jnp.asarray([self.reference_day, 0.0], epoch.dtype)
            parts.append(shifted / jnp.asarray(EPOCH_SCALE, epoch.dtype) if self.normalize else epoch)
        parts.append(measured / jnp.asarray(VIEW_SCALE, measured.dtype) if self.normalize else measured)
        if self.has_goal_error:
            parts.append(error / jnp.asarray(ERROR_SCALE, error.dtype) if self.normalize else error)
        return jnp.concatenate([part.astype(jnp.float32) for part in parts])

    def measured_view(self, observation: Observation) -> Float[Array, "... 13"]:
        """The measured relative view of an observation in SI units; NumPy in, NumPy out."""
        view = part(observation, STATE)[..., self.view]
        return view * VIEW_SCALE.astype(view.dtype) if self.normalize else view

    def with_view(self, observation: Observation, view: Float[Array, "13"]) -> dict[str, Array]:
        """An observation with another measured view [SI units] in it."""
        state = part(observation, STATE)
        numbers = view / jnp.asarray(VIEW_SCALE, view.dtype) if self.normalize else view
        others = dict(observation) if isinstance(observation, Mapping) else {}
        return others | {STATE: jnp.asarray(state).at[self.view].set(numbers.astype(state.dtype))}

    def measured_epoch(self, observation: Observation) -> Float[Array, "... 2"]:
        """The epoch [MJD day, s of day] of an observation that has one."""
        epoch = part(observation, STATE)[..., :2]
        if not self.normalize:
            return epoch
        return epoch * EPOCH_SCALE.astype(epoch.dtype) + np.array([self.reference_day, 0], epoch.dtype)

    def wrench(self, action: Float[Array, "6"], limit: Float[Array, "6"] | None = None) -> Float[Array, "6"]:
        """The body wrench [N, N m] of an action, clipped to `limit`, the configured one when None."""
        scale = jnp.asarray(self.wrench_limit, action.dtype)
        limit = scale if limit is None else limit.astype(action.dtype)
        return jnp.clip(action * scale if self.normalize else action, -limit, limit)

    def action(self, wrench: Float[Array, "... 6"]) -> Float[Array, "... 6"]:
        """The action that commands a body wrench [N, N m]; NumPy in, NumPy out."""
        return wrench / np.asarray(self.wrench_limit, wrench.dtype) if self.normalize else wrench
