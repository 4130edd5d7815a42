"""JAX's flags while programs of ours run: their own, whatever the caller's are."""

from collections.abc import Iterator
from contextlib import contextmanager

import jax


@contextmanager
def own_promotion() -> Iterator[None]:
    """Run a block, or as `@own_promotion()` a function, under JAX's usual promotion rules whatever the caller's are."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@contextmanager
def own_flags(x64: bool = True) -> Iterator[None]:
    """Run a block, in this thread, in 64-bit mode or not, under the promotion rules that our programs are written for.

    Without effect on the caller: strict promotion, guarded transfers and the search for NaN hold for his own code.
    """
    with (
        jax.enable_x64(x64),
        own_promotion(),
        jax.transfer_guard("allow"),
        jax.debug_nans(False),
    ):
        yield
