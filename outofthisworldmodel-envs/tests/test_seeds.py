"""A seed is any integer from zero on, in every adapter, and all its bits count."""

import numpy as np
import pytest

from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.adapters.seeds import seed_words
from owm_envs.pettingzoo import parallel_env

SIMPLE = {"fidelity": "iss", "ports": ["zvezda_aft", "unity_nadir"]}


def scalar():
    env = DockingGymEnv(**SIMPLE)
    return env, lambda seed: env.reset(seed=seed)[0]


def vector():
    env = DockingVectorEnv(2, **SIMPLE)
    return env, lambda seed: env.reset(seed=seed)[0][0]


def pettingzoo():
    env = parallel_env(2, **SIMPLE)
    return env, lambda seed: env.reset(seed=seed)[0]["chaser_0"]


@pytest.mark.parametrize("adapter", [scalar, vector, pettingzoo])
def test_every_bit_counts_and_numpy_s_integers_do(adapter):
    _, start = adapter()
    starts = [start(seed) for seed in (0, 1, 2**32, 2**63, 2**64, 2**64 + 1, 2**96, 2**128)]
    for i, one in enumerate(starts):
        assert all(not np.array_equal(one, other) for other in starts[:i])
    np.testing.assert_array_equal(start(3), start(np.int64(3)))
    np.testing.assert_array_equal(start(3), start(np.uint8(3)))


@pytest.mark.parametrize("adapter", [scalar, vector, pettingzoo])
@pytest.mark.parametrize(("seed", "error"), [(-1, ValueError), (1.7, TypeError), ("3", TypeError), (True, TypeError)])
def test_what_is_no_seed_is_refused_by_name(adapter, seed, error):
    _, start = adapter()
    with pytest.raises(error, match="seed must be an integer of at least 0"):
        start(seed)


@pytest.mark.parametrize(("seed", "error"), [(-1, ValueError), (1.7, TypeError), ("3", TypeError), (True, TypeError)])
def test_what_is_no_seed_is_refused_in_a_list_too(seed, error):
    with pytest.raises(error, match="seed must be an integer of at least 0"):
        vector()[0].reset(seed=[0, seed])


@pytest.mark.parametrize("adapter", [scalar, vector])
def test_the_seed_that_an_environment_reports_names_its_episode(adapter):
    env, start = adapter()
    first = start(None)
    np.testing.assert_array_equal(start(env.np_random_seed), first)


def test_a_slot_s_large_seed_is_the_scalar_environment_s():
    _, slot = vector()
    _, alone = scalar()
    np.testing.assert_array_equal(slot(2**64 + 5), alone(2**64 + 5))


def test_small_seeds_keep_their_words():
    np.testing.assert_array_equal(seed_words([5, 2**32 + 7, 2**64 - 1]), [[0, 5], [1, 7], [2**32 - 1] * 2])
