"""Ways to damage a dataset, for the tests: each takes the folder of its splits and changes files in it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

DATA = "train/data/chunk-000/file-000.parquet"
EPISODES = "train/meta/episodes/chunk-000/file-000.parquet"
INFO = "train/meta/info.json"
STATE, TRUTH = "observation.state", "observation.environment_state"


_AWAY = np.array([400.0] + [0.0] * 12)


def rewrite(path: Path, change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray] | None]) -> None:
    """Change the columns of a Parquet file, as arrays (rows, ...); its row groups keep their sizes."""
    footer = pq.read_metadata(path)
    groups = [footer.row_group(number).num_rows for number in range(footer.num_row_groups)]
    table = pq.read_table(path)
    columns = {name: _array(table[name]) for name in table.column_names}
    changed = change(columns) or columns
    arrays = {name: values if isinstance(values, pa.Array) else _arrow(values) for name, values in changed.items()}
    table = pa.table(arrays).replace_schema_metadata(table.schema.metadata)
    with pq.ParquetWriter(path, table.schema, write_page_checksum=True) as writer:
        first = 0
        for rows in groups:
            writer.write_table(table.slice(first, rows))
            first += rows
        if first < len(table):
            writer.write_table(table.slice(first))


def _array(column: pa.ChunkedArray) -> np.ndarray:
    array = column.combine_chunks()
    if isinstance(array, pa.FixedSizeListArray):
        return array.flatten().to_numpy(zero_copy_only=False).reshape(len(array), -1).copy()
    values = array.to_numpy(zero_copy_only=False).copy()
    return values


def _arrow(values: np.ndarray) -> pa.Array:
    if values.dtype == object:
        return pa.array(values.tolist())
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def in_rows(change: Callable[[dict[str, np.ndarray]], dict | None], file: str = DATA) -> Callable[[Path], None]:
    """A damage of the rows of a file."""
    return lambda root: rewrite(root / file, change)


def at(name: str, row: int, value: object, file: str = DATA) -> Callable[[Path], None]:
    """A damage of one row: a number in place of it."""

    def change(columns: dict[str, np.ndarray]) -> None:
        columns[name][row] = value

    return in_rows(change, file)


def told(file: str, *keys: str | int, value: object) -> Callable[[Path], None]:
    """A damage of a JSON file: a value in place of the one under some keys."""

    def damage(root: Path) -> None:
        whole = json.loads((root / file).read_text())
        inner = whole
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        (root / file).write_text(json.dumps(whole))

    return damage


def _order(pick: Callable[[int], np.ndarray], names: tuple[str, ...] = ()) -> Callable[[Path], None]:
    """Rows of the first episode in another order: all columns, or some."""

    def change(columns: dict[str, np.ndarray]) -> None:
        inside = np.flatnonzero(columns["episode_index"] == 0)
        for name in names or tuple(columns):
            columns[name][inside] = columns[name][inside][pick(len(inside))]

    return in_rows(change)


def _shuffled(rows: int) -> np.ndarray:
    return np.random.default_rng(0).permutation(rows)


def _reversed(rows: int) -> np.ndarray:
    return np.arange(rows)[::-1]


def _doubled(rows: int) -> np.ndarray:
    return np.maximum(np.arange(rows) - (np.arange(rows) > 3), 0)


def _swapped(one: str, other: str, cast: bool) -> Callable[[Path], None]:
    def change(columns: dict[str, np.ndarray]) -> None:
        a, b = columns[one], columns[other]
        columns[one], columns[other] = (b.astype(a.dtype), a.astype(b.dtype)) if cast else (b, a)

    return in_rows(change)


def _as_type(name: str, kind: str) -> Callable[[Path], None]:
    def change(columns: dict[str, np.ndarray]) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            columns[name] = columns[name].astype(kind)

    return in_rows(change)


def _scaled(name: str, part: slice, factor: float) -> Callable[[Path], None]:
    def change(columns: dict[str, np.ndarray]) -> None:
        columns[name][:, part] *= factor

    return in_rows(change)


def _all(name: str, value: float) -> Callable[[Path], None]:
    def change(columns: dict[str, np.ndarray]) -> None:
        columns[name] = np.full_like(columns[name], value)

    return in_rows(change)


def _without(name: str, file: str = DATA) -> Callable[[Path], None]:
    return in_rows(lambda columns: {key: values for key, values in columns.items() if key != name}, file)


def _rows(pick: Callable[[int], np.ndarray]) -> Callable[[Path], None]:
    return in_rows(lambda columns: {name: values[pick(len(values))] for name, values in columns.items()})


def _splits_swapped(root: Path) -> None:
    (root / "train").rename(root / "aside")
    (root / "val").rename(root / "train")
    (root / "aside").rename(root / "val")


def _val_is_train(root: Path) -> None:
    shutil.rmtree(root / "val")
    shutil.copytree(root / "train", root / "val")


def _boundary_moved(root: Path) -> None:
    """The first row of the second episode is told to be the last of the first one, wherever it is told."""

    def rows(columns: dict[str, np.ndarray]) -> None:
        first = int((columns["episode_index"] == 0).sum())
        columns["episode_index"][first] = 0
        columns["frame_index"][first] = first
        later = columns["episode_index"] == 1
        columns["frame_index"][later] -= 1
        columns["timestamp"] = (columns["frame_index"] / 20).astype(np.float32)

    def episodes(columns: dict[str, np.ndarray]) -> None:
        columns["length"][:2] += [1, -1]
        columns["dataset_to_index"][0] += 1
        columns["dataset_from_index"][1] += 1

    rewrite(root / DATA, rows)
    rewrite(root / EPISODES, episodes)


def _text(name: str, file: str) -> Callable[[Path], None]:
    def change(columns: dict[str, np.ndarray]) -> None:
        columns[name] = np.array([f"{value}" for value in columns[name].tolist()], object)

    return in_rows(change, file)


def _file(name: str, content: bytes | None) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        (root / name).unlink() if content is None else (root / name).write_bytes(content)

    return damage


DAMAGES: dict[str, Callable[[Path], None]] = {
    "rows shuffled": _order(_shuffled),
    "rows reversed": _order(_reversed),
    "rows doubled": _order(_doubled),
    "numbers shuffled": _order(_shuffled, (STATE, TRUTH)),
    "numbers reversed": _order(_reversed, (STATE, TRUTH, "action")),
    "numbers and time reversed": _order(_reversed, (STATE, TRUTH, "epoch")),
    "truth shuffled": _order(_shuffled, (TRUTH,)),
    "truth reversed": _order(_reversed, (TRUTH,)),
    "observation shuffled": _order(_shuffled, (STATE,)),
    "observation reversed": _order(_reversed, (STATE,)),
    "time reversed": _order(_reversed, ("epoch",)),
    "time doubled": _order(_doubled, ("epoch",)),
    "frame numbers reversed": _order(_reversed, ("frame_index",)),
    "times of frames shuffled": _order(_shuffled, ("timestamp",)),
    "flags shuffled": _order(_shuffled, ("next.done",)),
    "all rows twice": _rows(lambda rows: np.tile(np.arange(rows), 2)),
    "a row less": _rows(lambda rows: np.arange(rows - 1)),
    "a row more": _rows(lambda rows: np.append(np.arange(rows), rows - 1)),
    "observation and truth swapped": _swapped(STATE, TRUTH, cast=False),
    "observation and truth swapped, types kept": _swapped(STATE, TRUTH, cast=True),
    "train and val swapped": _splits_swapped,
    "val is train": _val_is_train,
    "quaternions of length 2": _scaled(STATE, slice(6, 10), 2),
    "quaternions of length 0": _scaled(STATE, slice(6, 10), 0),
    "true quaternions of length 2": _scaled(TRUTH, slice(6, 10), 2),
    "true quaternions of length 0": _scaled(TRUTH, slice(6, 10), 0),
    "goal of length 2": _scaled("goal_pose", slice(3, 7), 2),
    "goal elsewhere": at("goal_pose", 3, 0.0),
    "truth scaled": _scaled(TRUTH, slice(0, 3), 1.01),
    "observation of zeros": _all(STATE, 0),
    "truth of zeros": _all(TRUTH, 0),
    "observation a mile off": at(STATE, 5, 1609.0),
    "not a number seen": at(STATE, 7, np.nan),
    "not a number true": at(TRUTH, 7, np.nan),
    "infinite action": at("action", 2, np.inf),
    "not a number as reward": at("next.reward", 2, np.nan),
    "not a number as time": at("epoch", 2, np.nan),
    "1e30 m seen": at(STATE, 4, 1e30),
    "1e30 m true": at(TRUTH, 4, 1e30),
    "1e9 N": at("action", 4, 1e9),
    "4 kN": at("action", 4, 4000.0),
    "an action that starts nothing": at("action", -1, 1.0),
    "reward of 1e30": at("next.reward", 4, 1e30),
    "integer observations": _as_type(STATE, "int32"),
    "half observations": _as_type(STATE, "float16"),
    "double observations": _as_type(STATE, "float64"),
    "single truth": _as_type(TRUTH, "float32"),
    "integer rewards": _as_type("next.reward", "int64"),
    "flags as numbers": _as_type("next.done", "int64"),
    "years later": in_rows(lambda c: c | {"epoch": c["epoch"] + [1000.0, 0.0]}),
    "flown elsewhere": in_rows(lambda c: c | {name: c[name] + _AWAY.astype(c[name].dtype) for name in (STATE, TRUTH)}),
    "port -1": _all("port", -1),
    "port 99": _all("port", 99),
    "port of another task": lambda root: (_all("port", 0)(root), _all("task_index", 0)(root)),
    "port 1.7": in_rows(lambda c: c | {"port": np.full(len(c["port"]), 1.7)}),
    "port changes": at("port", 8, 2),
    "policy 99": _all("policy", 99),
    "policy -2": _all("policy", -2),
    "policy changes": at("policy", 8, 4),
    "outcome 0": _all("outcome", 0),
    "outcome 17": _all("outcome", 17),
    "outcome another": _all("outcome", 1),
    "done in the middle": at("next.done", 5, True),
    "never done": _all("next.done", False),
    "success of nothing": _all("next.success", True),
    "episode number 7": _all("episode_index", 7),
    "task of another": _all("task_index", 5),
    "wide action": in_rows(lambda c: c | {"action": np.tile(c["action"], 2)}),
    "narrow truth": in_rows(lambda c: c | {TRUTH: c[TRUTH][:, :12]}),
    "no goal": _without("goal_pose"),
    "no time": _without("epoch"),
    "a further column": in_rows(lambda c: c | {"more": c["action"]}),
    "boundary moved": _boundary_moved,
    "episode numbers as text": _text("episode_index", DATA),
    "ports as text": _text("port", DATA),
    "fps 0": told(INFO, "fps", value=0),
    "fps -20": told(INFO, "fps", value=-20),
    "fps 10": told(INFO, "fps", value=10),
    "fps 19.9": told(INFO, "fps", value=19.9),
    "fps a list": told(INFO, "fps", value=[20]),
    "fps text": told(INFO, "fps", value="20"),
    "fps true": told(INFO, "fps", value=True),
    "fps nothing": told(INFO, "fps", value=None),
    "fps beyond every float": told(INFO, "fps", value=10**400),
    "episodes beyond every float": told(INFO, "total_episodes", value=10**400),
    "numbers called otherwise": told(INFO, "features", "action", "names", value=list("xyzxyz")),
    "a task less": told(INFO, "total_tasks", value=7),
    "splits of another": told(INFO, "splits", value={"train": "0:1"}),
    "paths of long names": told(INFO, "data_path", value="data/" + "x" * 300 + "/{chunk_index}/{file_index}.parquet"),
    "version 2.1": told(INFO, "codebase_version", value="v2.1"),
    "version 9": told(INFO, "codebase_version", value="v9"),
    "version a number": told(INFO, "codebase_version", value=3),
    "episodes a list": told(INFO, "total_episodes", value=[3]),
    "one episode more": told(INFO, "total_episodes", value=1000),
    "one frame more": told(INFO, "total_frames", value=1),
    "features a list": told(INFO, "features", value=[1]),
    "features gone": told(INFO, "features", value={}),
    "a feature a number": told(INFO, "features", "action", value=6),
    "a feature of another shape": told(INFO, "features", "action", "shape", value=[7]),
    "a feature of another type": told(INFO, "features", "action", "dtype", value="float64"),
    "paths that lead out": told(INFO, "data_path", value="../{chunk_index}/{file_index}.parquet"),
    "paths of a million digits": told(INFO, "data_path", value="data/{chunk_index:999999999d}"),
    "paths of nothing": told(INFO, "data_path", value="data/{nothing}"),
    "paths a list": told(INFO, "data_path", value=[]),
    "info deeply nested": _file(INFO, b'{"fps": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"),
    "info a list": _file(INFO, b"[1, 2]"),
    "info no text": _file(INFO, b"\xff\xfe{"),
    "info empty": _file(INFO, b""),
    "info gone": _file(INFO, None),
    "statistics a list": _file("train/meta/stats.json", b"[]"),
    "statistics not numbers": told("train/meta/stats.json", "action", "mean", value=["a"]),
    "statistics ragged": told("train/meta/stats.json", "action", "mean", value=[[1], [1, 2]]),
    "statistics negative": told("train/meta/stats.json", "action", "std", value=[-1.0] * 6),
    "statistics not finite": told("train/meta/stats.json", "action", "mean", value=[float("nan")] * 6),
    "statistics the wrong way round": told("train/meta/stats.json", "action", "max", value=[-3000.0] * 6),
    "statistics of a mean outside": told("train/meta/stats.json", "action", "mean", value=[3000.0] * 6),
    "statistics of a spread too wide": told("train/meta/stats.json", "action", "std", value=[1e5] * 6),
    "statistics of no rows": told("train/meta/stats.json", "action", "count", value=[0]),
    "statistics beyond every float": told("train/meta/stats.json", "action", "max", value=[10**400] * 6),
    "statistics of nothing": told("train/meta/stats.json", "action", value={}),
    "statistics of a column less": _file("train/meta/stats.json", b"{}"),
    "statistics gone": _file("train/meta/stats.json", None),
    "lengths another": at("length", 0, 5, EPISODES),
    "begins another": at("dataset_from_index", 0, 5, EPISODES),
    "file of another": at("data/file_index", 0, 7, EPISODES),
    "episodes renumbered": at("episode_index", 0, 4, EPISODES),
    "episode numbers told as text": _text("episode_index", EPISODES),
    "lengths told as text": _text("length", EPISODES),
    "no lengths": _without("length", EPISODES),
    "episodes gone": _file(EPISODES, None),
    "data gone": _file(DATA, None),
    "data empty": _file(DATA, b""),
    "tasks gone": _file("train/meta/tasks.parquet", None),
    "tasks in another order": in_rows(
        lambda c: c | {"__index_level_0__": c["__index_level_0__"][::-1]}, "train/meta/tasks.parquet"
    ),
    "generation a list": _file("generation.json", b"[]"),
    "generation of other counts": told("generation.json", "result", "train", "episodes", value=1),
    "generation of other policies": told("generation.json", "result", "train", "policies", value={"dock": 3}),
    "generation of no splits": told("generation.json", "result", value={}),
    "generation of text": told("generation.json", "result", value="all"),
    "generation of no configuration": told("generation.json", "environment", value=3),
    "generation of another rate": told("generation.json", "environment", "dt", value=0.1),
    "generation of negative mass": told("generation.json", "environment", "chaser", "mass", value=-1),
}
"""Ways in which a dataset may be wrong though each of its files is what its format says."""
