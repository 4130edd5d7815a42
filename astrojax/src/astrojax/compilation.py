"""What XLA should do with a long chain of elementwise operations: keep the results that many read."""

import functools
import operator
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree, Shaped

CPU_OPTIONS: dict[str, bool | str] = {
    "xla_disable_hlo_passes": "cse_barrier_expander,small-while-loop-hoisting",
    "xla_cpu_multi_thread_eigen": False,
}
"""With `jax.jit(..., compiler_options=CPU_OPTIONS)` XLA heeds `stored` on the CPU, where it would drop it before it
matters, and runs every operation on the calling thread: two programs side by side keep two cores busier than one that
splits each of its short loops between them. A loop of few bytes must not become one kernel: those know no barrier."""


def stored(x: PyTree) -> PyTree:
    """The same arrays, computed once: a hint not to repeat their computation in the loop of each reader."""
    return jax.lax.optimization_barrier(x)


def summed(terms: Shaped[ArrayLike, "N ..."] | Sequence[ArrayLike]) -> Array | np.ndarray | np.generic:
    """Sum over a short first axis, written out: XLA fuses additions with their neighbours, but not a reduction."""
    return functools.reduce(operator.add, terms)


def all_of(conditions: Shaped[ArrayLike, "N ..."]) -> Array | np.ndarray | np.generic:
    """Whether all along a short first axis hold, written out as `summed` is."""
    return functools.reduce(operator.and_, conditions)


def compiler_options(*, libraries: bool = True) -> dict[str, bool | str] | None:
    """`CPU_OPTIONS` where JAX computes on the CPU, None elsewhere: for `jax.jit`'s argument of that name.

    Args:
        libraries: let libraries compute sums and matrix products; without them a network of small matrices takes half
            the time, for they hand each over to threads of their own.
    """
    if jax.default_backend() != "cpu":
        return None
    return CPU_OPTIONS if libraries else CPU_OPTIONS | _no_libraries()


@functools.cache
def _no_libraries() -> dict[str, str]:
    """The option that leaves all to XLA itself, if this version of it has it."""
    option = {"xla_cpu_experimental_ynn_fusion_type": ""}
    try:
        jax.jit(lambda x: x, compiler_options=option).lower(np.float32(0)).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return option
