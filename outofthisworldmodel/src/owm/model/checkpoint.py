"""World models on disk: weights as safetensors, statistics and configuration as JSON, nothing that executes."""

import json
import os
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import LeastSquares
from owm.files import replace_folder
from owm.model.config import ModelConfig
from owm.model.hub import local_folder
from owm.model.interface import WorldModel
from owm.model.linear import LinearMap
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Network, Params

FORMAT = 2
"""Raised whenever older files would be read wrongly."""
FILES = ("weights.safetensors", "statistics.json")


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged, or belongs to something else."""


def save_world_model(model: WorldModel, path: str | os.PathLike, *, about: dict[str, Any] | None = None) -> Path:
    """Write a world model into the directory `path`, replacing one that is there.

    The directory appears whole or not at all.

    Args:
        model: learned, least squares or constant velocity.
        path: directory to write.
        about: JSON-able facts to keep beside it, such as how it was trained.
    """
    path = Path(path)
    if isinstance(model, LearnedWorldModel):
        kind, config = "learned", model.config.model_dump()
        weights, statistics = model.params.network, model.params.statistics
    elif isinstance(model, LeastSquares | ConstantVelocity):
        kind = "least_squares" if isinstance(model, LeastSquares) else "constant_velocity"
        config = {"history_length": model.history_length, "dt": model.dt}
        weights, statistics = model.params, ()
    else:
        raise TypeError(f"cannot save a {type(model).__name__}; expected a world model of this package")
    contents = {
        "weights.safetensors": save_tensors(_named(weights)),
        "statistics.json": (json.dumps({k: v.tolist() for k, v in _named(statistics).items()}, indent=1)).encode(),
    }
    header = {
        "format": FORMAT,
        "kind": kind,
        "name": model.name,
        "config": config,
        "sha256": {name: sha256(data).hexdigest() for name, data in contents.items()},
        "about": about or {},
    }
    contents["config.json"] = (json.dumps(header, indent=1) + "\n").encode()
    replace_folder(path, contents)
    return path


def load_world_model(path: str | os.PathLike, *, expect: ModelConfig | None = None) -> Any:
    """Read a world model.

    Args:
        path: directory that `save_world_model` wrote, or a repository of the Hugging Face hub, `user/name`.
        expect: configuration that a learned model must have, if only one will do.

    Raises:
        FileNotFoundError: it is not on the hub, or the hub cannot be reached.
        CheckpointError: if a file is missing or damaged, the format is another version's, or configuration, names,
            shapes or types of the weights don't fit together.
    """
    path = local_folder(path)
    if not (path / "config.json").is_file():
        raise CheckpointError(f"no world model at {path}: config.json is missing")
    try:
        header = json.loads((path / "config.json").read_text(encoding="utf-8"))
        version, kind, digests = header["format"], header["kind"], header["sha256"]
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError) as error:
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
        return _build(kind, header, tensors, numbers, expect)
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def _build(kind: str, header: dict, tensors: dict, numbers: dict, expect: ModelConfig | None) -> WorldModel:
    if kind != "learned" and expect is not None:
        raise CheckpointError(f"expected a learned model, found {kind!r}")
    config, name = header["config"], header["name"]
    if kind == "constant_velocity":
        return ConstantVelocity(**config, name=name)
    if kind == "least_squares":
        return LeastSquares(_fill(LinearMap.skeleton(tensors["action"].dtype), tensors), **config, name=name)
    if kind != "learned":
        raise CheckpointError(f"unknown kind {kind!r}, expected learned, least_squares or constant_velocity")
    config = ModelConfig.model_validate(config)
    if expect is not None and config != expect:
        wrong = [k for k in ModelConfig.model_fields if getattr(config, k) != getattr(expect, k)]
        details = ", ".join(f"{k}={getattr(config, k)!r} where {getattr(expect, k)!r} is expected" for k in wrong)
        raise CheckpointError(f"another configuration: {details}")
    dtype = next(iter(tensors.values())).dtype
    network = _fill(eqx.filter_eval_shape(lambda: Network(config, key=jax.random.key(0), dtype=dtype)), tensors)
    skeleton = STREAMS[config.stream].skeleton(dtype)
    statistics = _fill(skeleton, {k: np.asarray(v, dtype) for k, v in numbers.items()})
    return LearnedWorldModel(config, Params(network, statistics), name)


def _paths(tree: Any, convert: Callable[[Any], Any]) -> dict[str, Any]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): convert(leaf) for path, leaf in leaves}


def _named(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves by their path."""
    return _paths(tree, lambda leaf: np.array(leaf, order="C"))


def _fill(skeleton: Any, arrays: dict[str, np.ndarray]) -> Any:
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
