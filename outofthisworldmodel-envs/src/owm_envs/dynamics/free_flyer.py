"""`iss`: a rigid free-flyer without orbital mechanics; the station frame is inertial."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import accel_euler, quat_derivative, quat_normalize, quat_rotate
from astrojax.propagate import rk4_step
from owm_envs.config.params import Params
from owm_envs.dynamics.state import PhysicalState, VehicleState
from owm_envs.view import View


@dataclass(frozen=True)
class FreeFlyer:
    """Double integrator and Euler's equations."""

    has_epoch: ClassVar[bool] = False

    def init(self, params: Params, epoch: Float[Array, "2"], view: Float[Array, "13"]) -> PhysicalState:
        """State with the relative view `view` (13,) at `epoch` (2,)."""
        _, _, attitude, rate = View.of(view)
        chaser = VehicleState(view[:6], attitude, rate)
        return PhysicalState(epoch, jnp.zeros((), view.dtype), view[:0], chaser)

    def step(
        self, params: Params, state: PhysicalState, wrench: Float[Array, "6"], dt: Float[Array, ""]
    ) -> PhysicalState:
        """Advance by `dt` seconds under a body wrench (6,) [N, N m]."""

        def derivative(_, chaser):
            accel = quat_rotate(chaser.attitude, wrench[:3]) / params.chaser.mass
            return VehicleState(
                jnp.concatenate([chaser.orbit[3:], accel]),
                quat_derivative(chaser.attitude, chaser.rate),
                accel_euler(chaser.rate, params.chaser.inertia, wrench[3:]),
            )

        chaser = rk4_step(derivative, state.elapsed, state.chaser, dt)
        chaser = chaser._replace(attitude=quat_normalize(chaser.attitude))
        return state._replace(elapsed=state.elapsed + dt, chaser=chaser)

    def relative_state(self, params: Params, state: PhysicalState) -> Float[Array, "13"]:
        """The 13-number relative view: this fidelity's state already is one."""
        return jnp.concatenate(state.chaser)
