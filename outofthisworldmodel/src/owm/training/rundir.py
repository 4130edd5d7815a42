"""A run's folder: whose it is, what it was killed with, and what it keeps.

run.json          configuration and fingerprints of the data; batch size and devices as they were settled
state/            everything the next step needs, of the latest save
checkpoints/STEP  the weights of the latest saves, each a world model of its own
model/            the weights with the best validation score, once the run is complete
metrics.jsonl, tensorboard/
"""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from owm.checkpoint import CheckpointError, save_world_model
from owm.model.world_model import LearnedWorldModel
from owm.training.step import TrainState
from owm_envs.files import remove

PARTS = ("state", "checkpoints", "model", "tensorboard", "wandb", "metrics.jsonl")
"""What a run makes beside `run.json`."""


def state_manager(out: Path) -> ocp.CheckpointManager:
    """Return the keeper of `state/`, which holds the latest save."""
    options = ocp.CheckpointManagerOptions(max_to_keep=1, enable_async_checkpointing=False, create=True)
    return ocp.CheckpointManager((out / "state").absolute(), options=options)


def restore(manager: ocp.CheckpointManager, state: TrainState) -> TrainState:
    """Return the latest save, or `state` if there is none.

    Raises:
        CheckpointError: the save is damaged.
    """
    step = manager.latest_step()
    if step is None:
        return state
    target = ocp.args.StandardRestore(jax.tree.map(ocp.utils.to_shape_dtype_struct, state))
    try:
        restored = manager.restore(step, args=target)
    except Exception as error:  # what is raised for a damaged file is no part of orbax's interface
        folder = manager.directory
        raise CheckpointError(
            f"{folder / str(step)} is damaged ({type(error).__name__}): delete {folder.parent} or choose another folder"
        ) from error
    # By way of NumPy: arrays that come committed to a device would have the training step compiled a second time.
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), restored)


def keep_checkpoint(out: Path, model: LearnedWorldModel, step: int, keep: int, about: dict[str, Any]) -> None:
    """Write the weights of one save as `checkpoints/STEP` and remove all but the latest `keep`."""
    folder = out / "checkpoints"
    if keep:
        save_world_model(model, folder / str(step), about=about)
    saved = sorted((path for path in folder.glob("*") if path.name.isdigit()), key=lambda path: int(path.name))
    for path in saved[: max(len(saved) - keep, 0)]:
        remove(path)
