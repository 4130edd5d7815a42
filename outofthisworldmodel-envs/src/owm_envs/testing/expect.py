"""How a check fails: one line that names it, what was expected and what came."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def expect(passed: Any, check: str, expected: str, came: Any) -> None:
    """Raise AssertionError, on one line, unless a check has passed."""
    if not bool(passed):
        raise AssertionError(" ".join(f"{check}: expected {expected}, got {came}".split()))


def alike(one: Any, other: Any) -> bool:
    """Whether two trees of one structure hold the same arrays."""
    return jax.tree.all(jax.tree.map(np.array_equal, one, other))


def outline(name: str, function: Callable[..., Any], *given: Any) -> Any:
    """Shapes and types of what a function of one's own gives, by abstract evaluation.

    Raises:
        AssertionError: it cannot be traced.
    """
    try:
        return jax.eval_shape(function, *given)
    except jax.errors.JAXTypeError as error:  # Python's `if`, `float()` or NumPy on a traced value
        raise AssertionError(f"jit: expected {name} to be traceable, got {str(error).splitlines()[0]}") from error
