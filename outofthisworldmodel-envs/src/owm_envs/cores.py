"""The processor's cores: how many there are, and threads and processes that share them."""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import jax
import numpy as np

_CACHE = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")


def core_count() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(maxsize=1)
def workers() -> ThreadPoolExecutor:
    """Threads, one to a core, for compiled programs that run side by side."""
    return ThreadPoolExecutor(core_count(), thread_name_prefix="owm_envs")


def core_shares(count: int) -> list[list[int]]:
    """The cores that this process may use, shared out; all to who would get none, none where they cannot be named."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return [share.tolist() or cores for share in np.array_split(cores, count)]


def settings() -> dict[str, object]:
    """JAX's settings that a process started from here should take over."""
    return {name: getattr(jax.config, name) for name in _CACHE}


def settle(share: list[int], taken_over: dict[str, object]) -> None:
    """Hold this new process to its share of the cores, before JAX counts them, and JAX to `settings` of its parent."""
    if share:
        os.sched_setaffinity(0, share)
    for name, value in taken_over.items():
        jax.config.update(name, value)
