"""Whether what a user brings keeps its contract: `check_env` for equations of motion, `check_policy` for policies."""

from owm_envs.testing.environment import check_env
from owm_envs.testing.policy import check_policy

__all__ = ["check_env", "check_policy"]
