"""Who reads which kind of checkpoint."""

import os
from collections.abc import Callable
from typing import Any

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import LeastSquares
from owm.baselines.ppo.policy import read_policy
from owm.checkpoint import CheckpointError, Contents, Header, read_checkpoint, read_header
from owm.model.world_model import LearnedWorldModel

WORLD_MODELS: dict[str, Callable[[Contents], Any]] = {
    kind: model.from_contents
    for kind, model in (
        ("learned", LearnedWorldModel),
        ("least_squares", LeastSquares),
        ("constant_velocity", ConstantVelocity),
    )
}
KINDS = WORLD_MODELS | {"ppo": read_policy}


def make(contents: Contents, kinds: dict[str, Callable[[Contents], Any]] = KINDS) -> Any:
    """What a checkpoint of one of some kinds holds.

    Raises:
        CheckpointError, ValueError: it is of another kind, or its parts don't fit together.
    """
    if contents.kind not in kinds:
        raise CheckpointError(f"unknown kind {contents.kind!r}, expected {', '.join(kinds)}")
    return kinds[contents.kind](contents)


def check(path: str | os.PathLike) -> Header:
    """Read a checkpoint of any kind to the last number, and return what it tells of itself.

    Raises:
        CheckpointError: as `owm.checkpoint.read_checkpoint`.
    """
    read_checkpoint(path, make)
    return read_header(path)
