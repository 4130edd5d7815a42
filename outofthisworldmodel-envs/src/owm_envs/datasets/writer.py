"""Make a LeRobot v3 dataset of recorded episodes: a pure function of them, whoever recorded them, and when."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from owm_envs.config import DockingConfig
from owm_envs.datasets.pieces import Piece, Pieces, arrow, from_arrow
from owm_envs.datasets.schema import CODEBASE_VERSION, FEATURES, Feature, features_of, part_of
from owm_envs.datasets.statistics import (
    WIDEST,
    Statistics,
    counted_rows,
    episode_statistics,
    exact_quantiles,
    pixel_statistics,
    united,
)
from owm_envs.episode import Episode
from owm_envs.files import remove, write_atomically
from owm_envs.station.ports import PORT_NAMES
from owm_envs.video import CODEC, join_videos, pixel_format

FILES_PER_CHUNK = 1000
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_PATH = f"data/{_FILE}.parquet"
VIDEO_PATH = f"videos/{{video_key}}/{_FILE}.mp4"
EPISODES_PATH = f"meta/episodes/{_FILE}.parquet"
DATA_MB, VIDEO_MB = 100, 200
"""Most that the episodes of a file hold [MB], unless a single one has more."""
_AT_ONCE = 16
"""Episodes whose rows of their table are Python's objects at a time: as such they take ten times the room."""
TASKS = [f"Dock at {name.replace('_', ' ')}." for name in PORT_NAMES]
"""A task's index is its port's."""


class Written(NamedTuple):
    """What a split came to."""

    episodes: int
    frames: int
    statistics: Statistics
    """Of the whole split."""

    @property
    def transitions(self) -> int:
        """Every episode's last frame starts none."""
        return self.frames - self.episodes


def write_split(
    folder: Path,
    pieces: Pieces,
    numbers: Iterable[int],
    fps: float,
    parts: Mapping[str, Any],
    told: Callable[[int], None] = lambda done: None,
) -> Written:
    """Write the data, the videos and the table of episodes of a split; `write_meta` makes a dataset of it.

    Args:
        folder: of the split; made if absent.
        numbers: of the episodes that belong to it, ascending.
        fps: decisions a second.
        parts: what episodes observe beside the state part, each of a `shape` and `dtype`, by their names.
        told: how many episodes are done.
    """
    features = features_of(parts)
    split = _Split(fps, {part_of(key): key for key, feature in features.items() if feature.is_video})
    for file, group in enumerate(_files(pieces, numbers)):
        place = dict(zip(("chunk_index", "file_index"), divmod(file, FILES_PER_CHUNK)))
        split.begin(place)

        def tables(group: Sequence[int] = group) -> Iterator[pa.Table]:
            for number in group:
                yield split.table(pieces.get(number))
                told(split.episodes)

        write_parquet(tables(), folder / DATA_PATH.format(**place))
        for part, key in split.videos.items():
            films = [pieces.film(number, part) for number in group]
            path = folder / VIDEO_PATH.format(video_key=key, **place)
            write_atomically(path, lambda out, films=films: join_videos(films, out, fps))
        write_parquet([split.about()], folder / EPISODES_PATH.format(**place))
    statistics = split.statistics
    statistics |= {name: statistics[name] | quantiles for name, quantiles in _exact_quantiles(folder, statistics)}
    statistics |= {key: pixel_statistics(counts, split.frames) for key, counts in split.histograms.items()}
    return Written(split.episodes, split.frames, statistics)


class _Split:
    """How far a split is, and what the table of episodes says of those in the file that is being written."""

    def __init__(self, fps: float, videos: dict[str, str]):
        self.fps, self.videos = fps, videos
        self.episodes = self.frames = self.shown = 0
        self.statistics: Statistics = {}
        self.histograms: dict[str, np.ndarray] = {}

    def begin(self, place: Mapping[str, int]) -> None:
        """Go on with another file."""
        self.place, self.shown = place, 0
        self._rows: list[dict[str, Any]] = []
        self._tables: list[pa.Table] = []

    def table(self, piece: Piece) -> pa.Table:
        """Append an episode; give its rows of data."""
        length = len(piece.columns["index"])
        columns = piece.columns | {
            "episode_index": piece.columns["episode_index"] + self.episodes,
            "index": piece.columns["index"] + self.frames,
        }
        statistics = episode_statistics(columns)
        self.statistics = united(self.statistics, statistics)
        for part, key in self.videos.items():
            counts = piece.histograms[part]
            self.histograms[key] = self.histograms.get(key, 0) + counts
            statistics[key] = pixel_statistics(counts, length)
        self._rows.append(self._row(piece, length, statistics))
        if len(self._rows) == _AT_ONCE:
            self._put_rows()
        self.episodes, self.frames, self.shown = self.episodes + 1, self.frames + length, self.shown + length
        return pa.table({name: arrow(values) for name, values in columns.items()})

    def about(self) -> pa.Table:
        """The table of the file's episodes."""
        self._put_rows()
        return pa.concat_tables(self._tables).combine_chunks()

    def _put_rows(self) -> None:
        if self._rows:
            self._tables.append(pa.Table.from_pylist(self._rows))
        self._rows = []

    def _row(self, piece: Piece, length: int, statistics: Statistics) -> dict[str, Any]:
        """What the table of episodes says of one."""
        row: dict[str, Any] = {"episode_index": self.episodes, "tasks": [TASKS[piece.port]], "length": length}
        row |= {f"data/{key}": value for key, value in self.place.items()}
        row |= {"dataset_from_index": self.frames, "dataset_to_index": self.frames + length}
        row |= {f"meta/episodes/{key}": value for key, value in self.place.items()}
        seconds = {"from_timestamp": self.shown / self.fps, "to_timestamp": (self.shown + length) / self.fps}
        for video in self.videos.values():
            row |= {f"videos/{video}/{key}": value for key, value in {**self.place, **seconds}.items()}
        for name, part in statistics.items():
            row |= {f"stats/{name}/{key}": value.tolist() for key, value in part.items()}
        return row


def _files(pieces: Pieces, numbers: Iterable[int]) -> Iterator[list[int]]:
    """Numbers of the episodes of each file."""
    group: list[int] = []
    data = video = 0
    for number in numbers:
        own_data, own_video = pieces.sizes(number)
        if group and (data + own_data > DATA_MB * 1e6 or video + own_video > VIDEO_MB * 1e6):
            yield group
            group, data, video = [], 0, 0
        group.append(number)
        data, video = data + own_data, video + own_video
    if group:
        yield group


def _exact_quantiles(folder: Path, statistics: Statistics) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """The quantiles of a split's columns, found among its rows."""
    paths = sorted((folder / "data").glob("chunk-*/file-*.parquet"))

    def rows(name: str) -> Iterator[np.ndarray]:
        for path in paths:
            file = pq.ParquetFile(path)
            for group in range(file.num_row_groups):
                yield counted_rows(name, from_arrow(file.read_row_group(group, columns=[name])[name]))

    for name, part in statistics.items():
        if part["mean"].size <= WIDEST:
            yield name, exact_quantiles(partial(rows, name))


def write_meta(
    folder: Path,
    written: Written,
    statistics: Statistics,
    fps: float,
    parts: Mapping[str, Any],
    about: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write what makes the folder of a split a dataset.

    Args:
        folder, fps, parts: as `write_split` takes them.
        written: what it gave.
        statistics: to normalise by.
        about: what else info.json is to tell.
    """
    meta = folder / "meta"
    write_parquet([_task_table()], meta / "tasks.parquet")
    write_json(
        {name: {key: value.tolist() for key, value in part.items()} for name, part in statistics.items()},
        meta / "stats.json",
    )
    features = features_of(parts)
    whole = int(fps) if float(fps).is_integer() else float(fps)
    write_json(
        {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": "chaser",
            "total_episodes": written.episodes,
            "total_frames": written.frames,
            "total_tasks": len(TASKS),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": whole,
            # LeRobot calls whatever one folder holds "train".
            "splits": {"train": f"0:{written.episodes}"},
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if any(feature.is_video for feature in features.values()) else None,
            "features": {name: _described(feature, whole) for name, feature in features.items()},
            **about,
        },
        meta / "info.json",
    )


def _described(feature: Feature, fps: float) -> dict[str, Any]:
    described: dict[str, Any] = {"dtype": feature.dtype, "shape": list(feature.shape), "names": feature.names}
    if feature.is_video:
        height, width, channels = feature.shape
        described["info"] = {
            "video.height": height,
            "video.width": width,
            "video.codec": CODEC,
            "video.pix_fmt": pixel_format(height, width),
            "video.is_depth_map": False,
            "video.fps": fps,
            "video.channels": channels,
            "has_audio": False,
        }
    return described


class Recorder:
    """Takes flights that are at hand, one after another, for a dataset of them."""

    def __init__(self, pieces: Pieces, fps: float):
        self._pieces, self._fps, self.episodes = pieces, fps, 0

    def write(self, episodes: Iterable[Episode]) -> None:
        """Append whole episodes."""
        for episode in episodes:
            self._pieces.put(self.episodes, episode, self._fps)
            self.episodes += 1


@contextmanager
def recording(folder: Path, config: DockingConfig, policy: str | None = None) -> Iterator[Recorder]:
    """Write flights that are at hand as a dataset of one split, in place of one that is there; of relative navigation.

    Once left, with at least one episode in it, the folder is a dataset.

    Args:
        folder: to make; whatever lies there goes.
        config: of the environment that they were flown in.
        policy: who flew, if it is none of `POLICY_NAMES`; kept in the folder's info.json.
    """
    remove(folder)
    parts = {"state_valid": np.zeros(1, bool)} if config.navigation.quiet else {}
    fps, pieces = 1 / config.decision_dt, Pieces(folder / "pieces")
    recorder = Recorder(pieces, fps)
    yield recorder
    write_atomically(folder / "config.toml", lambda file: file.write(config.to_toml()), text=True)
    split = write_split(folder, pieces, range(recorder.episodes), fps, parts)
    write_meta(folder, split, split.statistics, fps, parts, {} if policy is None else {"policy": policy})
    remove(pieces.folder)


def write_json(value: dict, path: Path) -> None:
    """Write a JSON file in one step: complete or not at all."""
    write_atomically(path, lambda file: file.write(json.dumps(value, indent=2) + "\n"), text=True)


def write_parquet(tables: Iterable[pa.Table], path: Path) -> None:
    """Write tables of one schema as the row groups of a file; at least one."""

    def write(file: BinaryIO) -> None:
        with ExitStack() as stack:
            writer = None
            for table in tables:
                if writer is None:
                    # Measured numbers do not repeat: dictionaries would only cost time.
                    repeating = [n for n, f in FEATURES.items() if f.shape == (1,) and n in table.column_names]
                    options = {"compression": "zstd", "compression_level": 1, "use_dictionary": repeating}
                    options["write_page_checksum"] = True
                    writer = stack.enter_context(pq.ParquetWriter(file, table.schema, **options))
                writer.write_table(table)

    write_atomically(path, write)


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
