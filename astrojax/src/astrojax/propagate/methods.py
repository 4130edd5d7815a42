"""What the adaptive integrators share: an embedded method, and one step of it from a table of coefficients."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax._types import FloatScalar


class Step(NamedTuple):
    """One step tried.

    Attributes:
        y: (n,) state at its end.
        error: (n,) estimate of its error.
        last: (n,) derivative at its end, where the next step begins.
        bend: (n,) what the method's interpolant adds to the cubic through both ends, zero if it has none.
    """

    y: Float[Array, "n"]
    error: Float[Array, "n"]
    last: Float[Array, "n"]
    bend: Float[Array, "n"]


@dataclass(frozen=True)
class Method:
    """An embedded method: a static argument of the integrators, one instance a method.

    Attributes:
        name: of the method.
        order: of the solution that is carried on.
        error_order: of its error estimate: the estimate of one step goes with this power of it, plus one.
        step: gives a `Step` from the derivative f(t, y), the time, the state, the derivative there, and the step.
    """

    name: str
    order: int
    error_order: int
    step: Callable[[Callable, FloatScalar, Array, Array, FloatScalar], Step]


def weighted(weights: np.ndarray, ks: list[Array]) -> Array:
    """Sum of derivatives by their weights, those of weight zero left out."""
    total = None
    for weight, k in zip(weights, ks, strict=False):
        if weight:
            term = float(weight) * k
            total = term if total is None else total + term
    return jnp.zeros_like(ks[0]) if total is None else total


def runge_kutta_stages(
    f: Callable, t: FloatScalar, y: Array, first: Array, h: FloatScalar, nodes: np.ndarray, matrix: list[np.ndarray]
) -> list[Array]:
    """Derivatives at the stages of an explicit Runge-Kutta method.

    Args:
        first: derivative at the start.
        nodes: of the stages after the first; matrix: their rows.
    """
    ks = [first]
    for node, row in zip(nodes, matrix, strict=True):
        ks.append(f(t + float(node) * h, y + h * weighted(row, ks)))
    return ks
