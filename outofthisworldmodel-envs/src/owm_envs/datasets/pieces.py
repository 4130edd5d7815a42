"""Recorded episodes before they are a dataset: each is whole on disk, or not there."""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Int, UInt8

from owm_envs.datasets.schema import columns_from_episode
from owm_envs.episode import Episode
from owm_envs.files import fingerprint, settle, write_atomically
from owm_envs.video import VideoWriter


class Film:
    """Frames of an episode that is being flown: each is encoded when it comes, none is kept.

    Args:
        path: of the file to write.
        fps: frames a second.
    """

    def __init__(self, path: Path, fps: float):
        self.path = path
        self.histogram: Int[np.ndarray, "3 256"] = np.zeros((3, 256), np.int64)
        self._writer = VideoWriter(path, fps)

    @property
    def frames(self) -> int:
        """How many have come."""
        return self._writer.frames

    def write(self, images: UInt8[np.ndarray, "T H W 3"]) -> None:
        """Append frames."""
        for image in images:
            self._writer.write(image)
        for channel, counts in enumerate(self.histogram):
            counts += np.bincount(images[..., channel].ravel(), minlength=256)

    def close(self) -> "Film":
        """End the file."""
        self._writer.close()
        return self


class Piece(NamedTuple):
    """One episode as it was put away."""

    columns: dict[str, np.ndarray]
    """As `columns_from_episode` lays it out, as if it were the first of a dataset."""
    port: int
    histograms: dict[str, Int[np.ndarray, "3 256"]]
    """Of each film, by the part of the observation: how often each value came."""


class Pieces:
    """A folder of recorded episodes by their numbers in a split; one that was damaged is not in it."""

    def __init__(self, folder: Path):
        self.folder = folder

    def __contains__(self, number: int) -> bool:
        if not self._path(number).is_file():
            return False
        try:
            _, about = self._read(number)
            return {part: fingerprint(self.film(number, part)) for part in about["films"]} == about["digests"]
        except (OSError, ValueError, KeyError, TypeError, AttributeError, pa.ArrowException):
            return False

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(int(path.stem) for path in self.folder.glob("*.arrow")))

    def put(self, number: int, episode: Episode, fps: float) -> None:
        """Put an episode away; films of its observation are moved here."""
        films = {part: film for part, film in episode.observation.items() if isinstance(film, Film)}
        columns = columns_from_episode(episode, episode_index=0, first_index=0, fps=fps)
        about: dict[str, Any] = {
            "port": episode.port,
            "shapes": {name: values.shape[1:] for name, values in columns.items()},
            "films": {part: film.histogram.tolist() for part, film in films.items()},
            "digests": {part: fingerprint(film.path) for part, film in films.items()},
        }
        about["sha256"] = _digest(about, columns)
        self.folder.mkdir(parents=True, exist_ok=True)
        for part, film in films.items():
            settle(film.path)
            os.replace(film.path, self.film(number, part))
        table = pa.table({name: arrow(values) for name, values in columns.items()})
        table = table.replace_schema_metadata({"piece": json.dumps(about)})

        def write(file: Any) -> None:
            with pa.ipc.new_file(file, table.schema) as writer:
                writer.write_table(table)

        write_atomically(self._path(number), write)  # the seal: films without it are written again

    def get(self, number: int) -> Piece:
        """Give an episode back.

        Raises:
            OSError, ValueError: it is missing, or was damaged.
        """
        columns, about = self._read(number)
        return Piece(columns, about["port"], {part: np.array(counts) for part, counts in about["films"].items()})

    def _read(self, number: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        with pa.OSFile(os.fspath(self._path(number))) as file:
            table = pa.ipc.open_file(file).read_all()
        about = json.loads(table.schema.metadata[b"piece"])
        columns = {name: from_arrow(table[name]).reshape(-1, *shape) for name, shape in about["shapes"].items()}
        if about.pop("sha256") != _digest(about, columns):
            raise ValueError(f"{self._path(number)} is not what was written: damaged")
        return columns, about

    def film(self, number: int, part: str) -> Path:
        """Where the film of a part of an episode is."""
        return self.folder / f"{number:06d}.{part}.mp4"

    def sizes(self, number: int) -> tuple[int, int]:
        """Bytes of an episode's rows, and of its films."""
        films = sum(path.stat().st_size for path in self.folder.glob(f"{number:06d}.*.mp4"))
        return self._path(number).stat().st_size, films

    def decisions(self, number: int) -> int:
        """How many decisions an episode has."""
        with pa.memory_map(os.fspath(self._path(number))) as file:
            reader = pa.ipc.open_file(file)
            return sum(reader.get_batch(i).num_rows for i in range(reader.num_record_batches)) - 1

    @property
    def bytes(self) -> int:
        """Of all of them on disk."""
        return sum(path.stat().st_size for path in self.folder.glob("*.*") if path.suffix in (".arrow", ".mp4"))

    def take(self, other: "Pieces") -> int:
        """Link or copy all episodes of another folder that are missing here; say how many."""
        taken = 0
        self.folder.mkdir(parents=True, exist_ok=True)
        for number in other:
            if self._path(number).is_file():
                continue
            for source in [*sorted(other.folder.glob(f"{number:06d}.*.mp4")), other._path(number)]:
                target = self.folder / source.name
                target.unlink(missing_ok=True)
                try:
                    os.link(source, target)
                except OSError:  # another disk, or one without links
                    write_atomically(target, lambda file, source=source: shutil.copyfileobj(open(source, "rb"), file))
            taken += 1
        return taken

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:06d}.arrow"


def _digest(about: dict[str, Any], columns: dict[str, np.ndarray]) -> str:
    sha = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name, values in columns.items():
        sha.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return sha.hexdigest()


def arrow(values: np.ndarray) -> pa.Array:
    """A column of rows of any shape."""
    if values.ndim == 1 or values.shape[1:] == (1,):
        return pa.array(values.reshape(-1))
    array = pa.array(np.ascontiguousarray(values).ravel())
    for size in reversed(values.shape[1:]):
        array = pa.FixedSizeListArray.from_arrays(array, size)
    return array


def from_arrow(column: pa.ChunkedArray) -> np.ndarray:
    """A column as an array (rows,), or (rows, numbers) of nested lists."""
    array = column.combine_chunks()
    rows, nested = len(array), pa.types.is_nested(array.type)
    while pa.types.is_nested(array.type):
        array = array.flatten()
    values = array.to_numpy(zero_copy_only=False)
    return values.reshape(rows, -1) if nested else values
