"""A residual-bias corrector: what the model got wrong since the last replan becomes a standing correction.

Docking to a tenth of a metre fails on accelerations of a few mm/s2 that the model does not know of. The mean of
the model's own prediction errors, as far as it stands out of their noise, makes up for any constant one, whatever its
cause and whatever the model.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import quat_from_rotation_vector, quat_multiply
from owm_envs.view import View

MEMORY = 8
"""Replans over which the noise is averaged."""
CAUTION = 3.0
"""How often the mean square that noise alone would leave in a mean is taken off it."""


class Correction(NamedTuple):
    """What the model is taken to lack: m/s2 and m/s in the station frame, rad/s2 in the body frame."""

    acceleration: Float[Array, "3"]
    angular: Float[Array, "3"]
    drift: Float[Array, "3"]
    """Velocity that moves the position without being measured as velocity."""


def no_correction(dtype: str = "float32") -> Correction:
    """Nothing learned yet."""
    return Correction(*(jnp.zeros(3, dtype) for _ in Correction._fields))


def apply(correction: Correction, view: Float[Array, "13"], elapsed: Float[Array, ""]) -> Float[Array, "13"]:
    """Add to a predicted view what the correction has grown to, `elapsed` seconds into the prediction."""
    position, velocity, attitude, rate = View.of(view)
    half_square = 0.5 * elapsed * elapsed
    turned = quat_multiply(attitude, quat_from_rotation_vector(half_square * correction.angular))
    return jnp.concatenate(
        [
            position + half_square * correction.acceleration + elapsed * correction.drift,
            velocity + elapsed * correction.acceleration,
            turned,
            rate + elapsed * correction.angular,
        ]
    )


class Corrector(NamedTuple):
    """What one episode has learned of its model's errors; rows as in `Correction`.

    Attributes:
        mean: exponentially weighted mean of the errors seen at the replans.
        noise: variance of an axis of one error, running mean over `MEMORY` replans.
        last: the latest error.
        count: errors seen.
        correction: what stands out of the noise.
    """

    mean: Float[Array, "3 3"]
    noise: Float[Array, "3"]
    last: Float[Array, "3 3"]
    count: Float[Array, ""]
    correction: Correction


def init_corrector(dtype: str = "float32") -> Corrector:
    """Nothing learned yet."""
    zero = jnp.zeros((3, 3), dtype)
    return Corrector(zero, zero[0], zero, zero[0, 0], no_correction(dtype))


def update(
    known: Corrector,
    predicted: Float[Array, "13"],
    measured: Float[Array, "13"],
    elapsed: Float[Array, ""] | float,
    gain: Float[Array, ""],
    drift_gain: Float[Array, ""],
) -> Corrector:
    """Learn from a corrected prediction and the measurement of the same instant.

    Acting on the whole mean, the noise of a poor sensor would walk the chaser about. White noise of variance `s`
    leaves a mean of gain `g` with the variance `s g / (2 - g)`, so the mean is shrunk by `CAUTION` times that.

    Args:
        known: before.
        predicted: view predicted `elapsed` seconds ahead with the correction applied.
        measured: view measured then.
        gain: weight of a new error in the mean of the accelerations; drift_gain: of the drift.

    Source: James and Stein (1961), positive part; von Neumann (1941), for the variance from successive differences,
    which a bias does not enter.
    """
    seen, expected = View.of(measured), View.of(predicted)
    velocity = seen.velocity - expected.velocity
    # The part of the position residual that the velocity residual explains is no drift.
    position = seen.position - expected.position - 0.5 * elapsed * velocity
    residual = jnp.stack([velocity, seen.rate - expected.rate, position]) / elapsed
    error = jnp.stack(known.correction) + residual

    weight = jnp.stack([gain, gain, drift_gain])
    mean = known.mean + weight[:, None] * (error - known.mean)
    changed = jnp.where(known.count > 0, 0.5 * jnp.mean((error - known.last) ** 2, axis=1), jnp.mean(error**2, axis=1))
    noise = known.noise + (changed - known.noise) / jnp.minimum(known.count + 1, MEMORY)
    chance = noise * weight / (2 - weight)
    share = jnp.clip(1 - CAUTION * chance / jnp.maximum(jnp.mean(mean**2, axis=1), 1e-30), 0, 1)
    return Corrector(mean, noise, error, known.count + 1, Correction(*(share[:, None] * mean)))
