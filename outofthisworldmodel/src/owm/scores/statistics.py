"""Intervals of rates and paired comparisons of policies that flew the same starts."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import binomtest


def wilson(count: int, total: int) -> tuple[float, float]:
    """Wilson's 95 % score interval of a proportion; (0, 1) without a trial."""
    return tuple(binomtest(count, total).proportion_ci(method="wilson")) if total else (0.0, 1.0)


def rate(hits: Bool[np.ndarray, "N"]) -> dict[str, float]:
    """Count, total, rate and its 95 % interval."""
    count, total = int(np.sum(hits)), len(hits)
    low, high = wilson(count, total)
    share = count / total if total else math.nan
    return {"count": count, "total": total, "rate": share, "low": low, "high": high}


def seeded_rate(hits: Sequence[Bool[np.ndarray, "N"]], *, draws: int = 2000, seed: int = 0) -> dict[str, float]:
    """Rate over several trained seeds that flew the same starts, its 95 % interval from resampled seeds, then flights.

    Three seeds resampled vary less than seeds do: the interval is a lower bound of the uncertainty. It is widened to
    Wilson's of one seed's flights at the mean rate (its count rounded outwards), which is what is left where all seeds
    agree in every flight.

    Args:
        hits: one array a seed, of one length.
        draws: bootstrap samples.
        seed: of the draws.

    Raises:
        ValueError: no seeds, or of different lengths.
    """
    if len({len(each) for each in hits}) != 1:
        raise ValueError(f"seeds must have flown equally often, got {[len(each) for each in hits]} flights")
    table = np.stack([np.asarray(each, bool) for each in hits])
    seeds, flights = table.shape
    numbers = rate(table.reshape(-1))
    if seeds == 1 or flights == 0:
        return numbers
    rng = np.random.default_rng(seed)
    means = np.empty(draws)
    for i in range(draws):
        drawn = rng.integers(seeds, size=seeds)
        means[i] = np.mean([table[s, rng.integers(flights, size=flights)].mean() for s in drawn])
    low, high = np.quantile(means, [0.025, 0.975])
    least, most = numbers["count"] // seeds, -(-numbers["count"] // seeds)
    low, high = min(low, wilson(least, flights)[0]), max(high, wilson(most, flights)[1])
    return numbers | {"low": float(low), "high": float(high)}


def mcnemar(first_only: int, second_only: int) -> float:
    """Exact two-sided p-value of as unequal a split of the discordant pairs under a fair coin.

    Source: Q. McNemar, Psychometrika 12 (1947) 153; exact by the binomial distribution.
    """
    discordant = first_only + second_only
    return float(binomtest(first_only, discordant).pvalue) if discordant else 1.0


def holm(p: Sequence[float]) -> list[float]:
    """Adjusted p-values: rejecting those at or below alpha errs anywhere in the family with probability alpha at most.

    Source: S. Holm, Scand. J. Statistics 6 (1979) 65.
    """
    adjusted, largest = [0.0] * len(p), 0.0
    for rank, i in enumerate(np.argsort(p, kind="stable")):
        largest = max(largest, min(1.0, (len(p) - rank) * p[i]))
        adjusted[i] = largest
    return adjusted


@dataclass(frozen=True)
class Pairs:
    """How two policies fared on the starts that both flew."""

    first: str
    second: str
    both: int
    first_only: int
    second_only: int
    neither: int

    @property
    def total(self) -> int:
        """Starts that both flew."""
        return self.both + self.first_only + self.second_only + self.neither

    @property
    def difference(self) -> float:
        """Rate of the first less that of the second."""
        return (self.first_only - self.second_only) / self.total

    @property
    def p(self) -> float:
        """Exact McNemar."""
        return mcnemar(self.first_only, self.second_only)


def pair(
    first: tuple[str, np.ndarray, Bool[np.ndarray, "N"]], second: tuple[str, np.ndarray, Bool[np.ndarray, "M"]]
) -> Pairs:
    """Count by fingerprint of the start.

    Args:
        first, second: name, fingerprints, and whether each flight succeeded.

    Raises:
        ValueError: a fingerprint occurs twice, or none in both.
    """
    tables = []
    for name, digests, hits in (first, second):
        table = dict(zip(np.asarray(digests).tolist(), np.asarray(hits, bool).tolist()))
        if len(table) != len(hits):
            raise ValueError(f"{name!r} flew a start more than once")
        tables.append(table)
    common = sorted(tables[0].keys() & tables[1].keys())
    if not common:
        raise ValueError(f"{first[0]!r} and {second[0]!r} have no start in common")
    a, b = (np.array([table[digest] for digest in common]) for table in tables)
    counts = (int(np.sum(x)) for x in (a & b, a & ~b, ~a & b, ~a & ~b))
    return Pairs(first[0], second[0], *counts)


def median_interval(values: Float[np.ndarray, "N"]) -> tuple[float, float, float]:
    """Median and an interval between two order statistics that holds it with at least 95 %; infinite if none does.

    Source: Conover (1999), Practical nonparametric statistics, sec. 3.2.
    """
    values = np.sort(np.asarray(values, np.float64))
    if len(values) == 0:
        return math.nan, -math.inf, math.inf
    outside, tail = 0, 1.0 / 2 ** len(values)  # how many values are left out on each side, and how likely that fails
    while tail <= 0.025:
        outside += 1
        tail += math.comb(len(values), outside) / 2 ** len(values)
    low, high = (values[outside - 1], values[-outside]) if outside else (-math.inf, math.inf)
    return float(np.median(values)), float(low), float(high)


def quantiles_by(
    bins: Float[np.ndarray, "N"], values: Float[np.ndarray, "N"], edges: Sequence[float]
) -> list[dict[str, float]]:
    """Count and 10, 50 and 90 % quantiles of `values` where `bins` falls between consecutive edges."""
    rows = []
    for low, high in itertools.pairwise(edges):
        some = values[(bins >= low) & (bins < high)]
        levels = np.quantile(some, [0.1, 0.5, 0.9]).tolist() if len(some) else [math.nan] * 3
        rows.append({"from": low, "to": high, "count": len(some), **dict(zip(("p10", "p50", "p90"), levels))})
    return rows
