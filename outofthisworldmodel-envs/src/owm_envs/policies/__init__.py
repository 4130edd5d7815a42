"""Scripted policies, pure and for one episode (`make_policy`), and the shell that flies batches (`VectorPolicy`)."""

from owm_envs.policies.scripted import ScriptedPolicy, make_policy
from owm_envs.policies.vector import VectorPolicy

__all__ = ["ScriptedPolicy", "VectorPolicy", "make_policy"]
