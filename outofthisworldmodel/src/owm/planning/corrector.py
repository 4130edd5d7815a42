"""A residual-bias corrector: what the model got wrong since the last replan becomes a standing correction.

Docking to a tenth of a metre fails on accelerations of a few mm/s2 that the model does not know of. An
integral term on the model's own prediction error removes any constant one, whatever its cause and whatever
the model.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import quat_from_rotation_vector, quat_multiply


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
    half_square = 0.5 * elapsed * elapsed
    turned = quat_multiply(view[6:10], quat_from_rotation_vector(half_square * correction.angular))
    return jnp.concatenate(
        [
            view[:3] + half_square * correction.acceleration + elapsed * correction.drift,
            view[3:6] + elapsed * correction.acceleration,
            turned,
            view[10:] + elapsed * correction.angular,
        ]
    )


def update(
    correction: Correction,
    predicted: Float[Array, "13"],
    measured: Float[Array, "13"],
    elapsed: Float[Array, ""] | float,
    gain: Float[Array, ""],
    drift_gain: Float[Array, ""],
) -> Correction:
    """Take over a share of the residual rates between a corrected prediction and the measurement of the same
    instant.

    Args:
        predicted: view predicted `elapsed` seconds ahead with `correction` applied.
        measured: view measured then.
        gain: share of the residual accelerations; drift_gain: share of the residual drift.
    """
    velocity = measured[3:6] - predicted[3:6]
    # The part of the position residual that the velocity residual explains is no drift.
    position = measured[:3] - predicted[:3] - 0.5 * elapsed * velocity
    return Correction(
        acceleration=correction.acceleration + gain * velocity / elapsed,
        angular=correction.angular + gain * (measured[10:] - predicted[10:]) / elapsed,
        drift=correction.drift + drift_gain * position / elapsed,
    )
