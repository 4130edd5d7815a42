"""The kinematic stream for vehicles that differ: what this one makes of its actions is found in its history."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from owm.model.streams.kinematic import KinematicStream, Statistics
from owm.motion.response import VEHICLE, Track
from owm.motion.track import Filter


class AdaptiveStream(KinematicStream):
    """The kinematic stream over a linear map that follows the vehicle, with the action before as a further input.

    Train it on flights of vehicles that differ (`owm-envs generate` with a `[randomization]`, each action held for a
    step of the model): on those of a single one it learns that there is nothing to find. All that a history tells of
    the vehicle stays known through a rollout.
    """

    features: ClassVar[int] = 47
    filter: ClassVar[Filter] = VEHICLE

    @staticmethod
    def inputs(statistics: Statistics, track: Track) -> Float[Array, "1 47"]:
        """Return what the token is made of."""
        before = track.response.previous / statistics.action_scale
        return jnp.concatenate([KinematicStream.inputs(statistics, track), before[None]], axis=1)

    def advance(
        self,
        statistics: Statistics,
        track: Track,
        residual: Float[Array, "1 12"],
        action: Float[Array, "6"],
        dt: float,
        *,
        sampled: bool,
    ) -> Track:
        """Advance the track by one step under a sampled (or measured) residual, or under the expected one."""
        after = super().advance(statistics, track, residual, action, dt, sampled=sampled)
        return after._replace(response=after.response._replace(previous=action))
