"""Recorded datasets as the episodes that training and scoring take."""

import os
from collections.abc import Iterable, Sequence
from types import SimpleNamespace

from owm.data import STRIDE, Episodes, from_episodes
from owm_envs.datasets.reader import dataset_folder, read, read_info
from owm_envs.datasets.schema import Episode
from owm_envs.station import PORT_NAMES, TRAIN_PORTS

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


def training_episodes(path: str | os.PathLike, phases: int = 5) -> tuple[Episodes, Episodes]:
    """Read what to train on, and what to choose the best weights by: val, and every twelfth episode of train.

    Args:
        path: a 20 Hz dataset with the splits train and val.
        phases: offsets of the model's grid in the recording to train on, as `from_episodes` takes it.

    Raises:
        FileNotFoundError, ValueError: as `read_recordings` and `at_model_rate`.
    """
    train, val = read_recordings(path, "train"), read_recordings(path, "val")
    aside = train[11::12]
    kept = [episode for i, episode in enumerate(train) if i % 12 != 11]
    return at_model_rate(kept, phases=phases), at_model_rate([*val, *aside], ports=TRAIN_PORTS)
