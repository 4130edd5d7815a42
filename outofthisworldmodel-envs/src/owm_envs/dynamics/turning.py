"""A target that turns: any fidelity's motion, seen in the axes of a target with an attitude of its own.

The target turns at a constant rate about an axis fixed in it and in the frame of the orbit (the station frame of the
fidelity); at an episode's start the two frames agree. That frame itself turns at 0.07 deg/s, and what would slowly
change a real target's rate (its products of inertia, the gravity gradient) is left out.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_multiply, quat_rotate
from owm_envs.config.params import Params
from owm_envs.dynamics.chief import station_orbit
from owm_envs.dynamics.state import PhysicalState
from owm_envs.view import View


def seen_turning(
    view: Float[Array, "13"], rate: Float[Array, "3"], elapsed: Float[ArrayLike, ""] = 0.0
) -> Float[Array, "13"]:
    """A view in the frame of the orbit as it is seen from a target that turns.

    Args:
        view: m, m/s, quaternion body to orbit frame, rad/s in body axes.
        rate: of the target, rad/s, in its axes.
        elapsed: s since its axes agreed with the orbit's frame; negative before.
    """
    position, velocity, attitude, body_rate = View.of(view)
    to_target = quat_from_rotation_vector(-elapsed * rate)
    position = quat_rotate(to_target, position)
    velocity = quat_rotate(to_target, velocity) - jnp.cross(rate, position)
    attitude = quat_multiply(to_target, attitude)
    return View(position, velocity, attitude, body_rate - quat_rotate(quat_conjugate(attitude), rate)).numbers()


def seen_at_rest(
    view: Float[Array, "13"], rate: Float[Array, "3"], elapsed: Float[ArrayLike, ""] = 0.0
) -> Float[Array, "13"]:
    """A view from a target that turns as it is in the frame of the orbit: the inverse of `seen_turning`."""
    position, velocity, attitude, body_rate = View.of(view)
    to_orbit = quat_from_rotation_vector(elapsed * rate)
    return View(
        quat_rotate(to_orbit, position),
        quat_rotate(to_orbit, velocity + jnp.cross(rate, position)),
        quat_multiply(to_orbit, attitude),
        body_rate + quat_rotate(quat_conjugate(attitude), rate),
    ).numbers()


def apparent(rate: Float[Array, "3"], position: Float[Array, "3"], velocity: Float[Array, "3"]) -> Float[Array, "3"]:
    """The acceleration, m/s2, that a chaser without thrust shows to a target that turns: Coriolis and centrifugal."""
    return -2 * jnp.cross(rate, velocity) - jnp.cross(rate, jnp.cross(rate, position))


@dataclass(frozen=True)
class TurningTarget:
    """A fidelity whose station frame turns with a target at `params.target_rate`."""

    orbits: object
    """The `Dynamics` of the chaser about the target."""

    @property
    def has_epoch(self) -> bool:
        """As the fidelity's."""
        return self.orbits.has_epoch

    def init(self, params: Params, epoch: Float[Array, "2"], view: Float[Array, "13"]) -> PhysicalState:
        """State whose view from the target is `view` (13,) at `epoch` (2,)."""
        return self.orbits.init(params, epoch, seen_at_rest(view, params.target_rate))

    def step(
        self, params: Params, state: PhysicalState, wrench: Float[Array, "6"], dt: Float[Array, ""]
    ) -> PhysicalState:
        """Advance by `dt` seconds under a body wrench (6,) [N, N m]."""
        return self.orbits.step(params, state, wrench, dt)

    def chief_orbit(self, params: Params, state: PhysicalState) -> Float[Array, "6"]:
        """The target's position and velocity [m, m/s] in inertial axes."""
        return station_orbit(self.orbits, params, state)

    def relative_state(self, params: Params, state: PhysicalState) -> Float[Array, "13"]:
        """The 13-number view from the target."""
        return seen_turning(self.orbits.relative_state(params, state), params.target_rate, state.elapsed)
