"""Read datasets of recorded flights, episode by episode, and refuse what is damaged."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np

from owm_envs.config import DockingConfig, load_config
from owm_envs.datasets.cache import Cache
from owm_envs.datasets.checks import check_episode, check_finite
from owm_envs.datasets.fetch import local_dataset
from owm_envs.datasets.frames import Frames
from owm_envs.datasets.layout import Layout, is_v2, read_info, read_layout
from owm_envs.datasets.metadata import (
    check_columns,
    check_metadata,
    check_statistics,
    check_tallies,
    frame_size,
    pooled,
    statistics_of,
    tallies,
)
from owm_envs.datasets.parse import read_json, read_lines, read_rows, row_count, schema_of
from owm_envs.datasets.published import PUBLISHED_COLUMNS, episode_from_published
from owm_envs.datasets.runs import Run, run_of
from owm_envs.datasets.schema import FEATURES, OBSERVATION, episode_from_columns, part_of
from owm_envs.datasets.statistics import Statistics
from owm_envs.datasets.windows import Windows
from owm_envs.episode import Episode

_OWN = ("goal_pose", "outcome", "observation.environment_state")
_CACHE_BYTES = 2**28


class Dataset(Sequence[Episode]):
    """Episodes of one split, read when they are asked for; `open_dataset` opens it.

    Of a docking dataset, ours or of the authors' published columns, `dataset[i]` is an `Episode`. `columns(i)` gives
    the arrays of any LeRobot dataset, `windows()` equally long cuts. Memory does not grow with the dataset: an episode
    is a row group of its own, and no more than `cache_bytes` of frames and rows are kept. Copies for other processes
    share no cache.

    Args:
        folder: of the split.
        cache_bytes: of decoded frames and rows to keep.

    Raises:
        FileNotFoundError, ValueError: as `open_dataset`.
    """

    def __init__(self, folder: Path, cache_bytes: int = _CACHE_BYTES):
        self.folder = folder.resolve()
        self.run: Run = run_of(self.folder)
        for path in sorted((self.folder / "meta").rglob("*.*")):
            if path.is_file() and not path.name.startswith("."):
                self.run.check(path)
        self.info: dict[str, Any] = read_info(self.folder)
        self.layout: Layout = read_layout(self.folder, self.info)
        self._rows, self._frames = Cache(cache_bytes // 4), Cache(cache_bytes)
        self._whole: set[Path] = set()
        names = self._stored(self.layout.files[0]) if len(self.layout) else list(self.info["features"])
        self.published: bool = set(PUBLISHED_COLUMNS) <= set(names)
        """Whether it has the columns of the authors' published datasets."""
        self.ours: bool = self.info.get("robot_type") == "chaser" or len({*_OWN} & {*names}) > 1
        """Whether `owm-envs generate` writes such datasets: it is then checked in full."""
        if self.ours:
            check_metadata(self.folder, self.info, self.layout, self.run)

    def __repr__(self) -> str:
        return f"Dataset({str(self.folder)!r}, episodes={len(self)})"

    def __len__(self) -> int:
        return len(self.layout)

    @overload
    def __getitem__(self, number: int) -> Episode: ...
    @overload
    def __getitem__(self, number: slice) -> list[Episode]: ...
    def __getitem__(self, number):
        """An episode, or several.

        Raises:
            IndexError: there is no such episode.
            FileNotFoundError, ValueError: a file is missing or damaged, or the dataset is of no docking.
        """
        if isinstance(number, slice):
            return [self[each] for each in range(*number.indices(len(self)))]
        number = self._number(number)
        if not (self.ours or self.published):
            needed = ", ".join(name for name in _OWN if name not in self.info["features"])
            raise ValueError(f"{self.folder} holds no docking episodes: it lacks the columns {needed}; use columns()")
        columns = self.columns(number)
        if self.published:
            try:
                with np.errstate(over="ignore"):
                    return episode_from_published(columns)
            except (ValueError, IndexError) as error:
                path = self.layout.span(number).path
                raise ValueError(f"{path}: episode {number} is none of those that were published: {error}") from None
        videos = {OBSERVATION + part_of(key): columns.pop(key) for key in self.layout.videos}
        return episode_from_columns(columns | videos)

    @property
    def fps(self) -> float | None:
        """Rows a second; None where the dataset does not say."""
        return self.info.get("fps")

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """What its columns and videos are, as `info.json` tells."""
        return self.info["features"]

    @property
    def statistics(self) -> Statistics:
        """What to normalise by: of ours, those of the train split.

        Raises:
            FileNotFoundError, ValueError: there are none, or they are damaged.
        """
        meta = self.folder / "meta"
        if is_v2(self.info) and not (meta / "stats.json").is_file():
            path = meta / "episodes_stats.jsonl"
            told = [statistics_of(path, line.get("stats")) for line in read_lines(path)]
            if not told:
                raise ValueError(f"{path} holds no statistics")
            return pooled(told)
        path = meta / "stats.json"
        found = statistics_of(path, read_json(path, "a table of statistics"))
        if self.ours:
            check_statistics(path, found, self.features)
        return found

    @property
    def lengths(self) -> np.ndarray:
        """Rows of each episode: of ours, one more than its decisions."""
        return self.layout.rows

    def columns(self, number: int) -> dict[str, Any]:
        """The columns of an episode, arrays (rows, ...) by name, and its videos as `Frames`.

        Raises:
            IndexError: there is no such episode.
            FileNotFoundError, ValueError: a file is missing, damaged, or holds what it cannot.
        """
        number = self._number(number)
        if (kept := self._rows.get(number)) is not None:
            return dict(kept)
        span = self.layout.span(number)
        names = self._stored(span.path)
        if self.ours:
            check_columns(span.path, self.features)
        columns: dict[str, Any] = read_rows(span.path, names, span.first, span.first + span.rows)
        for name, values in columns.items():
            shape = tuple(self.features.get(name, {}).get("shape") or ())
            # A single number stays one, but for a part of the observation of our own.
            kept = len(shape) > 1 or (self.ours and name not in FEATURES)
            if kept and values.dtype != object and values[0].size == np.prod(shape):
                columns[name] = values.reshape(len(values), *shape)
        if self.ours:
            check_episode(columns, span, float(self.info["fps"]), self.run.config)
        elif self.published:
            check_finite(columns, span, PUBLISHED_COLUMNS)
        for key, clip in span.clips.items():
            if not self.ours and 3 not in self.features[key]["shape"]:
                continue  # a map of depths: no colours
            self.run.check(clip.path, content=False)
            columns[key] = Frames(clip, frame_size(key, self.features[key]), self._frames)
        self._rows.put(number, columns, sum(values.nbytes for values in columns.values() if hasattr(values, "nbytes")))
        return dict(columns)

    def episodes(self) -> list[Episode]:
        """Every episode, and together what the run tells of them.

        Raises:
            FileNotFoundError, ValueError: as for each; or policies, ports or outcomes are not those of the run.
        """
        episodes = list(self)
        if self.ours:
            check_tallies(self.folder, self.run, tallies(episodes))
        return episodes

    def windows(self, context: int = 8, rollout: int = 16, stride: int = 5) -> Windows:
        """Every cut of `context + rollout` views, `stride` rows apart, that fits into an episode.

        Args:
            context: views that a model is given.
            rollout: views that it is to predict.
            stride: rows from a view to the next; the action between them is the mean of theirs.
        """
        return Windows(self, context, rollout, stride)

    def _number(self, number: int) -> int:
        count = len(self)
        if not -count <= number < count:
            raise IndexError(f"{self.folder} has the episodes 0 to {count - 1}, got {number}")
        return int(number) % count

    def _stored(self, path: Path) -> list[str]:
        """The columns of a file, once it is known to be as it was written."""
        if path not in self._whole:
            self.run.check(path)
            if (rows := row_count(path)) != (told := self.layout.rows_of(path)):
                raise ValueError(f"{path} holds {rows} rows, meta/episodes tells of {told}: incomplete, or changed")
            self._whole.add(path)
        return schema_of(path).names


def open_dataset(source: str | os.PathLike, split: str | None = None, *, cache_bytes: int = _CACHE_BYTES) -> Dataset:
    """Open a LeRobot dataset, version 2.1 or 3: ours, the authors', or any other; nothing but metadata is read yet.

    `owm_envs.datasets.open` is this function.

    Args:
        source: folder of the dataset, or of its splits; or the name of one on the hub, as `local_dataset` takes it.
        split: name of the split's folder; None if there is but one.
        cache_bytes: of decoded frames and rows to keep.

    Raises:
        FileNotFoundError: there is no such folder, split or file.
        ValueError: it is no such dataset, or damaged: in a line that names file, field and row, what is allowed, and
            what came. Files are compared with the run's `manifest.json` where there is one, each when first read.
    """
    return Dataset(dataset_folder(source, split), cache_bytes)


def read(path: str | os.PathLike, split: str | None = None) -> list[Episode]:
    """Read every episode of one split, in order: vectors bit for bit as they were written.

    Args:
        path, split: as `open_dataset` takes them.

    Raises:
        FileNotFoundError, ValueError: as `open_dataset`; or it holds no docking episodes.
    """
    return open_dataset(path, split).episodes()


def episodes(path: str | os.PathLike, split: str | None = None) -> Iterator[Episode]:
    """The same one by one: no more than one is held at a time; raises as `read`, while it is read."""
    return iter(open_dataset(path, split))


def read_episode(path: str | os.PathLike, split: str | None = None, number: int = 0) -> Episode:
    """Read one episode.

    Args:
        path, split: as `open_dataset` takes them.
        number: of the episode, from 0.

    Raises:
        FileNotFoundError, ValueError: as `read`, or there is no episode of that number.
    """
    dataset = open_dataset(path, split)
    if not 0 <= number < len(dataset):
        raise ValueError(f"episode must be from 0 to {len(dataset) - 1} in {dataset.folder}, got {number}")
    return dataset[number]


def dataset_folder(path: str | os.PathLike, split: str | None = None) -> Path:
    """The folder of the LeRobot dataset meant by `path` and `split`.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no LeRobot dataset, or holds several and none was named.
    """
    root = local_dataset(path)
    if not root.is_dir():
        partial = root.with_name(root.name + ".partial")
        hint = f"; {partial} holds an unfinished one" if partial.is_dir() else ""
        raise FileNotFoundError(f"no dataset at {root}{hint}")
    splits = sorted(child.name for child in root.iterdir() if (child / "meta" / "info.json").is_file())
    if split is not None:
        if split not in splits:
            raise FileNotFoundError(f"{root} has no split {split!r}; it has {', '.join(splits) or 'none'}")
        return root / split
    if (root / "meta" / "info.json").is_file():
        return root
    if len(splits) == 1:
        return root / splits[0]
    if splits:
        raise ValueError(f"{root} holds the splits {', '.join(splits)}: name one")
    raise ValueError(f"{root} is not a LeRobot dataset: it has no meta/info.json")


def read_config(folder: Path) -> DockingConfig:
    """The configuration of the environment that a dataset was recorded in; the default one if none lies with it.

    Args:
        folder: of the dataset, or of a split of it.
    """
    kept = [file for file in (folder / "config.toml", folder.parent / "config.toml") if file.is_file()]
    return load_config(kept[0]) if kept else load_config()


def read_statistics(path: str | os.PathLike, split: str | None = "train") -> Statistics:
    """The statistics to normalise by: those of the train split, whichever split is asked.

    Raises:
        FileNotFoundError, ValueError: as `open_dataset`.
    """
    return open_dataset(path, split).statistics
