"""World models from folders and from the hub."""

import os

from owm.catalogue.hub import checkpoint_folder
from owm.catalogue.kinds import WORLD_MODELS, make
from owm.checkpoint import Contents, read_checkpoint
from owm.interface import WorldModel
from owm.model.config import ModelConfig
from owm.model.world_model import LearnedWorldModel


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

    def made(contents: Contents) -> WorldModel:
        if expect is not None:
            return LearnedWorldModel.from_contents(contents, expect)
        return make(contents, WORLD_MODELS)

    return read_checkpoint(checkpoint_folder(path), made)
