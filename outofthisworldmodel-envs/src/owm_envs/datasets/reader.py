"""Read recorded episodes back, bit for bit."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from owm_envs.datasets.fetch import local_dataset
from owm_envs.datasets.published import PUBLISHED_COLUMNS, episode_from_published
from owm_envs.datasets.schema import FEATURES, episode_from_columns, part_columns
from owm_envs.datasets.statistics import Statistics
from owm_envs.episode import Episode

_NEEDED = tuple(name for name in FEATURES if name not in ("timestamp", "frame_index", "index", "task_index"))


def read(path: str | Path, split: str | None = None) -> list[Episode]:
    """Read every episode of one split, in order.

    Args:
        path: folder of a LeRobot v3 dataset written by `owm-envs generate` (vectors as written, bit for bit) or with
            the columns of the paper authors' published datasets; or the folder that holds its splits; or the name of
            one on the hub, as `local_dataset` takes it.
        split: name of the split's folder below `path`; None if `path` itself is the dataset.

    Raises:
        FileNotFoundError: there is no such folder, split or data file.
        ValueError: it is not a LeRobot dataset, of another version, incomplete, truncated, or of other columns.
    """
    folder = dataset_folder(path, split)
    info = read_info(folder)
    files = _data_files(folder)
    episodes = [episode for file in files for episode in _read_file(file, info.get("features") or {})]
    # An episode may span files only where another writer split it; ours never do.
    frames = sum(len(episode) + 1 for episode in episodes)
    for what, found, told in [
        ("episodes", len(episodes), info.get("total_episodes")),
        ("frames", frames, info.get("total_frames")),
    ]:
        if told is not None and found != told:
            raise ValueError(f"{folder} is incomplete: it holds {found} {what}, its info.json tells of {told}")
    return episodes


def dataset_folder(path: str | Path, split: str | None = None) -> Path:
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
    if splits:
        raise ValueError(f"{root} holds the splits {', '.join(splits)}: name one")
    raise ValueError(f"{root} is not a LeRobot dataset: it has no meta/info.json")


def read_info(folder: Path) -> dict:
    """A dataset's `meta/info.json`.

    Raises:
        ValueError: it cannot be read, or the dataset is not of version 3.
    """
    path = folder / "meta" / "info.json"
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
        version = str(info["codebase_version"])
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is not the info.json of a LeRobot dataset: {error}") from None
    if version.lstrip("v").split(".")[0] != "3":
        raise ValueError(f"{folder} is a LeRobot dataset of version {version}; this reads version v3.x")
    return info


def read_statistics(path: str | Path, split: str | None = "train") -> Statistics:
    """The statistics to normalise by: those of the train split, whichever split is asked.

    Raises:
        FileNotFoundError, ValueError: as `read`.
    """
    file = dataset_folder(path, split) / "meta" / "stats.json"
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
        return {name: {key: np.asarray(value) for key, value in part.items()} for name, part in stored.items()}
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, AttributeError) as error:
        raise ValueError(f"{file} does not hold statistics: {error}") from None


def _data_files(folder: Path) -> list[Path]:
    files = sorted((folder / "data").glob("chunk-*/file-*.parquet"))
    if not files:
        raise FileNotFoundError(f"{folder} has no data files (data/chunk-*/file-*.parquet)")
    return files


def _read_file(path: Path, features: dict) -> Iterator[Episode]:
    try:
        names = pq.read_schema(path).names
        published = set(PUBLISHED_COLUMNS) <= set(names)
        needed = (*PUBLISHED_COLUMNS, "episode_index") if published else (*_NEEDED, *part_columns(names))
        missing = [name for name in needed if name not in names]
        if missing:
            raise ValueError(f"{path} lacks the columns {', '.join(missing)}; it has {', '.join(names)}")
        table = pq.read_table(path, columns=list(needed))
    except (pa.ArrowInvalid, pa.ArrowIOError, OSError) as error:
        raise ValueError(f"{path} cannot be read; it may be truncated: {error}") from None
    columns = {name: _numpy(table[name]) for name in needed}
    for name in part_columns(columns):
        columns[name] = columns[name].reshape(-1, *features.get(name, {}).get("shape", columns[name].shape[1:] or (1,)))
    index = columns["episode_index"].reshape(-1)
    starts = np.flatnonzero(np.diff(index, prepend=index[:1] - 1))
    make = episode_from_published if published else episode_from_columns
    for start, end in zip(starts, np.append(starts[1:], len(index))):
        yield make({name: values[start:end] for name, values in columns.items()})


def _numpy(column: pa.ChunkedArray) -> np.ndarray:
    """A column as an array (rows,) or (rows, width), nested lists flattened."""
    array = column.combine_chunks()
    rows = len(array)
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    nested = False
    while pa.types.is_nested(array.type):
        array, nested = array.flatten(), True
    if array.null_count:
        raise ValueError("a column has missing values")
    values = array.to_numpy(zero_copy_only=False)
    return values.reshape(rows, -1) if nested else values
