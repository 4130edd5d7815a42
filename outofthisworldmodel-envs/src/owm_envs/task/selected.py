"""Compute only where it is needed, in a batch: `where` computes everywhere, `cond` everywhere or nowhere."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree


def apply_where(
    mask: Bool[Array, "B"], fn: Callable[..., PyTree], otherwise: PyTree, *args: PyTree, chunk: int | None = 16
) -> PyTree:
    """The results of `fn` where `mask` holds, and `otherwise` elsewhere.

    Args:
        mask: (B,).
        fn: from `args` to results, for one example; called for `chunk` of the chosen examples at a time.
        otherwise: results of all examples, with leading axis B.
        args: arrays with leading axis B.
        chunk: at most so many at a time; None for one that is no batch of one, so that no batch changes a rounding.
    """
    size = mask.shape[0]
    alone, chunk = chunk is None, min(chunk or 1, size)

    def step(carry):
        # A loop, not a conditional: XLA copies what passes through a branch.
        due, results = carry
        place = jnp.cumsum(due, dtype=jnp.int32) - 1
        slot = jnp.where(due & (place < chunk), place, chunk)
        index = jnp.full(chunk, size, jnp.int32).at[slot].set(jnp.arange(size, dtype=jnp.int32), mode="drop")
        picked = jax.tree.map(lambda x: x.at[index].get(mode="clip"), args)
        if alone:
            fresh = jax.tree.map(lambda x: x[None], fn(*jax.tree.map(lambda x: x[0], picked)))
        else:
            fresh = jax.vmap(fn)(*picked)
        results = jax.tree.map(lambda everyone, new: everyone.at[index].set(new, mode="drop"), results, fresh)
        return due & (place >= chunk), results

    return jax.lax.while_loop(lambda carry: jnp.any(carry[0]), step, (mask, otherwise))[1]
