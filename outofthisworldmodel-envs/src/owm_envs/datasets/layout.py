"""Where the episodes of a LeRobot dataset lie in its files, in versions 2.1 and 3."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from owm_envs.datasets.frames import Clip
from owm_envs.datasets.parse import read_json, read_lines, read_rows, row_count, schema_of
from owm_envs.files import inner_path
from owm_envs.words import is_number, short

_OWN = re.compile(r"\{(\w+)(?::0?(\d{1,2})d)?\}")


class Span(NamedTuple):
    """Where one episode lies."""

    number: int
    path: Path
    first: int
    """Its first row in the file."""
    rows: int
    index: int
    """Rows of the dataset before it."""
    tasks: tuple[str, ...]
    clips: dict[str, Clip]
    """Of the videos, by their features."""


class Layout(NamedTuple):
    """The files of a dataset, and which rows of which belong to each episode; arrays have one number an episode."""

    folder: Path
    info: dict[str, Any]
    files: tuple[Path, ...]
    """Parquet files with rows."""
    file: np.ndarray
    """Index into `files`."""
    first: np.ndarray
    """Row of the file."""
    rows: np.ndarray
    before: np.ndarray
    """Rows of the dataset before it."""
    tasks: tuple[tuple[str, ...], ...]
    videos: dict[str, tuple[Sequence[Path], np.ndarray, np.ndarray]]
    """By feature: its files, which of them, and the second at which the episode begins in it."""

    def __len__(self) -> int:
        return len(self.rows)

    def span(self, number: int) -> Span:
        """Where an episode lies."""
        rows = int(self.rows[number])
        clips = {
            key: Clip(paths[which[number]], float(start[number]), rows, float(self.info["fps"]))
            for key, (paths, which, start) in self.videos.items()
        }
        return Span(
            number,
            self.files[self.file[number]],
            int(self.first[number]),
            rows,
            int(self.before[number]),
            self.tasks[number] if self.tasks else (),
            clips,
        )

    def rows_of(self, path: Path) -> int:
        """Rows that a file is to have."""
        return int(self.rows[self.file == self.files.index(path)].sum())


def read_info(folder: Path) -> dict[str, Any]:
    """A dataset's `meta/info.json`, its version, rate, counts and features as they should be.

    Raises:
        ValueError: it cannot be read, or the dataset is of another version than 2.1 and 3.
    """
    path = folder / "meta" / "info.json"
    info = read_json(path, "the info.json of a LeRobot dataset")
    version = info.get("codebase_version")
    if not (isinstance(version, str) and re.fullmatch(r"v?(3(\.\d+)*|2\.1)", version)):
        raise ValueError(f"{folder} is a LeRobot dataset of version {version!r}; this reads v2.1 and v3")
    if (storage := info.get("storage_format", "parquet")) != "parquet":
        raise ValueError(f"{folder} is stored as {storage!r}; this reads Parquet and MP4 files")
    if "fps" in info and not (is_number(info["fps"]) and 0 < info["fps"] < 1e6):
        raise ValueError(f"{path}: fps must be a number above 0, got {info['fps']!r}")
    for name in ("total_episodes", "total_frames"):
        if name in info and not (type(info[name]) is int and info[name] >= 0):
            raise ValueError(f"{path}: {name} must be a count, got {short(info[name])}")
    features = info.setdefault("features", {})
    if not isinstance(features, dict):
        raise ValueError(f"{path}: features must be a table by name, got a {type(features).__name__}")
    for name, feature in features.items():
        shape = feature.get("shape") if isinstance(feature, dict) else None
        sound = isinstance(shape, list) and all(type(n) is int and 0 <= n < 1 << 31 for n in shape)
        if not (sound and isinstance(feature.get("dtype"), str)):
            raise ValueError(f"{path}: feature {name} must have a dtype and a shape, got {short(feature)}")
    return info


def is_v2(info: dict[str, Any]) -> bool:
    """Whether a dataset has a file an episode, as version 2.1 does."""
    return info["codebase_version"].lstrip("v").startswith("2")


def read_layout(folder: Path, info: dict[str, Any]) -> Layout:
    """Find the episodes of a dataset.

    Raises:
        FileNotFoundError: there are no data files, or one is missing.
        ValueError: metadata are damaged, or do not fit together.
    """
    layout = _version_2(folder, info) if is_v2(info) else _version_3(folder, info)
    path = folder / "meta" / "info.json"
    for name, found, told in [
        ("episodes", len(layout), info.get("total_episodes")),
        ("frames", int(layout.rows.sum()), info.get("total_frames")),
    ]:
        if told is not None and found != told:
            raise ValueError(f"{folder} is incomplete: it holds {found} {name}, its info.json tells of {short(told)}")
    for file in layout.files:
        if not file.is_file():
            raise FileNotFoundError(f"{file} is missing: {folder} is incomplete")
    if layout.videos and not info.get("fps"):
        raise ValueError(f"{path}: fps must be told where there are videos")
    for paths, *_ in layout.videos.values():
        for file in paths:
            if not file.is_file():
                raise FileNotFoundError(f"{file} is missing: {folder} is incomplete")
    return layout


def video_features(info: dict[str, Any]) -> list[str]:
    """Names of the features that are videos."""
    return [name for name, feature in info["features"].items() if feature["dtype"] == "video"]


def _version_3(folder: Path, info: dict[str, Any]) -> Layout:
    meta = sorted((folder / "meta" / "episodes").glob("chunk-*/file-*.parquet"))
    if not meta:
        return _without_meta(folder, info)
    videos = video_features(info)
    data = ["data/chunk_index", "data/file_index"]
    range_ = ["dataset_from_index", "dataset_to_index"]
    place = [f"videos/{key}/{what}" for key in videos for what in ("chunk_index", "file_index", "from_timestamp")]
    names = ["episode_index", "length", *data, *range_, *place]
    tables = []
    for file in meta:
        tasks = ["tasks"] if "tasks" in schema_of(file).names else []
        tables.append(read_rows(file, [*names, *tasks]))
    table = {name: np.concatenate([table[name] for table in tables]) for name in names}
    where = f"{folder / 'meta' / 'episodes'}"
    for name in names:
        kinds = "iuf" if name.endswith("timestamp") else "iu"
        if table[name].ndim != 1 or table[name].dtype.kind not in kinds:
            raise ValueError(f"{where}: {name} must be a number an episode, got {table[name].dtype}")
    rows = table["length"].astype(np.int64)
    ends = np.cumsum(rows)
    for name, expected, allowed in [
        ("episode_index", np.arange(len(rows)), "the number of its row"),
        ("length", np.maximum(rows, 1), "at least 1"),
        ("dataset_from_index", ends - rows, "the rows before it"),
        ("dataset_to_index", ends, "the rows up to its end"),
    ]:
        if len(wrong := np.flatnonzero(table[name] != expected)):
            raise ValueError(
                f"{where}: {name} of episode {wrong[0]} must be {allowed} ({expected[wrong[0]]}), "
                f"got {table[name][wrong[0]]}"
            )
    pattern = info.get("data_path", "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet")
    files, file = _files(folder, pattern, table[data[0]], table[data[1]])
    first = np.zeros(len(rows), np.int64)
    for number in range(len(files)):
        inside = np.flatnonzero(file == number)
        first[inside] = np.cumsum(rows[inside]) - rows[inside]
    clips = {}
    for key in videos:
        chunk, number, start = (table[f"videos/{key}/{n}"] for n in ("chunk_index", "file_index", "from_timestamp"))
        clips[key] = (*_files(folder, info.get("video_path"), chunk, number, video_key=key), start.astype(np.float64))
        if not (np.isfinite(start) & (start >= 0)).all():
            raise ValueError(f"{where}: from_timestamp of {key} must be at least 0 s, got {start.min()}")
    tasks = tuple(_texts(each) for table in tables for each in table.get("tasks", ()))
    return Layout(folder, info, files, file, first, rows, ends - rows, tasks, clips)


def _version_2(folder: Path, info: dict[str, Any]) -> Layout:
    path = folder / "meta" / "episodes.jsonl"
    told = read_lines(path)
    for number, line in enumerate(told):
        length = line.get("length")
        if line.get("episode_index") != number or not (type(length) is int and 0 < length < 1 << 31):
            raise ValueError(
                f"{path}, line {number + 1}: must have episode_index {number} and a length, got {short(line)}"
            )
    rows = np.array([line["length"] for line in told], np.int64)
    per_chunk = info.get("chunks_size", 1000)
    if not (type(per_chunk) is int and 0 < per_chunk < 1 << 31):
        raise ValueError(f"{folder / 'meta' / 'info.json'}: chunks_size must be a count, got {short(per_chunk)}")
    number = np.arange(len(told))
    episode = {"episode_chunk": number // per_chunk, "episode_index": number}
    data = info.get("data_path", "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet")
    files = tuple(_path(folder, data, {name: values[i] for name, values in episode.items()}) for i in number)
    clips = {}
    for key in video_features(info):
        at = [{"video_key": key} | {name: values[i] for name, values in episode.items()} for i in number]
        clips[key] = [_path(folder, info.get("video_path"), values) for values in at], number, np.zeros(len(told))
    tasks = tuple(_texts(line.get("tasks", ())) for line in told)
    return Layout(folder, info, files, number, np.zeros_like(rows), rows, np.cumsum(rows) - rows, tasks, clips)


def _without_meta(folder: Path, info: dict[str, Any]) -> Layout:
    """By the episode numbers in the rows themselves: of datasets that have nothing but these."""
    files = tuple(sorted((folder / "data").glob("chunk-*/file-*.parquet")))
    if not files:
        raise FileNotFoundError(f"{folder} has no data files (data/chunk-*/file-*.parquet)")
    if video_features(info):
        raise ValueError(f"{folder} has videos but no meta/episodes that tells where an episode begins in them")
    file, first, rows = [], [], []
    for number, path in enumerate(files):
        if "episode_index" not in schema_of(path).names:
            raise ValueError(f"{path} lacks the columns episode_index; it has {', '.join(schema_of(path).names)}")
        index = read_rows(path, ["episode_index"])["episode_index"].reshape(row_count(path))
        starts = np.flatnonzero(np.diff(index, prepend=index[:1] - 1)) if index.dtype.kind in "iu" else None
        if starts is None:
            raise ValueError(f"{path}: episode_index must be integers, got {index.dtype}")
        file += [number] * len(starts)
        first += starts.tolist()
        rows += np.diff(starts, append=len(index)).tolist()
    file, first, rows = (np.array(numbers, np.int64) for numbers in (file, first, rows))
    return Layout(folder, info, files, file, first, rows, np.cumsum(rows) - rows, (), {})


def _files(
    folder: Path, pattern: Any, chunk: np.ndarray, file: np.ndarray, **names: str
) -> tuple[tuple[Path, ...], np.ndarray]:
    """The files that some episodes lie in, and which of them is each one's."""
    pairs, which = np.unique(np.stack([chunk, file]), axis=1, return_inverse=True)
    paths = [_path(folder, pattern, {"chunk_index": c, "file_index": f, **names}) for c, f in pairs.T.tolist()]
    return tuple(paths), which.reshape(-1)


def _path(folder: Path, pattern: Any, values: dict[str, Any]) -> Path:
    """The path that a pattern of `info.json` stands for."""
    told = f"{folder / 'meta' / 'info.json'}: a path of files must be a pattern of {', '.join(values)}, got {pattern!r}"
    if not isinstance(pattern, str):
        raise ValueError(told)

    def value(found: re.Match) -> str:
        if found[1] not in values:
            raise ValueError(told)
        return f"{values[found[1]]:0{found[2]}d}" if found[2] else str(values[found[1]])

    name = _OWN.sub(value, pattern)
    if "{" in name:
        raise ValueError(told)
    return folder / inner_path(name)


def _texts(values: Any) -> tuple[str, ...]:
    return tuple(map(str, values)) if isinstance(values, list | tuple | np.ndarray) else (str(values),)
