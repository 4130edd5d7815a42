"""Compute only where it is needed, in a batch: `where` computes everywhere, `cond` everywhere or nowhere."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree


def apply_where(mask: Bool[Array, "B"], fn: Callable[..., PyTree], otherwise: PyTree, *args: PyTree, chunk: int = 16):
    """The results of `fn` where `mask` holds, and `otherwise` elsewhere.

    Args:
        mask: (B,).
        fn: from `args` to results, for one example; called for `chunk` of the chosen examples at a time.
        otherwise: results of all examples, with leading axis B.
        args: arrays with leading axis B.
        chunk: at most so many at a time.
    """
    size = mask.shape[0]
    chunk = min(chunk, size)
    count = jnp.sum(mask, dtype=jnp.int32)

    def chosen(results):
        everyone = jnp.arange(size, dtype=jnp.int32)
        place = jnp.cumsum(mask, dtype=jnp.int32) - 1
        order = (
            jnp.full(size + chunk, size, jnp.int32).at[jnp.where(mask, place, size + chunk)].set(everyone, mode="drop")
        )

        def step(carry):
            done, results = carry
            index = jax.lax.dynamic_slice(order, (done,), (chunk,))
            picked = jax.tree.map(lambda x: x.at[index].get(mode="clip"), args)
            fresh = jax.vmap(fn)(*picked)
            results = jax.tree.map(lambda all_, new: all_.at[index].set(new, mode="drop"), results, fresh)
            return done + chunk, results

        return jax.lax.while_loop(lambda carry: carry[0] < count, step, (jnp.zeros((), jnp.int32), results))[1]

    return jax.lax.cond(count > 0, chosen, lambda results: results, otherwise)
