"""PettingZoo: `parallel_env` and `env` (need the extra `pettingzoo`)."""

from owm_envs.adapters.pettingzoo import DockingParallelEnv, env, parallel_env, raw_env

__all__ = ["DockingParallelEnv", "env", "parallel_env", "raw_env"]
