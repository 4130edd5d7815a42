"""Write one split as a LeRobot v3 dataset: a data file and an episode file for each batch, metadata at the end."""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from owm_envs.config import DockingConfig
from owm_envs.datasets.schema import CODEBASE_VERSION, FEATURES, columns_from_episode, features_of
from owm_envs.datasets.statistics import Statistics, aggregate, episode_statistics
from owm_envs.episode import Episode
from owm_envs.files import remove, write_atomically
from owm_envs.station.ports import PORT_NAMES

FILES_PER_CHUNK = 1000
FILE_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
TASKS = [f"Dock at {name.replace('_', ' ')}." for name in PORT_NAMES]
"""A task's index is its port's."""


class SplitWriter:
    """Append batches of whole episodes to a split; each batch is on disk completely or not at all.

    Opening a folder that holds batches already goes on after them.

    Args:
        folder: of the split; made if absent.
        fps: decisions a second.
        parts: what episodes observe beside the state part, each of a `shape` and `dtype`, by their names.
    """

    def __init__(self, folder: Path, fps: float, parts: Mapping[str, Any] | None = None):
        self.folder = Path(folder)
        self.fps = int(fps) if float(fps).is_integer() else float(fps)
        self._features = features_of(parts or {})
        self.batches = 0
        self.episodes = 0
        self.frames = 0
        self._statistics: list[Statistics] = []
        while self._path("meta/episodes", self.batches).is_file():
            self._resume(pq.read_table(self._path("meta/episodes", self.batches)))

    @property
    def transitions(self) -> int:
        """Transitions written: every episode's last frame starts none."""
        return self.frames - self.episodes

    def write(self, episodes: Iterable[Episode]) -> None:
        """Append a batch of whole episodes, one row group each: only one of them is held at a time."""
        rows: list[dict[str, Any]] = []
        statistics: list[Statistics] = []

        def tables() -> Iterator[pa.Table]:
            for episode in episodes:
                columns, row = self._laid_out(episode, rows)
                rows.append(row)
                statistics.append(episode_statistics(columns))
                rows[-1] |= {
                    f"stats/{name}/{key}": value.tolist()
                    for name, part in statistics[-1].items()
                    for key, value in part.items()
                }
                yield pa.table({name: _arrow(values) for name, values in columns.items()})

        _write_parquet(tables(), self._path("data", self.batches))
        # The episodes file is the batch's seal: without it the data file is written again.
        _write_parquet([pa.Table.from_pylist(rows)], self._path("meta/episodes", self.batches))
        self.batches += 1
        self.episodes += len(rows)
        self.frames = rows[-1]["dataset_to_index"]
        self._statistics += statistics

    def _laid_out(self, episode: Episode, before: list[dict[str, Any]]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """An episode's columns, and its row in the episodes file; `before` are the rows of its batch so far."""
        chunk, file = divmod(self.batches, FILES_PER_CHUNK)
        number = self.episodes + len(before)
        index = before[-1]["dataset_to_index"] if before else self.frames
        length = len(episode) + 1
        row = {
            "episode_index": number,
            "tasks": [TASKS[episode.port]],
            "length": length,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": index,
            "dataset_to_index": index + length,
            "meta/episodes/chunk_index": chunk,
            "meta/episodes/file_index": file,
        }
        return columns_from_episode(episode, episode_index=number, first_index=index, fps=self.fps), row

    def statistics(self) -> Statistics:
        """Of everything written so far."""
        return aggregate(self._statistics)

    def finish(self, statistics: Statistics, about: Mapping[str, Any] | None = None) -> None:
        """Write the metadata that makes the folder a dataset.

        Args:
            statistics: to normalise by.
            about: what else info.json is to tell.
        """
        meta = self.folder / "meta"
        _write_parquet([_task_table()], meta / "tasks.parquet")
        write_json(
            {name: {key: value.tolist() for key, value in part.items()} for name, part in statistics.items()},
            meta / "stats.json",
        )
        features = {
            name: {"dtype": feature.dtype, "shape": list(feature.shape), "names": feature.names}
            for name, feature in self._features.items()
        }
        write_json(
            {
                "codebase_version": CODEBASE_VERSION,
                "robot_type": "chaser",
                "total_episodes": self.episodes,
                "total_frames": self.frames,
                "total_tasks": len(TASKS),
                "chunks_size": FILES_PER_CHUNK,
                "data_files_size_in_mb": 100,
                "video_files_size_in_mb": 200,
                "fps": self.fps,
                # LeRobot calls whatever one folder holds "train".
                "splits": {"train": f"0:{self.episodes}"},
                "data_path": f"data/{FILE_PATTERN}",
                "video_path": None,
                "features": features,
                **(about or {}),
            },
            meta / "info.json",
        )

    def _path(self, kind: str, batch: int) -> Path:
        chunk, file = divmod(batch, FILES_PER_CHUNK)
        return self.folder / kind / FILE_PATTERN.format(chunk_index=chunk, file_index=file)

    def _resume(self, rows: pa.Table) -> None:
        for row in rows.to_pylist():
            part: Statistics = {}
            for column, value in row.items():
                if column.startswith("stats/"):
                    _, name, key = column.split("/")
                    part.setdefault(name, {})[key] = np.asarray(value)
            self._statistics.append(part)
        self.batches += 1
        self.episodes += rows.num_rows
        self.frames = rows["dataset_to_index"][-1].as_py()


@contextmanager
def recording(folder: Path, config: DockingConfig, policy: str | None = None) -> Iterator[SplitWriter]:
    """Write flights that are at hand as a dataset of one split, in place of one that is there.

    Each `write` appends episodes; once left, with at least one in it, the folder is a dataset.

    Args:
        folder: to make; whatever lies there goes.
        config: of the environment that they were flown in.
        policy: who flew, if it is none of `POLICY_NAMES`; kept in the folder's info.json.
    """
    remove(folder)
    writer = SplitWriter(folder, 1 / config.decision_dt)
    yield writer
    write_atomically(folder / "config.toml", lambda file: file.write(config.to_toml()), text=True)
    writer.finish(writer.statistics(), {} if policy is None else {"policy": policy})


def write_json(value: dict, path: Path) -> None:
    """Write a JSON file in one step: complete or not at all."""
    write_atomically(path, lambda file: file.write(json.dumps(value, indent=2) + "\n"), text=True)


def _write_parquet(tables: Iterable[pa.Table], path: Path) -> None:
    """Write tables of one schema as the row groups of a file; at least one."""

    def write(file: BinaryIO) -> None:
        with ExitStack() as stack:
            writer = None
            for table in tables:
                if writer is None:
                    # Measured numbers do not repeat: dictionaries would only cost time.
                    repeating = [n for n, f in FEATURES.items() if f.shape == (1,) and n in table.column_names]
                    options = {"compression": "zstd", "compression_level": 1, "use_dictionary": repeating}
                    writer = stack.enter_context(pq.ParquetWriter(file, table.schema, **options))
                writer.write_table(table)

    write_atomically(path, write)


def _arrow(values: np.ndarray) -> pa.Array:
    if values.ndim == 1 or values.shape[1:] == (1,):
        return pa.array(values.reshape(-1))
    array = pa.array(np.ascontiguousarray(values).ravel())
    for size in reversed(values.shape[1:]):
        array = pa.FixedSizeListArray.from_arrays(array, size)
    return array


def _task_table() -> pa.Table:
    # The task text must come back as the index of the pandas frame that LeRobot reads this into.
    table = pa.table({"task_index": pa.array(range(len(TASKS)), pa.int64()), "__index_level_0__": TASKS})
    columns = [("task_index", "task_index", "int64"), (None, "__index_level_0__", "unicode")]
    pandas = {
        "index_columns": ["__index_level_0__"],
        "column_indexes": [
            {
                "name": None,
                "field_name": None,
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": {"encoding": "UTF-8"},
            }
        ],
        "columns": [
            {
                "name": name,
                "field_name": field,
                "pandas_type": kind,
                "numpy_type": "int64" if kind == "int64" else "object",
                "metadata": None,
            }
            for name, field, kind in columns
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
