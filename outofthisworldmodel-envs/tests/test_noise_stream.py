import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.random import threefry_2x32
from scipy import stats

from owm_envs.task.noise_stream import box_muller, standard_normal, threefry2x32

COUNTS, SIZE = 20_000, 12
draws = jax.jit(jax.vmap(standard_normal, (None, 0, None, None)), static_argnums=(2, 3))


@pytest.fixture(scope="module")
def normals():
    """(counts, numbers) of one stream."""
    return np.asarray(draws(jax.random.key(20), jnp.arange(COUNTS, dtype=jnp.int32), SIZE, jnp.float32), np.float64)


@pytest.mark.parametrize("key", [(0, 0), (0xFFFFFFFF, 0xFFFFFFFF), (0x13198A2E, 0x03707344)])
def test_threefry_is_that_of_jax(key):
    generator = np.random.default_rng(1)
    extremes = np.array([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF], np.uint32)
    first, second = (np.concatenate([extremes, generator.integers(0, 2**32, 45, np.uint32)]) for _ in range(2))
    key = jnp.asarray(key, jnp.uint32)
    ours = jnp.concatenate(jax.jit(threefry2x32)(key, first, second))
    np.testing.assert_array_equal(ours, threefry_2x32(key, jnp.concatenate([first, second])))


def test_threefry_gives_the_published_answers():
    """Known-answer tests of the Random123 library, release 1.14 (kat_vectors, threefry2x32 with 20 rounds)."""
    ones = 0xFFFFFFFF
    for counter, key, expected in (
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((ones, ones), (ones, ones), (0x1CB996FC, 0xBB002BE7)),
        ((0x243F6A88, 0x85A308D3), (0x13198A2E, 0x03707344), (0xC4923A9C, 0x483DF7A0)),
    ):
        out = threefry2x32(jnp.asarray(key, jnp.uint32), *(jnp.uint32(word) for word in counter))
        assert tuple(map(int, out)) == expected


def test_normal(normals):
    numbers = normals.ravel()
    n = numbers.size
    assert abs(numbers.mean()) < 4 / np.sqrt(n)
    assert abs(numbers.var() - 1) < 4 * np.sqrt(2 / n)
    assert abs(stats.skew(numbers)) < 4 * np.sqrt(6 / n)
    assert abs(stats.kurtosis(numbers)) < 4 * np.sqrt(24 / n)
    assert stats.kstest(numbers, "norm").pvalue > 1e-3
    for slot in range(SIZE):  # cosines and sines alike
        assert stats.kstest(normals[:, slot], "norm").pvalue > 1e-3


@pytest.mark.parametrize("beyond", [2.0, 3.0, 4.0])
def test_tails(normals, beyond):
    for tail in (normals > beyond, normals < -beyond):
        expected = normals.size * stats.norm.sf(beyond)
        assert abs(tail.sum() - expected) < 4 * np.sqrt(expected)


def test_counts_slots_and_streams_are_independent(normals):
    bound = 5 / np.sqrt(COUNTS)
    other = np.asarray(draws(jax.random.key(21), jnp.arange(COUNTS, dtype=jnp.int32), SIZE, jnp.float32), np.float64)
    for power in (1, 2):  # the squares too: the two of a pair share their radius
        mine, its = normals**power, other**power
        together = np.corrcoef(mine.T)
        assert np.abs(together - np.eye(SIZE)).max() < bound
        for lag in (1, 2, 7):
            across = np.corrcoef(mine[:-lag].T, mine[lag:].T)[:SIZE, SIZE:]
            assert np.abs(across).max() < bound
        assert np.abs(np.corrcoef(mine.T, its.T)[:SIZE, SIZE:]).max() < bound


def test_deterministic_and_of_the_dtype_asked_for(normals):
    key = jax.random.key(20)
    one = jax.jit(standard_normal, static_argnums=(2, 3))
    narrow = one(key, 5, SIZE, jnp.float32)
    assert narrow.dtype == jnp.float32
    np.testing.assert_array_equal(narrow, one(key, jnp.asarray(5, jnp.int32), SIZE, jnp.float32))
    np.testing.assert_allclose(narrow, normals[5], rtol=0, atol=2e-6)
    with jax.enable_x64(True):
        wide = one(key, 5, SIZE, jnp.float64)
    assert wide.dtype == jnp.float64
    np.testing.assert_array_equal(wide, np.asarray(narrow, np.float64))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_finite_at_every_extreme_of_the_bits(dtype, x64):
    words = np.array([0, 1, 255, 256, 2**29, 2**31 - 1, 2**31, 2**32 - 257, 2**32 - 256, 2**32 - 1], np.uint32)
    radius, angle = (grid.ravel() for grid in np.meshgrid(words, words))
    out = np.asarray(jax.jit(box_muller, static_argnums=2)(radius, angle, dtype))
    assert out.dtype == dtype and np.isfinite(out).all()
    assert 5.8 < np.abs(out).max() < 5.9  # 2**29 points along an axis
    assert np.abs(out[: radius.size][radius == 2**32 - 1]).max() < 1e-3  # the other end: next to nothing
