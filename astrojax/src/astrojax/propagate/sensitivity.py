"""How the end of a trajectory depends on its start and its parameters: derivatives of the integration itself."""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float, PyTree

from astrojax._types import Scalar
from astrojax.propagate.adaptive import Solution, integrate


def state_transition_matrix(
    f: Callable[..., Array], t0: Scalar, y0: Float[Array, "n"], t1: Scalar, *args: Any, **options: Any
) -> tuple[Solution, Float[Array, "n n"]]:
    """Solution at t1, and the derivative of its state by that at t0.

    Args:
        f, t0, y0, t1, args: as for `integrate`; y0 one array.
        options: as for `integrate`.

    Validity: exact for the steps that were taken, so as accurate as the solution; no variational equations are needed.
    """
    return _with_jacobian(lambda y: integrate(f, t0, y, t1, *args, **options), y0)


def parameter_sensitivity(
    f: Callable[..., Array], t0: Scalar, y0: Float[Array, "n"], t1: Scalar, parameters: PyTree, **options: Any
) -> tuple[Solution, PyTree]:
    """Solution at t1 of dy/dt = f(t, y, parameters), and the derivative of its state by each parameter.

    Args:
        f, t0, y0, t1: as for `integrate`; y0 one array.
        parameters: pytree of floating-point arrays.
        options: as for `integrate`.

    Returns:
        The solution, and a pytree like `parameters` of arrays (n, ...).
    """
    return _with_jacobian(lambda p: integrate(f, t0, y0, t1, p, **options), parameters)


def pullback(
    f: Callable[..., PyTree], t0: Scalar, y0: PyTree, t1: Scalar, *args: Any, max_steps: int = 256, **options: Any
) -> tuple[Solution, Callable[[PyTree], tuple]]:
    """Solution at t1, and the function from a covector of its state to those of (t0, y0, t1, *args): reverse mode.

    Args:
        f, t0, y0, t1, args: as for `integrate`; t0, t1 and args floating-point arrays, or pytrees of them.
        max_steps: static: as for `integrate`; each of them is stored.
        options: as for `integrate`.
    """

    def flow(t0, y0, t1, *args):
        solution = integrate(f, t0, y0, t1, *args, max_steps=max_steps, bounded=True, **options)
        return solution.y, solution

    _, back, solution = jax.vjp(flow, t0, y0, t1, *args, has_aux=True)
    return solution, back


def _with_jacobian(solve, x):
    def state(x):
        solution = solve(x)
        return solution.y, solution

    matrix, solution = jax.jacfwd(state, has_aux=True)(x)
    return solution, matrix
