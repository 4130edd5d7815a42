"""Actions as they are given, refused where they are no real numbers of the right shape."""

from typing import Any

import jax
import numpy as np


def real_numbers(given: Any, shape: tuple[int, ...], what: str = "action") -> np.ndarray:
    """An action as an array of this shape.

    Args:
        given: anything that NumPy makes an array of.
        what: it is called.

    Raises:
        ValueError: it holds other than real numbers, masks some, or has another shape.
    """
    parts = given if isinstance(given, list | tuple) else [given]
    if any(np.ma.is_masked(part) for part in parts):
        raise ValueError(f"{what} must not be masked: fill in what is missing")
    try:
        action = np.asarray(given)
    except ValueError:  # rows of several lengths
        action = np.zeros(0, object)
    if not any(jax.dtypes.issubdtype(action.dtype, kind) for kind in (np.floating, np.integer)):
        raise ValueError(f"{what} must be real numbers of shape {shape}, got {action.dtype}")
    if action.shape != shape:
        raise ValueError(f"{what} must have shape {shape}, got {action.shape}")
    return action
