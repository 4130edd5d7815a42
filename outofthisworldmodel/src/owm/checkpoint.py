"""Models on disk: weights as safetensors, statistics and configuration as JSON, nothing that executes."""

import json
import os
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from owm_envs.files import FolderTaken, output_folder, replace_folder, strangers

FORMAT = 2
"""Raised whenever older files would be read wrongly."""
FILES = ("weights.safetensors", "statistics.json")


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged, or belongs to something else."""


class NoCheckpointError(CheckpointError, FileNotFoundError):
    """Nothing is there."""

    def __init__(self, source: str | os.PathLike, reason: str = "config.json is missing"):
        super().__init__(f"there is no checkpoint at {os.fspath(source)!r}: {reason}")


class Contents(NamedTuple):
    """What a model is made of, and is made from again."""

    kind: str
    """Which class reads it."""
    name: str
    """What reports call the model."""
    config: dict[str, Any]
    weights: PyTree
    """Of arrays; read back, by their paths."""
    statistics: PyTree = ()
    """The same, of few numbers."""


class Saveable(Protocol):
    """A model that a checkpoint can hold."""

    def contents(self) -> Contents:
        """What to write."""


def save_world_model(model: Saveable, path: str | os.PathLike, *, about: Mapping[str, Any] | None = None) -> Path:
    """Write a world model into the directory `path`, replacing one that is there.

    The directory appears whole or not at all.

    Args:
        model: learned, least squares or constant velocity.
        path: directory to write.
        about: JSON-able facts to keep beside it, such as how it was trained.

    Returns:
        Where it is: "~" and links followed.

    Raises:
        TypeError: the model says nothing of its contents.
        FolderTaken: the directory holds something else than a checkpoint.
        CheckpointError: a number of it is not finite.
    """
    if not hasattr(model, "contents"):
        raise TypeError(f"cannot save a {type(model).__name__}; expected a world model of this package")
    kind, name, config, weights, statistics = model.contents()
    check_finite(weights, statistics)
    contents = {
        "weights.safetensors": save_tensors(_named(weights)),
        "statistics.json": (json.dumps({k: v.tolist() for k, v in _named(statistics).items()}, indent=1)).encode(),
    }
    header = {
        "format": FORMAT,
        "kind": kind,
        "name": name,
        "config": config,
        "sha256": {name: sha256(data).hexdigest() for name, data in contents.items()},
        "about": dict(about or {}),
    }
    return write_checkpoint(path, header, contents)


def write_checkpoint(path: str | os.PathLike, header: dict[str, Any], contents: Mapping[str, bytes]) -> Path:
    """Write a checkpoint's files and its `config.json`, in place of nothing or of an earlier checkpoint.

    Raises:
        NotADirectoryError, PermissionError: as `output_folder`.
        FolderTaken: the directory holds something else.
    """
    folder = output_folder(path)
    if (others := strangers(folder)) and not _is_checkpoint(folder):
        raise FolderTaken(f"{folder} holds {others[0]} but no checkpoint: choose another folder, or remove it")
    # The header first: it tells whose the folder is, and that files beside it are not its own yet.
    return replace_folder(folder, {"config.json": (json.dumps(header, indent=1) + "\n").encode(), **contents})


def _is_checkpoint(folder: Path) -> bool:
    try:
        return {"format", "kind", "sha256"} <= set(json.loads((folder / "config.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return False


def read_checkpoint(path: str | os.PathLike, make: Callable[[Contents], Any]) -> Any:
    """Read a checkpoint and make a model of its contents.

    Args:
        path: directory that `save_world_model` wrote.
        make: from the contents, arrays by their paths.

    Raises:
        CheckpointError: a file is missing or damaged, the format is another version's, configuration, names, shapes
            or types don't fit together, or a number is not finite.
    """
    path = Path(path)
    if not (path / "config.json").is_file():
        raise NoCheckpointError(path)
    try:
        header = json.loads((path / "config.json").read_text(encoding="utf-8"))
        version, kind, digests = header["format"], header["kind"], dict(header["sha256"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise CheckpointError(f"{path / 'config.json'} is damaged: {error!r}") from error
    if version != FORMAT:
        raise CheckpointError(f"{path} has format {version!r}, this version reads format {FORMAT}")
    contents = {}
    for name in FILES:
        if not (path / name).is_file():
            raise CheckpointError(f"{path} is incomplete: {name} is missing")
        contents[name] = (path / name).read_bytes()
        if sha256(contents[name]).hexdigest() != digests.get(name):
            raise CheckpointError(f"{path / name} does not match config.json: damaged, or from another checkpoint")
    try:
        tensors = load_tensors(contents["weights.safetensors"])
        numbers = json.loads(contents["statistics.json"])
        if not (isinstance(numbers, dict) and isinstance(header["config"], dict)):
            raise CheckpointError("config and statistics.json must be tables by name")
        check_finite(tensors, {name: np.asarray(value) for name, value in numbers.items()})
        return make(Contents(kind, header["name"], header["config"], tensors, numbers))
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def check_finite(*trees: PyTree) -> None:
    """Refuse numbers that predict nothing.

    Raises:
        CheckpointError: a leaf holds one that is not finite, or not real, naming it.
    """
    for tree in trees:
        for name, leaf in _named(tree).items():
            kinds = (jnp.floating, jnp.integer, jnp.bool_)
            if not any(jnp.issubdtype(leaf.dtype, kind) for kind in kinds):
                raise CheckpointError(f"{name} must hold real numbers, got {leaf.dtype}")
            if bad := np.count_nonzero(~np.isfinite(leaf)):
                raise CheckpointError(f"{name} holds {bad} of {leaf.size} numbers that are not finite")


def _paths(tree: Any, convert: Callable[[Any], Any]) -> dict[str, Any]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): convert(leaf) for path, leaf in leaves}


def _named(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves by their path."""
    return _paths(tree, lambda leaf: np.array(leaf, order="C"))


def fill(skeleton: Any, arrays: dict[str, np.ndarray]) -> Any:
    """Put arrays into a tree of shapes.

    Raises:
        CheckpointError: if names, shapes or types differ.
    """
    expected = _paths(skeleton, lambda leaf: leaf)
    if missing := sorted(set(expected) - set(arrays)):
        raise CheckpointError(f"{', '.join(missing)} missing")
    if surplus := sorted(set(arrays) - set(expected)):
        raise CheckpointError(f"{', '.join(surplus)} not part of this configuration")
    for name, leaf in expected.items():
        if arrays[name].shape != leaf.shape or arrays[name].dtype != leaf.dtype:
            raise CheckpointError(
                f"{name} is {arrays[name].dtype} {arrays[name].shape}, expected {leaf.dtype} {leaf.shape}"
            )
    return jax.tree.unflatten(jax.tree.structure(skeleton), [jnp.asarray(arrays[name]) for name in expected])
