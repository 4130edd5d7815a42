import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from owm_envs.task.selected import apply_where

SIZES = ((1, 16), (7, 3), (23, 4))
"""Of a batch and of a chunk."""


def everything(key, x, table):
    """Results of several types from arguments of several: a new key, a vector, a count, a flag."""
    vector = jnp.stack([x, x * x, jnp.sin(x)])
    return {"key": jax.random.fold_in(key, 1), "pair": (vector, jnp.sum(table)), "sign": x > 0}


@functools.cache
def sample(size):
    """Arguments of `everything` for a batch, and what stands in where it is not to be computed."""
    keys = jax.random.split(jax.random.key(0), size)
    x = jnp.linspace(-1, 1, size, dtype=jnp.float32)
    table = jnp.arange(4 * size, dtype=jnp.int32).reshape(size, 2, 2)
    otherwise = {
        "key": jax.random.split(jax.random.key(9), size),
        "pair": (jnp.full((size, 3), -5, jnp.float32), jnp.full(size, -7, jnp.int32)),
        "sign": jnp.zeros(size, bool),
    }
    return (keys, x, table), otherwise


def raw(tree):
    """Typed keys as numbers."""
    return jax.tree.map(lambda x: jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x, tree)


def same(one, other):
    jax.tree.map(np.testing.assert_array_equal, raw(one), raw(other))


@jax.jit
def full(mask, otherwise, args):
    """The reference: compute everywhere, then choose."""
    return jax.vmap(lambda m, new, old: jax.tree.map(lambda n, o: jnp.where(m, n, o), new, old))(
        mask, jax.vmap(everything)(*args), otherwise
    )


partly = jax.jit(
    lambda mask, otherwise, args, chunk: apply_where(mask, everything, otherwise, *args, chunk=chunk),
    static_argnames="chunk",
)


@settings(max_examples=50, deadline=None)
@given(sizes=st.sampled_from(SIZES), data=st.data())
def test_equals_computing_everywhere(sizes, data):
    size, chunk = sizes
    some = st.lists(st.booleans(), min_size=size, max_size=size)
    mask = data.draw(st.one_of(st.just([False] * size), st.just([True] * size), some))
    args, otherwise = sample(size)
    same(partly(np.array(mask), otherwise, args, chunk), full(np.array(mask), otherwise, args))


def test_nested_vmap():
    args, otherwise = jax.tree.map(lambda x: x.reshape(3, 7, *x.shape[1:]), sample(21))
    masks = np.random.default_rng(0).random((3, 7)) < np.array([[0.0], [0.5], [1.0]])
    nested = jax.jit(jax.vmap(lambda m, o, a: apply_where(m, everything, o, *a, chunk=4)))(masks, otherwise, args)
    for i in range(3):
        row = jax.tree.map(lambda x, i=i: x[i], (otherwise, args))
        same(jax.tree.map(lambda x, i=i: x[i], nested), full(masks[i], *row))


@pytest.mark.slow
@pytest.mark.parametrize(("chosen", "calls"), [(0, 0), (1, 1), (4, 1), (5, 2), (23, 6)])
def test_no_more_than_what_is_asked_for_is_computed(chosen, calls):
    seen = []

    def counted(x):
        jax.debug.callback(seen.append, x)
        return x + 1

    x = jnp.arange(23, dtype=jnp.float32)
    out = jax.jit(lambda mask: apply_where(mask, counted, -x, x, chunk=4))(np.arange(23) >= 23 - chosen)
    jax.effects_barrier()
    assert len(seen) == 4 * calls
    np.testing.assert_array_equal(out, np.where(np.arange(23) >= 23 - chosen, x + 1, -x))
