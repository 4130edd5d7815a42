"""How measurements are laid out as one vector, and how a user's action becomes a wrench."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

EPOCH_SCALE = np.array([7.0, 86_400.0])
VIEW_SCALE = np.array([225.0] * 3 + [5.0] * 3 + [1.0] * 4 + [0.05] * 3)
ERROR_SCALE = np.array([225.0] * 3 + [5.0] * 3 + [np.pi] * 3 + [0.05] * 3)


@dataclass(frozen=True)
class ObservationLayout:
    """The observation vector: [epoch 2] + relative view 13 + [goal error 12], and the action beside it.

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
        """Length of the observation vector."""
        return 13 + 2 * self.has_epoch + 12 * self.has_goal_error

    @property
    def view(self) -> slice:
        """Where the measured relative view stands."""
        start = 2 * self.has_epoch
        return slice(start, start + 13)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number."""
        axes = "xyz"
        view = [f"{part}_{a}" for part in ("position", "velocity") for a in axes]
        view += [f"attitude_{a}" for a in "wxyz"] + [f"rate_{a}" for a in axes]
        error = [f"goal_{part}_{a}" for part in ("position", "velocity", "attitude", "rate") for a in axes]
        epoch = ["epoch_mjd_day", "epoch_seconds"]
        return tuple(epoch * self.has_epoch + view + error * self.has_goal_error)

    def observe(self, epoch: Float[Array, "2"], measured: Float[Array, "13"], error: Float[Array, "12"]) -> Array:
        """The float32 observation vector (`size`,)."""
        parts = []
        if self.has_epoch:
            shifted = epoch - jnp.asarray([self.reference_day, 0.0], epoch.dtype)
            parts.append(shifted / jnp.asarray(EPOCH_SCALE, epoch.dtype) if self.normalize else epoch)
        parts.append(measured / jnp.asarray(VIEW_SCALE, measured.dtype) if self.normalize else measured)
        if self.has_goal_error:
            parts.append(error / jnp.asarray(ERROR_SCALE, error.dtype) if self.normalize else error)
        return jnp.concatenate([part.astype(jnp.float32) for part in parts])

    def measured_view(self, observation: Float[Array, "... O"]) -> Float[Array, "... 13"]:
        """The measured relative view of an observation in SI units; NumPy in, NumPy out."""
        view = observation[..., self.view]
        return view * VIEW_SCALE.astype(view.dtype) if self.normalize else view

    def measured_epoch(self, observation: Float[Array, "... O"]) -> Float[Array, "... 2"]:
        """The epoch [MJD day, s of day] of an observation that has one."""
        epoch = observation[..., :2]
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
