"""A worker of pytest-xdist keeps to its share of the cores: XLA loses more on cores that are shared than it gains."""

import os

import numpy as np


def pytest_configure():
    """Before any test, and so before JAX counts the cores."""
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker and hasattr(os, "sched_setaffinity"):
        shares = np.array_split(sorted(os.sched_getaffinity(0)), int(os.environ["PYTEST_XDIST_WORKER_COUNT"]))
        if (share := shares[int(worker.removeprefix("gw"))]).size:
            os.sched_setaffinity(0, share.tolist())
