"""Recorded datasets as the episodes that training and scoring take."""

import contextlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from owm.data.windows import STRIDE, Episodes, from_episodes
from owm_envs.datasets.fetch import local_dataset, origin
from owm_envs.datasets.reader import open_dataset
from owm_envs.episode import Episode
from owm_envs.files import read_text
from owm_envs.station import PORT_NAMES, TRAIN_PORTS

RATE = 20
"""Frames a second that a dataset has, or every `STRIDE`-th of them: actions held for a step of the model."""


class Recording(NamedTuple):
    """One flight as `from_episodes` takes it; `stride` frames are a step of the model."""

    observation: dict[str, Shaped[np.ndarray, "T+1 ..."]]
    true_state: Float[np.ndarray, "T+1 13"]
    action: Float[np.ndarray, "T 6"]
    policy: str
    port: str
    stride: int


def recorded(episode: Episode, stride: int = STRIDE) -> Recording:
    """Return a flight as training takes it."""
    return Recording(
        episode.observation,
        episode.true_state,
        episode.action,
        episode.policy_name,
        PORT_NAMES[episode.port],
        stride,
    )


def read_recordings(path: str | os.PathLike, split: str) -> list[Recording]:
    """Read a split of a dataset of 20 Hz, or of the model's rate.

    Raises:
        FileNotFoundError: there is no such dataset or split.
        ValueError: the dataset is damaged, as its reader tells in one line, or recorded at another rate.
    """
    dataset = open_dataset(path, split)
    rate = dataset.fps or RATE
    strides = {RATE: STRIDE, RATE // STRIDE: 1}
    if rate not in strides:
        raise ValueError(
            f"{dataset.folder} holds {rate:g} frames a second; the model steps over {STRIDE} frames of a {RATE} Hz "
            f"recording, or one of {RATE // STRIDE} Hz: generate it with steps_per_action=1 or {STRIDE}"
        )
    return [recorded(episode, strides[rate]) for episode in dataset.episodes()]


def at_model_rate(recordings: Iterable[Recording], *, ports: Sequence[str] | None = None, phases: int = 1) -> Episodes:
    """Resample recordings to the model's rate.

    Args:
        ports: keep the flights to these only.
        phases: as `from_episodes` takes it.

    Raises:
        ValueError: nothing is left, or no episode is long enough.
    """
    return from_episodes((r for r in recordings if ports is None or r.port in ports), phases=phases)


def training_episodes(
    paths: str | os.PathLike | Sequence[str | os.PathLike], phases: int = 5
) -> tuple[Episodes, Episodes]:
    """Read what to train on, and what to choose the best weights by: val, and flights set aside from train.

    Of each dataset's train split every eighth flight of each policy is set aside (the last one of a policy that has
    three to seven), so that each behaviour, the planner-style one too, is judged on flights not trained on.

    Args:
        paths: one or several datasets with the splits train and val; several are pooled.
        phases: offsets of the model's grid in the recording to train on, as `from_episodes` takes it.

    Raises:
        FileNotFoundError, ValueError: as `read_recordings` and `at_model_rate`.
    """
    kept, judged = [], []
    for path in [paths] if isinstance(paths, str | os.PathLike) else paths:
        train = read_recordings(path, "train")
        total, seen = Counter(recording.policy for recording in train), Counter()
        for recording in train:
            flights, number = total[recording.policy], seen[recording.policy]
            aside = flights >= 3 and number % 8 == min(flights, 8) - 1
            (judged if aside else kept).append(recording)
            seen[recording.policy] += 1
        judged += read_recordings(path, "val")
    return at_model_rate(kept, phases=phases), at_model_rate(judged, ports=TRAIN_PORTS)


def corpus_facts(path: str | os.PathLike) -> dict[str, Any]:
    """What a checkpoint remembers of a dataset it was trained on: its commit on the hub or name, fidelity, noise, step.

    Datasets that `owm-envs generate` did not write don't tell all of them; those are then missing.
    """
    folder = local_dataset(path)
    facts = {"name": origin(folder) or folder.name}
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        environment = json.loads(read_text(folder / "generation.json"))["environment"]
        facts |= {name: environment[name] for name in ("fidelity", "noise", "dt")}
    return facts
