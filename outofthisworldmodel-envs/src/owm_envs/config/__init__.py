"""The configuration of a docking environment, as text (`text`) and as traced arrays (`params`)."""

from owm_envs.config.docking import CONFIG_PRESETS, FIDELITIES, DockingConfig, Fidelity, Structure, load_config
from owm_envs.config.parts import NOISE_PRESETS, REWARD_PRESETS

__all__ = [
    "CONFIG_PRESETS",
    "FIDELITIES",
    "NOISE_PRESETS",
    "REWARD_PRESETS",
    "DockingConfig",
    "Fidelity",
    "Structure",
    "load_config",
]
