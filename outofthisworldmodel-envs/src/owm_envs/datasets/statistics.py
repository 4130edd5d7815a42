"""Normalisation statistics, as LeRobot keeps them: of each episode, and of all of a split's.

All are exact, whatever the number of rows, in constant memory: moments and extremes add up over episodes, quantiles are
found in passes over the rows, those of pixels in histograms.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np
from jaxtyping import Float, Int, Shaped

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
NO_TRANSITION_ROWS = ("action", "next.reward")
"""Columns whose last row in an episode is padding and is left out."""
WIDEST = 64
"""Columns of more numbers a row have averages of their episodes' quantiles, as LeRobot's own writer has of all."""
_DIGIT, _AT_ONCE = 16, 2**17

Statistics = dict[str, dict[str, np.ndarray]]
"""Column to {min, max, mean, std, count, q01, q10, q50, q90, q99}, each (width,), count (1,); of pixels (3, 1, 1)."""


def counted_rows(name: str, values: Shaped[np.ndarray, "T ..."]) -> Shaped[np.ndarray, "N W"]:
    """The rows of an episode's column that count, a vector each: without the padding of the terminal row."""
    rows = values[:-1] if name in NO_TRANSITION_ROWS else values
    return rows.reshape(len(rows), -1)


def episode_statistics(columns: Mapping[str, np.ndarray]) -> Statistics:
    """Statistics of one episode's columns."""
    result = {}
    for name, values in columns.items():
        rows = counted_rows(name, values)
        ordered = np.sort(rows, axis=0)
        result[name] = {
            "min": ordered[0].astype(np.float64),
            "max": ordered[-1].astype(np.float64),
            "mean": rows.mean(axis=0, dtype=np.float64),
            "std": rows.std(axis=0, dtype=np.float64),
            "count": np.array([len(rows)]),
            **{key: _interpolated(q, len(ordered), lambda rank: ordered[rank]) for key, q in QUANTILES.items()},  # noqa: B023
        }
    return result


def pixel_statistics(histogram: Int[np.ndarray, "3 256"], frames: int) -> dict[str, np.ndarray]:
    """Statistics of frames of three channels, 0 to 1, from how often each value came."""
    values, shape = np.arange(256) / 255.0, (3, 1, 1)
    total = histogram.sum(axis=1)
    mean = histogram @ values / total
    # From the counts below each rank: exact, as of the sorted values.
    upto = histogram.cumsum(axis=1)
    level = lambda rank: np.array([values[np.searchsorted(row, rank, side="right")] for row in upto])
    found = {
        "min": level(0),
        "max": level(int(total[0]) - 1),
        "mean": mean,
        "std": np.sqrt(np.maximum(histogram @ values**2 / total - mean**2, 0.0)),
        **{key: _interpolated(q, int(total[0]), level) for key, q in QUANTILES.items()},
    }
    return {key: value.reshape(shape) for key, value in found.items()} | {"count": np.array([frames])}


def united(one: Statistics, other: Statistics) -> Statistics:
    """Statistics of two sets of rows together; the first may be empty. Quantiles are means weighted by count.

    Source of the moments: Chan, Golub and LeVeque, Updating formulae and a pairwise algorithm, COMPSTAT 1982.
    """
    return {name: _union(one[name], own) if one else own for name, own in other.items()}


def _union(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    share = float(other["count"][0]) / float(one["count"][0] + other["count"][0])
    apart = other["mean"] - one["mean"]
    variance = (1 - share) * one["std"] ** 2 + share * other["std"] ** 2 + share * (1 - share) * apart**2
    return {
        "min": np.minimum(one["min"], other["min"]),
        "max": np.maximum(one["max"], other["max"]),
        "mean": one["mean"] + share * apart,
        "std": np.sqrt(variance),
        "count": one["count"] + other["count"],
        **{key: (1 - share) * one[key] + share * other[key] for key in QUANTILES},
    }


def exact_quantiles(
    rows: Callable[[], Iterable[Shaped[np.ndarray, "N W"]]], most: int = 2**20
) -> dict[str, Float[np.ndarray, "W"]]:
    """Quantiles of all rows together, by linear interpolation as NumPy's.

    Numbers are told apart by their leading bits, 16 more at each pass, until few enough begin like those wanted.

    Args:
        rows: gives them anew at each call, some at a time.
        most: numbers that are held at a time, beside some of the rows.
    """
    count = sum(len(some) for some in rows())
    ranks = sorted({rank for q in QUANTILES.values() for rank in _ranks(q, count)})
    width = next(iter(rows())).shape[1]
    # Of each column and rank: the leading bits found, and the rank among the numbers that begin with them.
    found = {(column, rank): (0, rank) for column in range(width) for rank in ranks}
    for bits in range(0, 64, _DIGIT):
        counts = {key: np.zeros(1 << _DIGIT, np.int64) for key in _beginnings(found)}
        for keys in _batches(rows):
            for (column, beginning), those in counts.items():
                own = _like(keys[:, column], bits, beginning)
                digits = (own >> np.uint64(64 - _DIGIT - bits)) & np.uint64((1 << _DIGIT) - 1)
                those += np.bincount(digits.astype(np.int64), minlength=1 << _DIGIT)
        upto = {key: those.cumsum() for key, those in counts.items()}
        held = {}
        for (column, rank), (beginning, within) in found.items():
            below = upto[column, beginning]
            digit = int(np.searchsorted(below, within, side="right"))
            before = int(below[digit - 1]) if digit else 0
            found[column, rank] = longer = beginning << _DIGIT | digit, within - before
            held[column, longer[0]] = int(below[digit]) - before
        if sum(held.values()) <= most:
            break
    kept: dict[tuple[int, int], list[np.ndarray]] = {key: [] for key in _beginnings(found)}
    bits += _DIGIT
    if bits < 64:
        for keys in _batches(rows):
            for (column, beginning), those in kept.items():
                those.append(_like(keys[:, column], bits, beginning))
    values = {key: np.sort(np.concatenate(those)) if those else None for key, those in kept.items()}

    def number(rank: int) -> np.ndarray:
        keys = []
        for column in range(width):
            beginning, within = found[column, rank]
            those = values[column, beginning]
            keys.append(beginning if those is None else int(those[within]))
        return _from_sortable(np.array(keys, np.uint64))

    return {key: _interpolated(q, count, number) for key, q in QUANTILES.items()}


def _beginnings(found: Mapping[tuple[int, int], tuple[int, int]]) -> set[tuple[int, int]]:
    return {(column, beginning) for (column, _), (beginning, _) in found.items()}


def _batches(rows: Callable[[], Iterable[np.ndarray]]) -> Iterator[np.ndarray]:
    """Rows as sortable integers, many at a time."""
    some: list[np.ndarray] = []
    for each in rows():
        some.append(each)
        if sum(map(len, some)) >= _AT_ONCE:
            yield _sortable(np.concatenate(some))
            some = []
    if some:
        yield _sortable(np.concatenate(some))


def _like(keys: np.ndarray, bits: int, beginning: int) -> np.ndarray:
    """Those whose leading bits are these."""
    return keys[keys >> np.uint64(64 - bits) == np.uint64(beginning)] if bits else keys


def _sortable(values: np.ndarray) -> np.ndarray:
    """Numbers as integers in the same order: float64's bits, of the negative ones inverted."""
    bits = np.ascontiguousarray(values, np.float64).view(np.uint64)
    return np.where(bits >> np.uint64(63), ~bits, bits | np.uint64(1 << 63))


def _from_sortable(keys: np.ndarray) -> np.ndarray:
    return np.where(keys >> np.uint64(63), keys & np.uint64((1 << 63) - 1), ~keys).view(np.float64)


def _ranks(q: float, count: int) -> tuple[int, int]:
    below = int(q * (count - 1))
    return below, min(below + 1, count - 1)


def _interpolated(q: float, count: int, number: Callable[[int], np.ndarray]) -> np.ndarray:
    below, above = _ranks(q, count)
    low, high = (np.asarray(number(rank), np.float64) for rank in (below, above))
    return low + (q * (count - 1) - below) * (high - low)
