"""Datasets of recorded flights: LeRobot v3 folders written and read with pyarrow alone.

`generate` records. `open(path, split)` gives the episodes and windows of any LeRobot dataset, one by one; `read` all
episodes of one of ours, bit for bit; `read_statistics(path)` what to normalise by. `download` fetches from the hub.
"""

from owm_envs.datasets.fetch import download, local_dataset
from owm_envs.datasets.generate import generate
from owm_envs.datasets.reader import Dataset, read, read_statistics
from owm_envs.datasets.reader import open_dataset as open
from owm_envs.datasets.recipe import Request
from owm_envs.episode import POLICY_NAMES, Episode

__all__ = [
    "POLICY_NAMES",
    "Dataset",
    "Episode",
    "Request",
    "download",
    "generate",
    "local_dataset",
    "open",
    "read",
    "read_statistics",
]
