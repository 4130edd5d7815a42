"""How to come to a target that turns: straight in from afar, round with it when near.

All is as the target sees it, in its own axes. From afar the way round takes more thrust than there is.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from astrojax.attitude import quat_conjugate, quat_rotate
from owm_envs.dynamics.turning import apparent
from owm_envs.task.events import safe_norm
from owm_envs.view import View

_ROUND, _LITTLE = 0.05, 0.03
"""m/s2, for going round: less than half of what the force of a Dragon gives; and what leaves enough for all else."""
_BEYOND = 2.0
"""m beyond the hold pose: there a chaser goes round at any rate, and moves across to the port's axis."""
_STRAIGHT = 4.0
"""The way leads straight in where a chaser is to go round by less than three quarters."""
_SLOWEST, _PER_METRE = 0.2, 0.1
"""m/s, and 1/s: how fast to come in, by the distance from where it has to go round."""
_BESIDE = np.cos(np.radians(20.0))
"""Of the angle to the port's axis from which on it moves across to it."""
_ACROSS, _ACROSS_TIME, _UPRIGHT_TIME = 0.5, 4.0, 3.0
"""m/s and s, across to the axis; s, along the radius meanwhile."""


class Turning(NamedTuple):
    """A target that turns.

    Attributes:
        rate: rad/s, in its own axes.
        near: m from the origin, out to where a chaser goes round with it; from half as far again it does not at all.
        orbit: m from the origin: where it moves across to the port's axis.
        axis: of the port, outwards.
    """

    rate: Float[Array, "3"]
    near: Float[Array, ""]
    orbit: Float[Array, ""]
    axis: Float[Array, "3"]

    @classmethod
    def about(cls, rate: Float[Array, "3"], pose: Float[Array, "7"]) -> "Turning":
        """Of a target at some rate [rad/s] with a hold pose: m, quaternion."""
        hold = pose[:3].astype(rate.dtype)
        orbit = safe_norm(hold) + _BEYOND
        near = jnp.maximum(orbit, _ROUND / jnp.maximum(jnp.sum(rate * rate), 1e-12))
        return cls(rate, near, orbit, hold / safe_norm(hold))


def apart(turning: Turning, position: Float[Array, "3"]) -> Float[Array, ""]:
    """How little a chaser is to go round: 0 near the target to 1 from afar."""
    return jnp.clip(2 * (safe_norm(position) / turning.near - 1), 0, 1)


def velocity_apart(turning: Turning, position: Float[Array, "3"]) -> Float[Array, "3"]:
    """The velocity, m/s, of who goes round as little as that and does nothing else."""
    return -apart(turning, position) * jnp.cross(turning.rate, position)


def way_in(
    turning: Turning, position: Float[Array, "3"], speed: Float[Array, ""], down: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Speed, m/s, and direction to come in by, in place of those that lead to the port: from afar to the middle."""
    radius, share = jnp.maximum(safe_norm(position), 1e-3), _straight(turning, position)
    mixed = (1 - share) * down - share * position / radius
    slowly = jnp.minimum(speed, _SLOWEST + _PER_METRE * jnp.maximum(radius - turning.near, 0))
    return jnp.where(share > 0, slowly, speed), mixed / jnp.maximum(safe_norm(mixed), 1e-6)


def goes_round_hard(turning: Turning, position: Float[Array, "3"]) -> Bool[Array, ""]:
    """Whether a chaser is to go round so fast that it had better do little else."""
    needed = jnp.sum(turning.rate * turning.rate) * safe_norm(position)
    return (apart(turning, position) < 1) & (needed > _LITTLE)


def way_across(
    turning: Turning, position: Float[Array, "3"], speed: Float[Array, ""]
) -> tuple[Bool[Array, ""], Float[Array, "3"]]:
    """Whether to come in and move across to the port's axis, near the target, and the velocity for it, m/s.

    Args:
        speed: to come in at, at most.
    """
    radius = jnp.maximum(safe_norm(position), 1e-3)
    out = position / radius
    cosine = jnp.sum(out * turning.axis)
    aside = turning.axis - cosine * out
    # Opposite the port every way is as short.
    aside = jnp.where(
        safe_norm(aside) > 1e-2, aside, jnp.cross(out, jnp.eye(3, dtype=out.dtype)[jnp.argmin(jnp.abs(out))])
    )
    aside = aside / jnp.maximum(safe_norm(aside), 1e-6)
    way = turning.orbit * jnp.arccos(jnp.clip(cosine, -0.999, 0.999))
    across = (1 - _straight(turning, position)) * jnp.minimum(_ACROSS, way / _ACROSS_TIME)
    inwards = jnp.clip((radius - turning.orbit) / _UPRIGHT_TIME, -0.3, speed)
    applies = (radius < 1.5 * turning.orbit) | goes_round_hard(turning, position)
    return applies & (cosine < _BESIDE), across * aside - inwards * out


def _straight(turning: Turning, position: Float[Array, "3"]) -> Float[Array, ""]:
    """How far the way leads straight in: who hardly goes round does not catch up with the port."""
    return jnp.minimum(_STRAIGHT * apart(turning, position), 1)


def push(turning: Turning, position: Float[Array, "3"], velocity: Float[Array, "3"]) -> Float[Array, "3"]:
    """The acceleration by thrust, m/s2, that it takes to keep going round as much as `velocity_apart` says."""
    _, changes = jax.jvp(lambda at: velocity_apart(turning, at), (position,), (velocity,))
    return changes - apparent(turning.rate, position, velocity)


def twist(turning: Turning, view: View, inertia: Float[Array, "3"]) -> Float[Array, "3"]:
    """The acceleration by torque, rad/s2 in body axes, that it takes to keep a body rate relative to the target.

    Args:
        inertia: principal, kg m2.
    """
    target = quat_rotate(quat_conjugate(view.attitude), turning.rate)
    own = view.rate + target
    return jnp.cross(own, inertia * own) / inertia - jnp.cross(view.rate, target)
