"""Models on disk: weights as safetensors, statistics and configuration as JSON, nothing that executes.

What is read is trusted in nothing. Sizes are bounded; names, types and shapes are compared with what the configuration
calls for before a number is read; numbers must be finite and of a size that means something; and every file has its
digest in `config.json`, that file itself too.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree
from pydantic import ConfigDict, Field, model_validator
from pydantic_core import from_json
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from owm_envs.config.parts import Frozen
from owm_envs.files import FolderTaken, output_folder, replace_folder, strangers
from owm_envs.words import plain

FORMAT = 3
"""Raised whenever older files would be read wrongly."""
OLDER = (1, 2)
"""Still read; their `config.json` has no digest of its own."""
HEADER, WEIGHTS, STATISTICS = FILES = ("config.json", "weights.safetensors", "statistics.json")
LARGEST_WEIGHT, LARGEST = 1e3, 1e6
"""A weight, or a number that was measured, means nothing beyond."""
_MOST_TEXT = 2**24
"""Bytes of a JSON file."""
_TYPES = {"F32": np.dtype("float32"), "F64": np.dtype("float64")}
"""Of weights, by safetensors' names."""
_WRONG = (SafetensorError, KeyError, TypeError, ValueError, OverflowError, OSError, RecursionError)
"""What comes of files that were not written here."""


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged, or belongs to something else."""


class NoCheckpointError(CheckpointError, FileNotFoundError):
    """Nothing is there."""

    def __init__(self, source: str | os.PathLike, reason: str = f"{HEADER} is missing"):
        super().__init__(f"there is no checkpoint at {os.fspath(source)!r}: {reason}")


class Contents(NamedTuple):
    """What a model is made of, and is made from again."""

    kind: str
    """Which class reads it."""
    name: str
    """What reports call the model."""
    config: dict[str, Any]
    weights: PyTree
    """Of arrays; read back, by their paths, as `Stored`."""
    statistics: PyTree = ()
    """Of arrays, few numbers; read back, by their paths."""


class Saveable(Protocol):
    """A model that a checkpoint can hold."""

    def contents(self) -> Contents:
        """What to write."""

    @classmethod
    def from_contents(cls, contents: Contents) -> "Saveable":
        """The model of what was read. Raises CheckpointError, ValueError: its parts don't fit together."""


class _Told(Frozen):
    """A table of the types that are read, and of more."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


class Noise(_Told):
    """Of a dataset's sensors: `owm_envs.config.parts.NoiseConfig` as far as it is told."""

    position: float | None = None
    position_per_range: float | None = None
    velocity: float | None = None


class Corpus(_Told):
    """A dataset that a model was trained on."""

    name: str = ""
    fidelity: str | None = None
    noise: Noise | None = None


class About(_Told):
    """How a model came to be."""

    corpus: list[Corpus] = Field(default_factory=list)
    settled: dict[str, Any] = Field(default_factory=dict)
    run: dict[str, Any] = Field(default_factory=dict)
    parameters: int | None = None
    score: float | None = None
    step: int | None = None


class Header(Frozen):
    """`config.json` of a checkpoint of any kind."""

    model_config = ConfigDict(strict=True)
    format: int
    kind: Annotated[str, Field(max_length=100)]
    name: Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""
    config: dict[str, Any]
    sha256: dict[str, Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]]
    about: About = About()

    @model_validator(mode="before")
    @classmethod
    def _older(cls, table: Any) -> Any:
        """Policies of format 1 told among other things what they observe, and had one file beside this."""
        if not isinstance(table, dict) or table.get("format") != 1 or not isinstance(table.get("about"), dict):
            return table
        observed = ("env", "observe_field", "observation")
        config = {name: value for name, value in table["about"].items() if name in observed}
        return {**table, "config": config, "sha256": {WEIGHTS: table.get("sha256")}}

    @model_validator(mode="after")
    def _check(self) -> "Header":
        needed = {WEIGHTS} if self.format in OLDER else {WEIGHTS, HEADER}
        if not needed <= set(self.sha256) <= set(FILES):
            raise ValueError(f"sha256 must be of {', '.join(FILES)}, got {', '.join(self.sha256) or 'nothing'}")
        return self


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
        CheckpointError: a number of it is not finite, or larger than any that means something.
    """
    if not hasattr(model, "contents"):
        raise TypeError(f"cannot save a {type(model).__name__}; expected a world model of this package")
    contents = model.contents()
    # What could not be read again is not written.
    model.from_contents(contents._replace(weights=_named(contents.weights), statistics=_named(contents.statistics)))
    return write_checkpoint(path, contents, about)


def write_checkpoint(path: str | os.PathLike, contents: Contents, about: Mapping[str, Any] | None = None) -> Path:
    """Write a checkpoint in place of nothing or of an earlier one.

    Raises:
        NotADirectoryError, PermissionError: as `output_folder`.
        FolderTaken: the directory holds something else.
        CheckpointError: `about` tells something of another type than is read.
    """
    kind, name, config, weights, statistics = contents
    files = {
        WEIGHTS: save_tensors(_named(weights)),
        STATISTICS: (json.dumps({k: v.tolist() for k, v in _named(statistics).items()}, indent=1)).encode(),
    }
    digests = {name: sha256(data).hexdigest() for name, data in files.items()}
    header = {"format": FORMAT, "kind": kind, "name": name, "config": config, "sha256": digests}
    data = sealed(header | {"about": dict(about or {})})
    _header(data, Path(path))
    folder = output_folder(path)
    if (others := strangers(folder)) and not _is_checkpoint(folder):
        raise FolderTaken(f"{folder} holds {others[0]} but no checkpoint: choose another folder, or remove it")
    # The header first: it tells whose the folder is, and that files beside it are not its own yet.
    return replace_folder(folder, {HEADER: data, **files})


def sealed(header: Mapping[str, Any]) -> bytes:
    """The text of `config.json` with its own digest in it, which is that of the text without."""

    def text(own: str) -> bytes:
        return (json.dumps({**header, "sha256": {**header["sha256"], HEADER: own}}, indent=1) + "\n").encode()

    return text(sha256(text("")).hexdigest())


def _is_checkpoint(folder: Path) -> bool:
    try:
        return {"format", "kind", "sha256"} <= set(json.loads((folder / HEADER).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def read_header(path: str | os.PathLike) -> Header:
    """Read what a checkpoint of any kind tells of itself.

    Raises:
        CheckpointError: there is none, it is damaged, or another version's.
    """
    path = Path(path)
    if not (path / HEADER).is_file():
        raise NoCheckpointError(path)
    return _header(_text(path / HEADER), path)


def _header(data: bytes, path: Path) -> Header:
    try:
        table = from_json(data)
        if isinstance(table, dict) and type(given := table.get("format")) is int and given not in (FORMAT, *OLDER):
            raise CheckpointError(f"{path} has format {given}, this version reads format {FORMAT}")
        header = Header.model_validate(table)
        own = header.sha256.get(HEADER)
    except CheckpointError:
        raise
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path / HEADER} is damaged, or no checkpoint's: {_short(error)}") from None
    if own and sha256(data.replace(own.encode(), b"", 1)).hexdigest() != own:
        raise CheckpointError(f"{path / HEADER} does not match its own digest: it was damaged or edited")
    return header


def read_checkpoint(path: str | os.PathLike, make: Callable[[Contents], Any]) -> Any:
    """Read a checkpoint and make a model of its contents.

    Args:
        path: directory that `save_world_model` wrote.
        make: from the contents, weights by their paths as `Stored`; it hands them to `fill`.

    Raises:
        CheckpointError: a file is missing or damaged, the format is another version's, configuration, names, shapes
            or types don't fit together, or a number is not finite or means nothing.
    """
    path = Path(path)
    header = read_header(path)
    with _in_words(path):
        statistics = _statistics(path, header)
        weights, verify = _weights(path, header)
        made = make(Contents(header.kind, header.name, header.config, weights, statistics))
        verify()
    return made


@contextlib.contextmanager
def _in_words(path: Path) -> Iterator[None]:
    try:
        yield
    except CheckpointError as error:
        told = str(error)
        raise CheckpointError(told if told.startswith(str(path)) else f"{path}: {told}") from None
    except _WRONG as error:
        raise CheckpointError(f"{path} cannot be read: {_short(error)}") from error


def _short(error: Exception) -> str:
    said = plain(error)
    return said if len(said) <= 300 else f"{said[:300]} ..."


def _present(file: Path) -> Path:
    if not file.is_file():
        raise CheckpointError(f"{file.parent} is incomplete: {file.name} is missing")
    return file


def _text(file: Path) -> bytes:
    if (size := _present(file).stat().st_size) > _MOST_TEXT:
        raise CheckpointError(f"{file} has {size:,} bytes, a checkpoint's at most {_MOST_TEXT:,}")
    return file.read_bytes()


def _compare(file: Path, digest: str, header: Header) -> None:
    if digest != header.sha256[file.name]:
        raise CheckpointError(f"{file} does not match config.json: damaged, or from another checkpoint")


def _statistics(path: Path, header: Header) -> dict[str, np.ndarray]:
    if STATISTICS not in header.sha256:
        return {}
    data = _text(path / STATISTICS)
    _compare(path / STATISTICS, sha256(data).hexdigest(), header)
    table = from_json(data)
    if not isinstance(table, dict):
        raise CheckpointError(f"{STATISTICS} must be a table by name")
    return {name: _numbers(name, value) for name, value in table.items()}


def _numbers(name: str, value: Any) -> np.ndarray:
    cells = np.array(value, object)
    if any(type(cell) not in (int, float) for cell in cells.flat):
        raise CheckpointError(f"{name} of {STATISTICS} must hold real numbers, in lists of equal lengths")
    return cells.astype(np.float64)


@dataclass(frozen=True, eq=False)
class Stored:
    """A tensor in a file, of which only the header has been read; NumPy and JAX take it for an array and read it."""

    shape: tuple[int, ...]
    dtype: np.dtype
    load: Callable[[], np.ndarray]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.load(), dtype)


def _weights(path: Path, header: Header) -> tuple[dict[str, Stored], Callable[[], Any]]:
    """The tensors by their paths, not read yet, and what reads and compares the whole file, once."""
    file = _present(path / WEIGHTS)

    @cache
    def whole() -> dict[str, np.ndarray]:
        data = file.read_bytes()
        _compare(file, sha256(data).hexdigest(), header)
        return load_tensors(data)

    found = {}
    try:
        with safe_open(file, framework="numpy") as tensors:
            for name in tensors.keys():
                part = tensors.get_slice(name)
                if part.get_dtype() not in _TYPES:
                    raise CheckpointError(
                        f"{name} must hold real numbers, {' or '.join(_TYPES)}, got {part.get_dtype()}"
                    )
                found[name] = Stored(tuple(part.get_shape()), _TYPES[part.get_dtype()], lambda name=name: whole()[name])
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{file} is damaged: {_short(error)}") from None
    return found, whole


def check_finite(*trees: PyTree) -> None:
    """Refuse numbers that predict nothing.

    Raises:
        CheckpointError: a leaf holds one that is not real, not finite or beyond any use, naming it.
    """
    for tree in trees:
        for name, leaf in _named(tree).items():
            _check(name, leaf, -LARGEST, LARGEST)


def _check(name: str, leaf: np.ndarray, least: float, most: float) -> None:
    if not any(jnp.issubdtype(leaf.dtype, kind) for kind in (jnp.floating, jnp.integer, jnp.bool_)):
        raise CheckpointError(f"{name} must hold real numbers, got {leaf.dtype}")
    if bad := np.count_nonzero(~np.isfinite(leaf)):
        raise CheckpointError(f"{name} holds {bad} of {leaf.size} numbers that are not finite")
    if bad := np.count_nonzero((leaf < least) | (leaf > most)):
        raise CheckpointError(f"{name} holds {bad} of {leaf.size} numbers that are not between {least:g} and {most:g}")


class Within(jax.ShapeDtypeStruct):
    """Shape and type of an array whose numbers lie between two."""

    def __init__(self, shape: tuple[int, ...], dtype: Any, least: float, most: float):
        super().__init__(shape, dtype)
        self.least, self.most = least, most


def positive(shape: tuple[int, ...], dtype: Any, least: float = 1e-10) -> Within:
    """Shape and type of an array whose numbers are divided by."""
    return Within(shape, dtype, least, LARGEST)


def _paths(tree: Any, convert: Callable[[Any], Any]) -> dict[str, Any]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="."): convert(leaf) for path, leaf in leaves}


def _named(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves by their path."""
    return _paths(tree, lambda leaf: np.array(leaf, order="C"))


def fill(skeleton: Any, arrays: Mapping[str, Any]) -> Any:
    """Put arrays into a tree of shapes.

    Args:
        skeleton: of `jax.ShapeDtypeStruct`, or `Within`.
        arrays: by their paths in it; what is `Stored` is read once all names, shapes and types are known to fit.

    Raises:
        CheckpointError: if names, shapes or types differ, or a number is not finite or means nothing.
    """
    expected = _paths(skeleton, lambda leaf: leaf)
    if missing := sorted(set(expected) - set(arrays)):
        raise CheckpointError(f"{_some(missing)} missing")
    if surplus := sorted(set(arrays) - set(expected)):
        raise CheckpointError(f"{_some(surplus)} not part of this configuration")
    for name, leaf in expected.items():
        if arrays[name].shape != leaf.shape or arrays[name].dtype != leaf.dtype:
            raise CheckpointError(
                f"{name} is {arrays[name].dtype} {arrays[name].shape}, expected {leaf.dtype} {leaf.shape}"
            )
    read = []
    for name, leaf in expected.items():
        array = np.asarray(arrays[name])
        _check(name, array, getattr(leaf, "least", -LARGEST_WEIGHT), getattr(leaf, "most", LARGEST_WEIGHT))
        read.append(jnp.asarray(array))
    return jax.tree.unflatten(jax.tree.structure(skeleton), read)


def dtype_of(weights: Mapping[str, Any]) -> np.dtype:
    """The type of all weights, if they have one.

    Raises:
        CheckpointError: there are none, or they need a mode of JAX that is off.
    """
    if not weights:
        raise CheckpointError(f"{WEIGHTS} holds no weights")
    dtype = next(iter(weights.values())).dtype
    if jax.dtypes.canonicalize_dtype(dtype) != dtype:
        raise CheckpointError(f"weights of {dtype} need JAX's 64-bit mode: work inside `with jax.enable_x64(True):`")
    return dtype


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
