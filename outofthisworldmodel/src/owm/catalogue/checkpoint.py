"""World models from folders and from the hub."""

import os

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import LeastSquares
from owm.catalogue.hub import checkpoint_folder
from owm.checkpoint import CheckpointError, Contents, read_checkpoint
from owm.interface import WorldModel
from owm.model.config import ModelConfig
from owm.model.world_model import LearnedWorldModel

_MODELS = {"learned": LearnedWorldModel, "least_squares": LeastSquares, "constant_velocity": ConstantVelocity}
"""Who reads which kind of checkpoint."""


def load_world_model(path: str | os.PathLike, *, expect: ModelConfig | None = None) -> WorldModel:
    """Read a world model.

    Args:
        path: directory that `save_world_model` wrote, a run's folder with one inside, "pretrained", or a repository of
            the Hugging Face hub, `user/name`.
        expect: configuration that a learned model must have, if only one will do.

    Raises:
        FileNotFoundError, ValueError: there is nothing, as `owm.catalogue.hub.checkpoint_folder`.
        CheckpointError: as `owm.checkpoint.read_checkpoint`, or the kind of model is unknown.
    """

    def make(contents: Contents) -> WorldModel:
        if expect is not None:
            return LearnedWorldModel.from_contents(contents, expect)
        if contents.kind not in _MODELS:
            raise CheckpointError(f"unknown kind {contents.kind!r}, expected {', '.join(_MODELS)}")
        return _MODELS[contents.kind].from_contents(contents)

    return read_checkpoint(checkpoint_folder(path), make)
