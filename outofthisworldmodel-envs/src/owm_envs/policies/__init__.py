"""Scripted policies, pure and for one episode (`make_policy`), and the shell that flies slots (`SlotPolicy`)."""

from owm_envs.policies.base import ScriptedPolicy
from owm_envs.policies.factory import make_policy
from owm_envs.policies.slots import SlotPolicy, Slots
from owm_envs.policies.vector import VectorPolicy

__all__ = ["ScriptedPolicy", "SlotPolicy", "Slots", "VectorPolicy", "make_policy"]
