"""The relative view as a pose-relative motion, and the analytic kinematics every state predictor here builds on.

Quaternions are scalar first and unit, `q_ab` turns vectors of frame `b` into frame `a`. All functions take one example.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_to_rotation_vector
from owm_envs.view import View

# The same algebra as `astrojax.attitude`, as contractions with constant tables: inside a differentiated scan over a
# rollout the component-wise form has many times the operations, and compiling them took longer than training.
_PRODUCT = np.zeros((4, 4, 4))  # (p q)_k = sum_ij _PRODUCT[k, i, j] p_i q_j
for _i, _j, _k, _sign in (
    *((0, a, a, 1) for a in range(4)),
    *((a, 0, a, 1) for a in range(1, 4)),
    *((a, a, 0, -1) for a in range(1, 4)),
    *((1, 2, 3, 1), (2, 3, 1, 1), (3, 1, 2, 1), (2, 1, 3, -1), (3, 2, 1, -1), (1, 3, 2, -1)),
):
    _PRODUCT[_k, _i, _j] = _sign
# R_ij = sum_kl _ROTATION[i, j, k, l] q_k q_l, from (q v) q*
_CONJUGATE = np.diag([1.0, -1.0, -1.0, -1.0])
_ROTATION = np.einsum("iam,akj,lm->ijkl", _PRODUCT, _PRODUCT, _CONJUGATE)[1:, 1:]


def multiply(p: Float[Array, "4"], q: Float[Array, "4"]) -> Float[Array, "4"]:
    """Return the Hamilton product `p q`."""
    return jnp.sum(jnp.asarray(_PRODUCT, p.dtype) * (p[:, None] * q[None, :])[None], axis=(1, 2))


def rotation(q: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Return the rotation matrix of a unit quaternion, the same for `q` and `-q`."""
    return jnp.sum(jnp.asarray(_ROTATION, q.dtype) * (q[:, None] * q[None, :])[None, None], axis=(2, 3))


def quaternion(matrix: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Return the unit quaternion, of either sign, of the rotation nearest to a matrix that nearly is one.

    It is the dominant eigenvector of Davenport's matrix; the best row of its fourth power will do.
    Source: Markley and Crassidis (2014), Fundamentals of spacecraft attitude determination and control, sec. 5.3.
    """
    davenport = jnp.sum(jnp.asarray(_ROTATION, matrix.dtype) * matrix[:, :, None, None], axis=(0, 1))
    power = 0.25 * (0.5 * (davenport + davenport.T) + jnp.eye(4, dtype=matrix.dtype))
    for _ in range(2):
        power = jnp.sum(power[:, :, None] * power[None, :, :], axis=1)
    row = power[jnp.argmax(jnp.diagonal(power))]
    return row * jax.lax.rsqrt(jnp.sum(row**2) + 1e-30)


def apply(matrix: Float[Array, "i j"], vector: Float[Array, "j"]) -> Float[Array, "i"]:
    """Return `matrix @ vector` as a sum that compilers fuse with its neighbours."""
    return jnp.sum(matrix * vector[None, :], axis=1)


def apply_inverse(matrix: Float[Array, "i j"], vector: Float[Array, "i"]) -> Float[Array, "j"]:
    """Return `matrix.T @ vector`: for a rotation matrix its inverse."""
    return jnp.sum(matrix * vector[:, None], axis=0)


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


def pose(view: Float[Array, "13"]) -> Float[Array, "7"]:
    """Return position and quaternion of a view."""
    position, _, attitude, _ = View.of(view)
    return jnp.concatenate([position, attitude])


def to_motion(view: Float[Array, "13"], anchor: Float[Array, "13"] | Float[Array, "7"]) -> Motion:
    """Express a 13-number view in the body frame of an anchor: a pose, or another view."""
    anchor = anchor if anchor.shape[-1] == 7 else pose(anchor)
    turn = rotation(anchor[3:])
    position, velocity, attitude, rate = View.of(view)
    return Motion(
        anchor=anchor,
        position=apply_inverse(turn, position - anchor[:3]),
        velocity=apply_inverse(turn, velocity),
        attitude=multiply(quat_conjugate(anchor[3:]), attitude),
        rate=rate,
    )


def to_station(motion: Motion) -> tuple[Float[Array, "3"], Float[Array, "3"], Float[Array, "3 3"]]:
    """Return station-frame position, velocity and the rotation matrix of the anchor frame."""
    turn = rotation(motion.anchor[3:])
    return motion.anchor[:3] + apply(turn, motion.position), apply(turn, motion.velocity), turn


def to_view(motion: Motion) -> Float[Array, "13"]:
    """Return the 13-number view in the station frame, the inverse of `to_motion`."""
    position, velocity, _ = to_station(motion)
    attitude = multiply(motion.anchor[3:], motion.attitude)
    return View(position, velocity, attitude / jnp.linalg.norm(attitude), motion.rate).numbers()


def _half_turn(before: Float[Array, "3"], after: Float[Array, "3"], dt: float) -> Float[Array, "4"]:
    """Return the rotation over half a step at the mean of two rates."""
    return quat_from_rotation_vector(0.25 * dt * (before + after))


def advance(motion: Motion, increment: Float[Array, "6"], dt: float, drift: Float[Array, "3"] | float = 0.0) -> Motion:
    """Advance a motion by one step, given by how much velocity and rate change.

    Attitude turns by the mean rate, the velocity increment is laid out along the mid-step attitude, position follows by
    the trapezoidal rule: errors are of third order in `dt` for a constant body acceleration.

    Args:
        motion: where the step starts.
        increment: velocity change (m/s) in the mid-step body frame, then rate change (rad/s) in the body frame.
        dt: step length, s.
        drift: velocity change (m/s) that does not turn with the body, anchor frame.
    """
    rate = motion.rate + increment[3:]
    half_turn = _half_turn(motion.rate, rate, dt)
    middle = multiply(motion.attitude, half_turn)
    velocity = motion.velocity + apply(rotation(middle), increment[:3]) + drift
    attitude = multiply(middle, half_turn)
    return Motion(
        anchor=motion.anchor,
        position=motion.position + 0.5 * dt * (motion.velocity + velocity),
        velocity=velocity,
        # One Newton step towards unit norm: enough against round-off, and smooth.
        attitude=attitude * (1.5 - 0.5 * jnp.sum(attitude**2)),
        rate=rate,
    )


def increments(before: Motion, after: Motion, dt: float, drift: Float[Array, "3"] | float = 0.0) -> Float[Array, "6"]:
    """Return the increments that `advance` needs to reach the velocity and rate of `after` (same anchor)."""
    middle = multiply(before.attitude, _half_turn(before.rate, after.rate, dt))
    change = apply_inverse(rotation(middle), after.velocity - before.velocity - drift)
    return jnp.concatenate([change, after.rate - before.rate])


def view_error(predicted: Float[Array, "13"], actual: Float[Array, "13"]) -> Float[Array, "12"]:
    """Return errors of position (m), velocity (m/s), attitude (rotation vector, rad) and rate (rad/s).

    The sign of either quaternion does not matter.
    """
    guess, truth = View.of(predicted), View.of(actual)
    attitude = quat_to_rotation_vector(multiply(quat_conjugate(truth.attitude), guess.attitude))
    return jnp.concatenate([predicted[:6] - actual[:6], attitude, guess.rate - truth.rate])


def displaced(view: Float[Array, "13"], error: Float[Array, "12"]) -> Float[Array, "13"]:
    """Return the view whose `view_error` to the given one is `error`."""
    _, _, attitude, rate = View.of(view)
    attitude = multiply(attitude, quat_from_rotation_vector(error[6:9]))
    attitude = attitude / jnp.linalg.norm(attitude)
    return jnp.concatenate([view[:6] + error[:6], attitude, rate + error[9:]])


def motion_error(predicted: Motion, actual: Motion) -> Float[Array, "4"]:
    """Return squared errors between motions of one anchor: position, velocity, attitude and rate, SI units.

    The attitude term is `(2 sin(angle / 2))**2`: the squared angle when small, smooth and blind to the sign of q.
    """
    turn = rotation(predicted.attitude) - rotation(actual.attitude)
    return jnp.stack(
        [
            jnp.sum((predicted.position - actual.position) ** 2),
            jnp.sum((predicted.velocity - actual.velocity) ** 2),
            0.5 * jnp.sum(turn**2),
            jnp.sum((predicted.rate - actual.rate) ** 2),
        ]
    )


LOSS_UNITS = (0.1, 0.01, 0.005, 0.001)
"""Position m, velocity m/s, attitude rad and rate rad/s that weigh alike in a decode loss."""


def decode_penalty(squared: Float[Array, "4"]) -> Float[Array, ""]:
    """Return one number for four squared errors: quadratic for small errors, linear for large ones, in loss units."""
    return jnp.mean(jnp.sqrt(1.0 + squared / jnp.asarray(LOSS_UNITS, squared.dtype) ** 2) - 1.0)
