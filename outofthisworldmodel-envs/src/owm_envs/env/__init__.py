"""The pure environments: `DockingEnv`, one chaser, and `FleetEnv`, several."""

from owm_envs.env.docking import DockingEnv, EnvState, StepResult, restart_where
from owm_envs.env.fleet import START_SEPARATION, FleetEnv, FleetLayout, FleetState, assign_ports

__all__ = [
    "START_SEPARATION",
    "DockingEnv",
    "EnvState",
    "FleetEnv",
    "FleetLayout",
    "FleetState",
    "StepResult",
    "assign_ports",
    "restart_where",
]
