"""JSON and Parquet as values; whatever is wrong with the bytes is told in one line that names the file."""

import json
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from owm_envs.files import plain_file

_MOST = 2**40
"""Bytes of a file of rows, or of a line for each episode."""


def read_json(path: Path, what: str = "a JSON object") -> dict[str, Any]:
    """The object that a JSON file holds.

    Args:
        what: it is to be, in words.

    Raises:
        ValueError: it cannot be read, or is no object.
    """
    return _object(path, what, path, lambda: plain_file(path).read_text(encoding="utf-8"))


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The objects of a file that has one on each line.

    Raises:
        ValueError: it cannot be read, or a line is no object.
    """
    try:
        lines = plain_file(path, _MOST).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from None
    told = ((f"{path}, line {number}", line) for number, line in enumerate(lines, 1) if line.strip())
    return [_object(path, "a JSON object", where, lambda line=line: line) for where, line in told]


def _object(path: Path, what: str, where: object, text: Any) -> dict[str, Any]:
    try:
        value = json.loads(text())
    except (OSError, ValueError, RecursionError) as error:  # of depth; undecodable text is a ValueError
        raise ValueError(f"{where} is not {what}: {error}") from None
    if not isinstance(value, dict):
        raise ValueError(f"{where} is not {what}: it holds a {type(value).__name__}")
    return value


def schema_of(path: Path) -> pa.Schema:
    """The columns of a Parquet file and their types. Raises ValueError: it cannot be read."""
    return _parsed(path, lambda: _footer(path).schema.to_arrow_schema())


def row_count(path: Path) -> int:
    """Rows of a Parquet file. Raises ValueError: it cannot be read."""
    return _parsed(path, lambda: _footer(path).num_rows)


def read_rows(path: Path, names: Sequence[str], first: int = 0, last: int | None = None) -> dict[str, np.ndarray]:
    """Columns of a Parquet file, in the given rows; only the row groups that hold them are read.

    Returns:
        Arrays (rows, ...) by name. Lists of one length each become further axes; images are decoded, to
        (rows, H, W, 3); text and lists of any length stay Python objects.

    Raises:
        ValueError: the file is damaged, as its page checksums tell where it has them, lacks a column or a value.
    """
    footer = _parsed(path, lambda: _footer(path))
    last = footer.num_rows if last is None else last
    ends = np.cumsum([footer.row_group(group).num_rows for group in range(footer.num_row_groups)], dtype=np.int64)
    chosen = [group for group, end in enumerate(ends) if end > first and end - _rows(footer, group) < last]
    before = int(ends[chosen[0]] - _rows(footer, chosen[0])) if chosen else first

    def read() -> pa.Table:
        with pq.ParquetFile(path, metadata=footer, page_checksum_verification=True) as file:
            return file.read_row_groups(chosen, columns=list(names))

    table = _parsed(path, read)
    if missing := [name for name in names if name not in table.column_names]:
        raise ValueError(f"{path} lacks the columns {', '.join(missing)}; it has {', '.join(schema_of(path).names)}")
    rows = table.slice(first - before, last - first)
    return {name: _parsed(path, lambda name=name: _numpy(rows[name], name)) for name in names}


def _rows(footer: pq.FileMetaData, group: int) -> int:
    return footer.row_group(group).num_rows


def _footer(path: Path) -> pq.FileMetaData:
    about = plain_file(path, _MOST).stat()
    return _footer_at(path, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=64)
def _footer_at(path: Path, changed: int, size: int) -> pq.FileMetaData:
    return pq.read_metadata(path)


def _parsed(path: Path, read: Any) -> Any:
    try:
        return read()
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} is missing") from None
    except Exception as error:  # a parser of damaged bytes raises whatever it stumbles over
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path} cannot be read; it may be truncated or damaged: {said}") from None


def _numpy(column: pa.ChunkedArray, name: str) -> np.ndarray:
    """A column as an array (rows, ...)."""
    array = column.combine_chunks()
    if isinstance(array, pa.ChunkedArray):  # of no rows, in some versions
        array = pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], array.type)
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    shape = [len(array)]
    while isinstance(array, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray):
        _whole(array, name)
        lengths = np.unique(array.value_lengths())
        if len(lengths) > 1:
            return _objects(column.to_pylist())
        if isinstance(array, pa.FixedSizeListArray):
            shape.append(array.type.list_size)
        else:
            shape.append(int(lengths[0]) if len(lengths) else 0)
        array = array.flatten()
    _whole(array, name)
    if pa.types.is_struct(array.type) and "bytes" in [field.name for field in array.type]:
        return np.stack([_picture(row["bytes"]) for row in array.to_pylist()]) if len(array) else np.zeros((0,))
    if not (pa.types.is_primitive(array.type) or pa.types.is_boolean(array.type)):
        return _objects(column.to_pylist())
    return array.to_numpy(zero_copy_only=False).reshape(shape)


def _whole(array: pa.Array, name: str) -> None:
    if array.null_count:
        raise ValueError(f"{array.null_count} values of {name} are missing")


def _objects(values: Iterable[Any]) -> np.ndarray:
    values = list(values)
    array = np.empty(len(values), object)
    array[:] = values
    return array


def _picture(data: bytes) -> np.ndarray:
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError("an image cannot be decoded")
    return np.ascontiguousarray(image[..., ::-1])
