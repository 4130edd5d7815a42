"""The pure environments: `DockingEnv`, one chaser, and `FleetEnv`, several."""

from owm_envs.env.docking import DockingEnv, EnvState, StepResult, restart_where
from owm_envs.env.fleet import START_SEPARATION, FleetEnv, FleetLayout, FleetState, assign_ports
from owm_envs.env.subject import docking_env

__all__ = [
    "START_SEPARATION",
    "DockingEnv",
    "EnvState",
    "FleetEnv",
    "FleetLayout",
    "FleetState",
    "StepResult",
    "assign_ports",
    "docking_env",
    "restart_where",
]
