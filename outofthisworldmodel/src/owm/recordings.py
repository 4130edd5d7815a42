"""Recorded datasets as the episodes that training and scoring take."""

import contextlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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


def training_episodes(
    paths: str | os.PathLike | Sequence[str | os.PathLike], phases: int = 5
) -> tuple[Episodes, Episodes]:
    """Read what to train on, and what to choose the best weights by: val, and flights set aside from train.

    Of each dataset's train split every eighth flight of each policy is set aside (the last one of a policy that has
    three to seven), so that each behaviour, the planner-style one too, is judged on flights not trained on.

    Args:
        paths: one or several 20 Hz datasets with the splits train and val; several are pooled.
        phases: offsets of the model's grid in the recording to train on, as `from_episodes` takes it.

    Raises:
        FileNotFoundError, ValueError: as `read_recordings` and `at_model_rate`.
    """
    kept, judged = [], []
    for path in [paths] if isinstance(paths, str | os.PathLike) else paths:
        train = read_recordings(path, "train")
        total, seen = Counter(episode.policy for episode in train), Counter()
        for episode in train:
            flights, number = total[episode.policy], seen[episode.policy]
            aside = flights >= 3 and number % 8 == min(flights, 8) - 1
            (judged if aside else kept).append(episode)
            seen[episode.policy] += 1
        judged += read_recordings(path, "val")
    return at_model_rate(kept, phases=phases), at_model_rate(judged, ports=TRAIN_PORTS)


def corpus_facts(path: str | os.PathLike) -> dict[str, Any]:
    """What a checkpoint remembers of a dataset it was trained on: fidelity, noise and frame rate.

    Datasets that `owm-envs generate` did not write don't tell all of them; those are then missing.
    """
    facts = {"name": Path(path).name}
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        environment = json.loads((Path(path) / "generation.json").read_text(encoding="utf-8"))["environment"]
        facts |= {name: environment[name] for name in ("fidelity", "noise", "dt")}
    return facts
