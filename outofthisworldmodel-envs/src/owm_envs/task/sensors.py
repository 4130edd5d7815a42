"""What the chaser measures of the true relative view, and its error to the goal."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from astrojax.attitude import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_rotation_vector,
)
from owm_envs.params import NoiseParams
from owm_envs.task.events import safe_norm


def measure(noise: NoiseParams, view: Float[Array, "13"], *, key: Key[Array, ""]) -> Float[Array, "13"]:
    """Corrupt a true relative view by isotropic Gaussian errors of the given total root-mean-square sizes.

    The attitude error is a rotation in body axes. Source: paper, table of sensor noise models.
    """
    position, velocity, attitude, rate = view[:3], view[3:6], view[6:10], view[10:]
    total = jnp.stack(
        [
            noise.position + noise.position_per_range * safe_norm(position),
            noise.velocity,
            noise.attitude,
            noise.rate,
        ]
    )
    per_axis = total / jnp.sqrt(jnp.asarray(3, view.dtype))
    # Seven digits are plenty for an error, and cost a third of sixteen.
    errors = per_axis[:, None] * jax.random.normal(key, (4, 3), jnp.float32).astype(view.dtype)
    return jnp.concatenate(
        [
            position + errors[0],
            velocity + errors[1],
            quat_multiply(attitude, quat_from_rotation_vector(errors[2])),
            rate + errors[3],
        ]
    )


def goal_error(view: Float[Array, "13"], goal: Float[Array, "7"]) -> Float[Array, "12"]:
    """Error of a relative view to a hold pose at rest.

    Returns:
        Position m and velocity m/s (view minus goal, station frame), rotation vector rad from the view's to the
        goal's attitude (body axes, shortest turn whatever the quaternions' signs), body rate rad/s.
    """
    turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(view[6:10]), goal[3:]))
    return jnp.concatenate([view[:3] - goal[:3], view[3:6], turn, view[10:]])
