"""`iss-hcw`: Hill-Clohessy-Wiltshire relative motion about a circular chief, with gravity-gradient torque.

The station frame is x = orbit normal, y = aft, z = zenith and turns at (n, 0, 0) with the chief.
Source: Clohessy and Wiltshire (1960), axes relabelled from RTN.
"""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import (
    accel_euler,
    quat_conjugate,
    quat_derivative,
    quat_normalize,
    quat_rotate,
    torque_gravity_gradient,
)
from astrojax.constants import GM_EARTH
from astrojax.orbits import mean_motion
from astrojax.propagate import rk4_step
from owm_envs.config.params import Params
from owm_envs.dynamics.state import PhysicalState, VehicleState
from owm_envs.view import View


def station_rate(params: Params) -> Float[Array, "3"]:
    """Angular rate (3,) rad/s of the station frame in its own axes."""
    n = mean_motion(params.chief.elements[0], GM_EARTH)
    return jnp.stack([n, jnp.zeros_like(n), jnp.zeros_like(n)])


@dataclass(frozen=True)
class HillClohessyWiltshire:
    """Linear relative orbits and Euler's equations; the state keeps the chaser's inertial rate in body axes."""

    has_epoch: ClassVar[bool] = False

    def init(self, params: Params, epoch: Float[Array, "2"], view: Float[Array, "13"]) -> PhysicalState:
        """State with the relative view `view` (13,) at `epoch` (2,)."""
        _, _, attitude, rate = View.of(view)
        rate = rate + quat_rotate(quat_conjugate(attitude), station_rate(params))
        chaser = VehicleState(view[:6], attitude, rate)
        return PhysicalState(epoch, jnp.zeros((), view.dtype), view[:0], chaser)

    def step(
        self, params: Params, state: PhysicalState, wrench: Float[Array, "6"], dt: Float[Array, ""]
    ) -> PhysicalState:
        """Advance by `dt` seconds under a body wrench (6,) [N, N m]."""
        frame_rate = station_rate(params)
        n = frame_rate[0]
        radius = params.chief.elements[0]
        earth_to_station = jnp.stack([jnp.zeros_like(radius), jnp.zeros_like(radius), radius])

        def derivative(_, chaser):
            x, _, z, vx, vy, vz = chaser.orbit
            coupling = jnp.stack([-n * n * x, 2 * n * vz, 3 * n * n * z - 2 * n * vy])
            accel = coupling + quat_rotate(chaser.attitude, wrench[:3]) / params.chaser.mass
            to_body = quat_conjugate(chaser.attitude)
            from_earth = quat_rotate(to_body, earth_to_station + chaser.orbit[:3])
            torque = wrench[3:] + torque_gravity_gradient(from_earth, params.chaser.inertia, GM_EARTH)
            return VehicleState(
                jnp.stack([vx, vy, vz, *accel]),
                quat_derivative(chaser.attitude, chaser.rate - quat_rotate(to_body, frame_rate)),
                accel_euler(chaser.rate, params.chaser.inertia, torque),
            )

        chaser = rk4_step(derivative, state.elapsed, state.chaser, dt)
        chaser = chaser._replace(attitude=quat_normalize(chaser.attitude))
        return state._replace(elapsed=state.elapsed + dt, chaser=chaser)

    def relative_state(self, params: Params, state: PhysicalState) -> Float[Array, "13"]:
        """The 13-number relative view of a state."""
        chaser = state.chaser
        rate = chaser.rate - quat_rotate(quat_conjugate(chaser.attitude), station_rate(params))
        return jnp.concatenate([chaser.orbit, chaser.attitude, rate])
