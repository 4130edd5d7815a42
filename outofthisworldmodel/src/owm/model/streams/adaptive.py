"""Kinematic streams for vehicles that differ: what this one makes of its actions is found in its history.

They filter with a linear map that follows the vehicle, and see the action before as a further input. Train them on
flights of vehicles that differ (`owm-envs generate` with a `[randomization]`, each action held for a step of the
model): on those of a single one they learn that there is nothing to find. All that a history tells of the vehicle stays
known through a rollout.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from owm.model.streams.kinematic import Statistics, Variant, motion_inputs
from owm.motion.response import VEHICLE, Track


def _inputs(statistics: Statistics, track: Track) -> Float[Array, "1 47"]:
    """The motion, and the action before."""
    before = track.response.previous / statistics.action_scale
    return jnp.concatenate([motion_inputs(statistics, track), before[None]], axis=1)


def _remembering(track: Track, action: Float[Array, "6"]) -> Track:
    """The next step's action before is this one."""
    return track._replace(response=track.response._replace(previous=action))


ADAPTIVE = Variant(VEHICLE, 47, _inputs, _remembering)
"""For vehicles that differ."""
