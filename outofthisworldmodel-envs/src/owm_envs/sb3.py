"""Stable-Baselines3: `make_vec_env` (needs the extra `sb3`, which brings torch)."""

from owm_envs.adapters.sb3 import DockingVecEnv, make_vec_env

__all__ = ["DockingVecEnv", "make_vec_env"]
