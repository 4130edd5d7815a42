"""The caller's JAX flags are his own: adapters run under any of them, and the same numbers come out."""

import gymnasium
import jax
import numpy as np
import pytest

from owm_envs.pettingzoo import parallel_env
from owm_envs.policies import VectorPolicy, make_policy

FLAGS = {
    "numpy_dtype_promotion": "strict",
    "numpy_rank_promotion": "raise",
    "transfer_guard": "disallow",
    "debug_nans": True,
    "enable_x64": True,
}


def flown():
    """What each adapter shows after a reset and a step, and what a policy answers."""
    seen = []
    scalar = gymnasium.make("ISSHCW-v0", noise="cooperative")
    vector = gymnasium.make_vec("ISSHCW-v0", num_envs=2, noise="cooperative")
    for env in (scalar, vector):
        first, _ = env.reset(seed=0)
        second, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
        seen += [first, second]
    fleet = parallel_env(2, fidelity="iss-hcw", noise="cooperative")
    seen += fleet.reset(seed=0)[0].values()
    seen += fleet.step({agent: np.zeros(6) for agent in fleet.agents})[0].values()
    policy = VectorPolicy(make_policy("dock", vector.unwrapped.docking_env))
    policy.reset(ports=[0, 1])
    return [*seen, policy.predict(seen[3])[0]]


@pytest.fixture(scope="module")
def usual():
    return flown()


@pytest.mark.slow
@pytest.mark.parametrize("flag", FLAGS)
def test_adapters_fly_under_the_caller_s_flags(flag, usual):
    before = jax.config.values["jax_" + flag]
    jax.config.update("jax_" + flag, FLAGS[flag])  # for every thread, as a caller would
    try:
        for ours, expected in zip(flown(), usual, strict=True):
            np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-5)
        assert jax.config.values["jax_" + flag] == FLAGS[flag]
    finally:
        jax.config.update("jax_" + flag, before)
