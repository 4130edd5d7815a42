"""JAX does not survive a fork: a child of a process that has used it would wait for ever for threads it has not got."""

import os
import sys

_used_here = False
_used_by_parent = False


def _after_fork() -> None:
    global _used_by_parent
    _used_by_parent = _used_here or _jax_has_started()


def _jax_has_started() -> bool:
    bridge = sys.modules.get("jax._src.xla_bridge")  # there is no public way to ask without starting it
    return bool(getattr(bridge, "_backends", None))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def about_to_use_jax() -> None:
    """Call before the first use of JAX in a process.

    Raises:
        RuntimeError: the process was forked from one that has used JAX.
    """
    global _used_here
    if _used_by_parent:
        raise RuntimeError(
            "this process was forked from one that has used JAX, which would hang here: start it afresh, for example "
            'AsyncVectorEnv(..., context="spawn"), or use the native gymnasium.make_vec(..., num_envs=...)'
        )
    _used_here = True
