"""The relative view as a pose-relative motion, and the analytic kinematics every state predictor here builds on.

Quaternions are scalar first and unit, `q_ab` turns vectors of frame `b` into frame `a`. All functions take one example.
"""

from typing import NamedTuple

import jax.numpy as jnp
from astrojax.attitude import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_to_rotation_vector,
)
from jaxtyping import Array, Float


def quat_toward(q: Float[Array, "4"], reference: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return `q` or `-q`, whichever lies on the side of `reference`, so that a sequence stays continuous."""
    return jnp.where(jnp.dot(q, reference) < 0.0, -q, q)


class Motion(NamedTuple):
    """A relative view expressed in the body frame that the chaser had at an anchor pose.

    Everything but `anchor` is the same wherever in the station frame, and however turned, the motion happens; the
    anchor restores the absolute pose, on which orbital terms depend.

    Attributes:
        anchor: position (m) and `q` (anchor frame to station frame) of the anchor pose in the station frame.
        position: m, from the anchor, anchor frame.
        velocity: m/s, station-relative, anchor frame.
        attitude: scalar-first quaternion, body to anchor frame.
        rate: rad/s, station-relative, body frame.
    """

    anchor: Float[Array, "7"]
    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    attitude: Float[Array, "4"]
    rate: Float[Array, "3"]


def to_motion(view: Float[Array, "13"], anchor: Float[Array, "13"]) -> Motion:
    """Express a 13-number view in the body frame of another view, the anchor."""
    inverse = quat_conjugate(anchor[6:10])
    return Motion(
        anchor=jnp.concatenate([anchor[:3], anchor[6:10]]),
        position=quat_rotate(inverse, view[:3] - anchor[:3]),
        velocity=quat_rotate(inverse, view[3:6]),
        attitude=quat_multiply(inverse, view[6:10]),
        rate=view[10:],
    )


def to_view(motion: Motion) -> Float[Array, "13"]:
    """Return the 13-number view in the station frame, the inverse of `to_motion`."""
    turn = motion.anchor[3:]
    attitude = quat_multiply(turn, motion.attitude)
    return jnp.concatenate(
        [
            motion.anchor[:3] + quat_rotate(turn, motion.position),
            quat_rotate(turn, motion.velocity),
            attitude / jnp.linalg.norm(attitude),
            motion.rate,
        ]
    )


def advance(motion: Motion, increment: Float[Array, "6"], dt: float) -> Motion:
    """Advance a motion by one step, given by how much velocity and rate change.

    Attitude turns by the mean rate, the velocity increment is laid out along the mid-step attitude, position follows by
    the trapezoidal rule; exact for a constant body acceleration up to third order in `dt`.

    Args:
        motion: where the step starts.
        increment: velocity change (m/s) in the mid-step body frame, then rate change (rad/s) in the body frame.
        dt: step length, s.
    """
    rate = motion.rate + increment[3:]
    turn = 0.5 * dt * (motion.rate + rate)
    half = quat_multiply(motion.attitude, quat_from_rotation_vector(0.5 * turn))
    velocity = motion.velocity + quat_rotate(half, increment[:3])
    attitude = quat_multiply(motion.attitude, quat_from_rotation_vector(turn))
    return Motion(
        anchor=motion.anchor,
        position=motion.position + 0.5 * dt * (motion.velocity + velocity),
        velocity=velocity,
        # One Newton step towards unit norm: enough against round-off, and smooth.
        attitude=attitude * (1.5 - 0.5 * jnp.sum(attitude**2)),
        rate=rate,
    )


def increments(before: Motion, after: Motion, dt: float) -> Float[Array, "6"]:
    """Return the increments that `advance` would need to reach the velocity and rate of `after` (same anchor)."""
    turn = 0.5 * dt * (before.rate + after.rate)
    half = quat_multiply(before.attitude, quat_from_rotation_vector(0.5 * turn))
    return jnp.concatenate(
        [quat_rotate(quat_conjugate(half), after.velocity - before.velocity), after.rate - before.rate]
    )


def view_error(predicted: Float[Array, "13"], actual: Float[Array, "13"]) -> Float[Array, "12"]:
    """Return position (m), velocity (m/s), attitude (rotation vector, rad) and rate (rad/s) errors, blind to the sign of q."""
    attitude = quat_to_rotation_vector(quat_multiply(quat_conjugate(actual[6:10]), predicted[6:10]))
    return jnp.concatenate([predicted[:6] - actual[:6], attitude, predicted[10:] - actual[10:]])
