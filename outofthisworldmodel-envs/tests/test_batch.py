"""A batch that is cut flies as one: pieces side by side, and packed on its way to the host."""

import os
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.adapters import batch
from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.adapters.packing import Packing
from owm_envs.station import PORT_NAMES
from owm_envs.task.events import Outcome

SHORT = {"fidelity": "iss", "noise": "cooperative", "horizon": 0.2}  # four steps an episode
SLOTS = 6
CHOSEN = (0, 2, 3, 5)  # either end of either piece
ACTIONS = np.random.default_rng(0).uniform(-300, 300, (10, SLOTS, 6)).astype(np.float32)


@pytest.fixture
def in_two(monkeypatch, quick):
    """Cuts every batch in two; what is compiled runs a few times only."""
    monkeypatch.setattr(batch, "piece_count", lambda num_envs, least: min(num_envs, 2))
    monkeypatch.setattr(batch, "compiler_options", lambda **_: quick.keywords["compiler_options"])
    batch._programs.cache_clear()
    yield
    batch._programs.cache_clear()  # tests of other files must not get these


@pytest.mark.slow
def test_slots_of_a_cut_batch_equal_scalar_environments(in_two):
    env = DockingVectorEnv(SLOTS, autoreset_mode="same_step", **SHORT)
    first, _ = env.reset(seed=7)
    steps = [env.step(actions) for actions in ACTIONS]
    assert env.traces["step"] == 1
    assert first.shape == steps[0][0].shape == env.observation_space.shape
    for slot in CHOSEN:
        scalar = DockingGymEnv(**SHORT)
        observation, _ = scalar.reset(seed=7 + slot)
        np.testing.assert_allclose(first[slot], observation, rtol=1e-6, atol=1e-6)
        for actions, (observations, rewards, _, truncations, infos) in zip(ACTIONS, steps):
            observation, reward, _, done, info = scalar.step(actions[slot])
            assert truncations[slot] == done
            assert rewards[slot] == pytest.approx(reward, rel=1e-9)
            assert infos.get("_final_obs", np.zeros(SLOTS, bool))[slot] == done
            if done:
                np.testing.assert_allclose(infos["final_obs"][slot], observation, rtol=1e-6, atol=1e-6)
                assert infos["final_info"]["outcome"][slot] == info["outcome"] == Outcome.TIMEOUT
                np.testing.assert_allclose(infos["final_info"]["true_state"][slot], info["true_state"], atol=1e-9)
                observation, info = scalar.reset()
            np.testing.assert_allclose(observations[slot], observation, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(infos["true_state"][slot], info["true_state"], atol=1e-9)
            assert infos["port"][slot] == info["port"]


def test_an_end_in_one_piece_only(in_two):
    env = DockingVectorEnv(SLOTS, autoreset_mode="same_step", **SHORT)
    env.reset(seed=7)
    broken = ACTIONS[0].copy()
    broken[4, 1] = np.nan
    with pytest.warns(UserWarning, match=r"slots \[4\]"):
        observation, _, _, truncated, info = env.step(broken)
    ended = np.arange(SLOTS) == 4
    np.testing.assert_array_equal(truncated, ended)
    np.testing.assert_array_equal(info["_final_obs"], ended)
    assert (
        info["final_info"]["outcome"][4] == Outcome.INVALID_ACTION
        and list(info["outcome"]) == [Outcome.RUNNING] * SLOTS
    )
    changed = (observation != info["final_obs"]).any(axis=1)
    np.testing.assert_array_equal(changed, ended)
    assert "final_obs" not in env.step(ACTIONS[1])[-1]


def test_a_mask_and_seeds_reach_across_pieces(in_two):
    env = DockingVectorEnv(SLOTS, autoreset_mode="same_step", **SHORT)
    env.reset(seed=7)
    before = env.step(ACTIONS[0])[0]
    mask = np.array([False, True, False, False, False, True])
    ports = [None, "zvezda_aft", None, None, None, "unity_nadir"]
    observation, info = env.reset(seed=[None] * 5 + [3], options={"reset_mask": mask, "dock_port": ports})
    np.testing.assert_array_equal(observation[~mask], before[~mask])
    assert [PORT_NAMES[port] for port in info["port"][mask]] == ["zvezda_aft", "unity_nadir"]
    scalar = DockingGymEnv(**SHORT)
    expected = scalar.reset(seed=3, options={"dock_port": "unity_nadir"})[0]
    np.testing.assert_allclose(observation[5], expected, rtol=1e-6, atol=1e-6)


def test_a_cut_batch_pickles(in_two, monkeypatch):
    env = DockingVectorEnv(SLOTS, autoreset_mode="same_step", **SHORT)
    env.reset(seed=7)
    env.step(ACTIONS[0])
    kept = pickle.dumps(env)
    again = pickle.loads(kept)
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(batch, "piece_count", lambda num_envs, least: 1)  # another machine
        whole = pickle.loads(kept)
    states = [jax.tree.leaves(e._program.to_host(e._state)) for e in (env, again, whole)]
    for leaves in zip(*states, strict=True):
        np.testing.assert_array_equal(leaves[0], leaves[1])
        np.testing.assert_array_equal(leaves[0], leaves[2])
    for actions in ACTIONS[1:6]:
        expected, *_ = env.step(actions)
        np.testing.assert_array_equal(again.step(actions)[0], expected)


def test_what_a_step_returns_is_the_callers(in_two):
    env = DockingVectorEnv(SLOTS, autoreset_mode="same_step", **SHORT)
    env.reset(seed=7)
    observation, *_, info = env.step(ACTIONS[0])
    kept, truth = observation.copy(), info["true_state"].copy()
    later = env.step(ACTIONS[1])[-1]
    np.testing.assert_array_equal(observation, kept)
    np.testing.assert_array_equal(info["true_state"], truth)
    info["true_state"][:] = np.nan
    assert np.isfinite(later["true_state"]).all() and np.isfinite(info["measured_state"]).all()


@pytest.mark.parametrize(
    ("cores", "num_envs", "pieces"),
    [(2, 256, 2), (2, 254, 1), (2, 257, 1), (4, 256, 2), (4, 1024, 4), (4, 384, 3), (1, 4096, 1), (3, 512, 2)],
)
def test_pieces_are_equal_and_worth_a_thread(monkeypatch, cores, num_envs, pieces):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(cores), raising=False)
    assert batch.piece_count(num_envs) == pieces


def test_an_accelerator_takes_the_batch_whole(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(8), raising=False)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert batch.piece_count(4096) == 1


def test_packing_gives_back_what_it_took(x64):
    generator = np.random.default_rng(0)
    tree = {
        "wide": generator.normal(size=(5, 3, 2)),
        "scalar": generator.normal(size=5),
        "narrow": (generator.normal(size=(5, 4)).astype(np.float32), np.arange(5, dtype=np.int32)),
        "flag": generator.random((5, 2)) < 0.5,
        "none": None,
        "empty": np.zeros((5, 0)),
        "word": generator.integers(0, 2**32, (5, 2), np.uint32),
    }
    packing = Packing()
    matrices = jax.device_get(jax.jit(packing.pack)(jax.tree.map(jnp.asarray, tree)))
    assert {name: m.shape for name, m in matrices.items()} == {
        "float64": (5, 7),
        "float32": (5, 4),
        "int32": (5, 1),
        "bool": (5, 2),
        "uint32": (5, 2),
    }
    again = packing.unpack(matrices)
    assert jax.tree.structure(again) == jax.tree.structure(tree)
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(tree)):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    twice = packing.unpack({name: np.concatenate([m, m]) for name, m in matrices.items()})  # pieces, joined
    np.testing.assert_array_equal(twice["wide"][5:], tree["wide"])
