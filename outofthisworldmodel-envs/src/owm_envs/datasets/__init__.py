"""Datasets of recorded flights: LeRobot v3 folders written and read with pyarrow alone.

`read(path, split)` gives episodes back bit for bit, `read_statistics(path)` what to normalise by; `generate` records.
"""

from owm_envs.datasets.fetch import download, local_dataset
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.reader import read, read_statistics
from owm_envs.episode import POLICY_NAMES, Episode

__all__ = ["POLICY_NAMES", "Episode", "Request", "download", "generate", "local_dataset", "read", "read_statistics"]
