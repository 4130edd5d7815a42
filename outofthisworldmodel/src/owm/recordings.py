"""Recorded datasets as the episodes that training and scoring take."""

import os
from collections.abc import Iterable, Sequence
from types import SimpleNamespace

from owm.data import STRIDE, Episodes, from_episodes
from owm_envs.datasets.reader import dataset_folder, read, read_info
from owm_envs.datasets.schema import Episode
from owm_envs.station import PORT_NAMES

RATE = 20
"""Frames a second that a dataset must have."""


def read_recordings(path: str | os.PathLike, split: str) -> list[Episode]:
    """Read a split of a 20 Hz dataset.

    Raises:
        FileNotFoundError: there is no such dataset or split.
        ValueError: the dataset is damaged, or recorded at another rate.
    """
    folder = dataset_folder(path, split)
    rate = read_info(folder).get("fps")
    if rate is not None and abs(float(rate) - RATE) > 1e-6:
        raise ValueError(
            f"{folder} holds {rate:g} frames a second; the model steps over {STRIDE} frames of a {RATE} Hz "
            "recording: generate it with steps_per_action=1"
        )
    return read(path, split)


def at_model_rate(recordings: Iterable[Episode], *, ports: Sequence[str] | None = None, phases: int = 1) -> Episodes:
    """Resample recordings to the model's rate.

    Args:
        ports: keep the flights to these only.
        phases: as `from_episodes` takes it.

    Raises:
        ValueError: nothing is left, or no episode is long enough.
    """
    kept = [
        SimpleNamespace(
            state=episode.observation,
            true_state=episode.true_state,
            action=episode.action,
            policy=episode.policy_name,
            port=PORT_NAMES[episode.port],
        )
        for episode in recordings
        if ports is None or PORT_NAMES[episode.port] in ports
    ]
    return from_episodes(kept, phases=phases)
