"""The kinematic stream for vehicles that differ: what this one makes of its actions is found in its history."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from owm.model.kinematics import advance
from owm.model.response import (
    Track,
    VehicleStatistics,
    correct,
    fit_vehicles,
    follow,
    increment,
    innovation_scale,
    observe,
    predict,
)
from owm.model.streams.kinematic import KinematicStream, Statistics
from owm.model.track import displacement


class AdaptiveStream(KinematicStream):
    """The kinematic stream over a linear map that follows the vehicle, with the action before as a further input.

    Train it on flights of vehicles that differ (`owm-envs generate` with a `[randomization]`, each action held for a
    step of the model): on those of a single one it learns that there is nothing to find. All that a history tells of
    the vehicle stays known through a rollout.
    """

    features: ClassVar[int] = 47

    fit_filter = staticmethod(fit_vehicles)

    @staticmethod
    def skeleton(dtype: jnp.dtype) -> Statistics:
        """Return the shapes of the statistics."""
        return KinematicStream.skeleton(dtype)._replace(filter=VehicleStatistics.skeleton(dtype))

    def follow(
        self,
        statistics: Statistics,
        observation: Float[Array, "T 13"],
        action: Float[Array, "T-1 6"],
        valid: Bool[Array, "T"],
        dt: float,
    ) -> Track:
        """Return the tracks at all measurements of a window, stacked."""
        return follow(statistics.filter, statistics.linear, observation, action, valid, dt)

    def observe(
        self, statistics: Statistics, track: Track, action: Float[Array, "6"], view: Float[Array, "13"], dt: float
    ) -> Track:
        """Return the track after an action and the measurement that followed it."""
        return observe(statistics.filter, statistics.linear, track, action, view, dt)

    @staticmethod
    def inputs(statistics: Statistics, track: Track) -> Float[Array, "1 47"]:
        """Return what the token is made of."""
        before = track.response.previous / statistics.action_scale
        return jnp.concatenate([KinematicStream.inputs(statistics, track), before[None]], axis=1)

    def target(
        self, statistics: Statistics, before: Track, after: Track, action: Float[Array, "6"], dt: float
    ) -> Float[Array, "1 12"]:
        """Return the unit-variance residual that leads from a track to the view of the next one."""
        predicted = predict(statistics.linear, before, action, dt)
        return (displacement(predicted, after.view) / innovation_scale(statistics.filter, before, action))[None]

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
        if sampled:
            predicted = predict(statistics.linear, track, action, dt)
            return correct(statistics.filter, track, action, predicted, residual[0])
        change, drift = increment(statistics.linear, track, action)
        away = innovation_scale(statistics.filter, track, action) * residual[0]
        motion = advance(track.motion, change + jnp.concatenate([away[3:6], away[9:]]), dt, drift)
        return track._replace(
            motion=motion,
            view=motion,
            response=track.response._replace(previous=action),
            innovation=jnp.zeros_like(track.innovation),
        )
