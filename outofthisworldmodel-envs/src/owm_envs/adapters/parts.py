"""Observations by parts as Gymnasium shows them: an array where there is one part, a dict where there are several."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from gymnasium import spaces

Shown = np.ndarray | dict[str, np.ndarray]
"""What an adapter hands out."""


def space_of(parts: Mapping[str, jax.ShapeDtypeStruct]) -> spaces.Space:
    """The space of an observation: unbounded floats, integers of their type's whole range, truths as `MultiBinary`."""
    return shown({name: _box(part) for name, part in parts.items()}, spaces.Dict)


def shown(parts: Mapping[str, Any], several: Callable[[Mapping[str, Any]], Any] = dict) -> Any:
    """The only part, or `several` of them."""
    return several(parts) if len(parts) > 1 else next(iter(parts.values()))


def each(function: Callable[..., np.ndarray], *observations: Shown) -> Shown:
    """Apply a function part by part to observations of one kind."""
    first = observations[0]
    if isinstance(first, Mapping):
        return {name: function(*(one[name] for one in observations)) for name in first}
    return function(*observations)


def _box(part: jax.ShapeDtypeStruct) -> spaces.Space:
    if part.dtype == np.bool_:
        return spaces.MultiBinary(part.shape)
    if np.issubdtype(part.dtype, np.integer):
        limits = np.iinfo(part.dtype)
        return spaces.Box(limits.min, limits.max, part.shape, part.dtype.type)
    return spaces.Box(-np.inf, np.inf, part.shape, part.dtype.type)
