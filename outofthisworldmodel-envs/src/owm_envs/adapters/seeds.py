"""Seeds, the same in every adapter: any integer from zero on, all bits of which count."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Key, UInt32

from owm_envs.flags import own_flags
from owm_envs.words import checked_seed

_MOST_DRAWN = 2**63


def slot_seeds(seed: Any, count: int) -> list[int | None]:
    """A seed for each of `count` slots: seed + i of a single one, those of a sequence, None without.

    Raises:
        TypeError, ValueError: a seed is not one, or a sequence is of another length.
    """
    if seed is None:
        return [None] * count
    if isinstance(seed, (Sequence, np.ndarray)) and not isinstance(seed, (str, bytes)) and np.ndim(seed):
        if len(seed) != count:
            raise ValueError(f"seed names {len(seed)} seeds for {count} environments")
        return [None if each is None else checked_seed(each) for each in seed]
    first = checked_seed(seed)
    return [first + slot for slot in range(count)]


def drawn_seed(random: np.random.Generator) -> int:
    """A seed for an episode that was given none."""
    return int(random.integers(_MOST_DRAWN))


def seed_words(seeds: Sequence[int]) -> UInt32[np.ndarray, "B 2"]:
    """The words of one key per seed: the seed itself up to 64 bits, a hash of all its bits beyond."""
    return np.asarray([_words(checked_seed(seed)) for seed in seeds], np.uint32).reshape(-1, 2)


def _words(seed: int) -> tuple[int, int]:
    if seed < 2**64:
        return seed >> 32, seed & 0xFFFFFFFF
    high, low = np.random.SeedSequence(seed).generate_state(2)
    return int(high), int(low)


def seed_keys(seeds: Sequence[int]) -> Key[jax.Array, "B"]:
    """One key per seed."""
    with own_flags():
        return jax.random.wrap_key_data(seed_words(seeds), impl="threefry2x32")
