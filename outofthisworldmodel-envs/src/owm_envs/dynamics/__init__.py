"""Equations of motion: each fidelity is one frozen class of three pure functions behind `Dynamics`.

A new fidelity is one more module and one line in `DYNAMICS`; equations of your own need neither: pass them to an
environment as `dynamics`.
"""

from collections.abc import Callable
from typing import Protocol

from jaxtyping import Array, Float

from owm_envs.config import DockingConfig
from owm_envs.config.params import Params
from owm_envs.dynamics.chief import RTN_TO_STATION, station_orbit
from owm_envs.dynamics.free_flyer import FreeFlyer
from owm_envs.dynamics.hcw import HillClohessyWiltshire
from owm_envs.dynamics.numerical import NumericalOrbits
from owm_envs.dynamics.state import PhysicalState, VehicleState
from owm_envs.dynamics.turning import TurningTarget
from owm_envs.words import require_parts


class Dynamics(Protocol):
    """What the task layer asks of a fidelity; instances are static and hashable."""

    has_epoch: bool
    """Whether observations are prefixed with the epoch."""

    def init(self, params: Params, epoch: Float[Array, "2"], view: Float[Array, "13"]) -> PhysicalState:
        """State at `epoch` [MJD day, s of day] whose relative view is `view`."""

    def step(
        self, params: Params, state: PhysicalState, wrench: Float[Array, "6"], dt: Float[Array, ""]
    ) -> PhysicalState:
        """Advance by `dt` seconds under a held body wrench [N, N m]."""

    def relative_state(self, params: Params, state: PhysicalState) -> Float[Array, "13"]:
        """Position m, velocity m/s (station frame), quaternion body to station, body rate rad/s (station-relative)."""


DYNAMICS: dict[str, Callable[[DockingConfig], Dynamics]] = {
    "iss": lambda config: FreeFlyer(),
    "iss-hcw": lambda config: HillClohessyWiltshire(),
    "iss-numerical": lambda config: NumericalOrbits(
        zonal_degree=config.forces.zonal_degree,
        sun=config.forces.sun,
        moon=config.forces.moon,
        drag=config.forces.drag,
    ),
}


def require_dynamics(candidate: object) -> None:
    """Raise TypeError, naming what is missing, unless the candidate is a `Dynamics` that can be hashed."""
    names = ("has_epoch", "init", "step", "relative_state")
    require_parts("dynamics", "a Dynamics (owm_envs.dynamics)", candidate, names)


__all__ = [
    "DYNAMICS",
    "RTN_TO_STATION",
    "Dynamics",
    "PhysicalState",
    "TurningTarget",
    "VehicleState",
    "require_dynamics",
    "station_orbit",
]
