"""Relative navigation that goes quiet, and that has outliers: when, how often, and through every adapter."""

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from owm_envs import datasets
from owm_envs.config import load_config
from owm_envs.config.params import NavigationParams, params_from_config
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.physics import noise_scores, residuals
from owm_envs.datasets.verify import verify
from owm_envs.env import DockingEnv
from owm_envs.pettingzoo import parallel_env
from owm_envs.policies import make_policy
from owm_envs.rollout import episodes, rollout
from owm_envs.task.navigation import is_quiet, measure, outlier_factor
from owm_envs.view import View

QUIET = {"outage_duration": 1.0, "outage_share": 0.5}
HEAVY = {"outlier_share": 0.1, "outlier_scale": 10.0}
CONFIG = {"fidelity": "iss", "noise": "cooperative", "steps_per_action": 5, "horizon": 4.0, "navigation": QUIET}
ACTIONS = np.random.default_rng(0).uniform(-500, 500, (17, 6)).astype(np.float32)


def numbers(duration=10.0, share=0.3, outliers=0.0, scale=1.0):
    return NavigationParams(*map(jnp.float32, (duration, share, outliers, scale)))


@jax.jit
def quiet(navigation, times, keys):
    """(keys, times)."""
    return jax.vmap(lambda key: jax.vmap(lambda time: is_quiet(navigation, time, key=key))(times))(keys)


KEYS = jax.random.split(jax.random.key(5), 2000)
TIMES = np.float32(0.25) * np.arange(480)


@settings(max_examples=12, deadline=None)
@given(st.floats(0.1, 40.0), st.floats(0.0, 0.9))
def test_navigation_is_quiet_at_every_instant_with_the_probability_asked_for(duration, share):
    shares = np.asarray(quiet(numbers(duration, share), TIMES, KEYS)).mean(axis=0)
    # Five standard errors of 2000 episodes, over 480 instants.
    np.testing.assert_allclose(shares, share, atol=5 * np.sqrt(0.25 / len(KEYS)))
    assert abs(shares.mean() - share) < 5 * np.sqrt(0.25 / len(KEYS))


@pytest.mark.parametrize(("duration", "share"), [(1.0, 0.3), (5.0, 0.3), (10.0, 0.1), (10.0, 0.5), (30.0, 0.3)])
def test_outages_last_as_long_as_asked_for(duration, share):
    """Those that neither begin before the episode, nor end after it, nor follow one another at once."""
    times = np.float32(0.25) * np.arange(2880)
    seen = np.asarray(quiet(numbers(duration, share), times, KEYS[:50]))
    assert seen.mean() == pytest.approx(share, abs=0.05)
    lengths, gaps = [], []
    for row in seen:
        edges = np.flatnonzero(np.diff(row.astype(int)))
        runs = 0.25 * np.diff(edges)
        first = 0 if row[edges[0] + 1] else 1
        lengths += runs[first::2].tolist()
        gaps += runs[1 - first :: 2].tolist()
    lengths, gaps = np.array(lengths), np.array(gaps)
    assert np.median(np.abs(lengths - duration)) <= 0.25 and lengths.min() > duration - 0.26
    assert np.mean(np.abs(lengths - duration) <= 0.25) > 0.9
    assert gaps.mean() == pytest.approx(duration * (1 - share) / share, rel=0.1) and gaps.std() > 0.2 * gaps.mean()


def test_a_share_of_zero_is_a_number_like_others():
    assert not np.asarray(quiet(numbers(10.0, 0.0), TIMES, KEYS[:20])).any()


def test_outliers_are_as_frequent_and_as_heavy_as_asked_for(x64):
    """Share and kurtosis of a contaminated normal distribution: 3 (1 - p + p s^4) / (1 - p + p s^2)^2."""
    share, scale = 0.1, 5.0
    navigation, count = numbers(outliers=share, scale=scale), 40_000
    key = jax.random.key(2)
    factors = np.asarray(jax.jit(jax.vmap(lambda n: outlier_factor(navigation, key=key, count=n)))(jnp.arange(count)))
    assert set(np.unique(factors)) == {1.0, scale}
    assert np.mean(factors > 1) == pytest.approx(share, abs=5 * np.sqrt(share / count))
    noise = params_from_config(load_config(noise="cooperative")).noise
    view = jnp.asarray([60.0, -80.0, 0.0, 0, 0, 0, 0.5, -0.5, 0.5, 0.5, 0, 0, 0])

    def one(n):
        return measure(noise, View.of(view), None, outlier_factor(navigation, key=key, count=n), key=key, count=n)

    errors = np.asarray(jax.jit(jax.vmap(one))(jnp.arange(count)) - view)
    for part in (errors[:, :3], errors[:, 3:6], errors[:, 10:]):
        squares = np.mean(part**2)
        kurtosis = np.mean(part**4) / squares**2
        second, fourth = (1 - share + share * scale**power for power in (2, 4))
        assert kurtosis == pytest.approx(3 * fourth / second**2, rel=0.05)
    assert np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1))) == pytest.approx(0.05 * np.sqrt(second), rel=0.02)


@pytest.mark.parametrize(
    ("name", "value"),
    [("outage_share", 0.95), ("outage_share", -0.1), ("outage_duration", 0.0), ("outlier_share", 1.1)]
    + [("outlier_scale", 0.5), ("outlier_scale", np.inf)],
)
def test_numbers_that_cannot_be_are_refused(name, value):
    with pytest.raises(ValueError, match=f"navigation.{name}: must be"):
        load_config(navigation={name: value})


def flown(**navigation):
    """Observations, parts by name, and infos of a flight of the scalar environment."""
    env = gymnasium.make("ISS-v0", config=CONFIG | {"navigation": navigation})
    (observation, info), rows = env.reset(seed=5), []
    for action in ACTIONS:
        rows.append((observation if isinstance(observation, dict) else {"state": observation}, info))
        observation, *_, info = env.step(action)
    return rows


def test_a_quiet_navigation_holds_and_leaves_the_rest_as_it_was():
    plain, blind = flown(), flown(**QUIET)
    assert set(plain[0][0]) == {"state"} and set(blind[0][0]) == {"state", "state_valid"}
    held, quiet = None, 0
    for (sound, info), (shown, told) in zip(plain, blind, strict=True):
        np.testing.assert_array_equal(told["true_state"], info["true_state"])
        if shown["state_valid"][0]:
            np.testing.assert_array_equal(shown["state"], sound["state"])
            held = shown["state"], told["measured_state"]
        quiet += not shown["state_valid"][0]
        np.testing.assert_array_equal(shown["state"], held[0])
        np.testing.assert_array_equal(told["measured_state"], held[1])
        assert not any("valid" in name or "quiet" in name for name in told)
    assert blind[0][0]["state_valid"][0] and 3 <= quiet <= 14


def test_without_either_there_is_nothing_to_carry(x64):
    plain, spoiled = (DockingEnv(CONFIG | {"navigation": navigation}) for navigation in ({}, QUIET | HEAVY))
    assert plain.default_params().navigation is None and plain == DockingEnv({k: CONFIG[k] for k in list(CONFIG)[:-1]})
    assert set(plain.observation_parts) == {"state"} and plain != spoiled
    leaves = [len(jax.tree.leaves(env.default_params())) for env in (plain, spoiled)]
    assert leaves[1] - leaves[0] == 4


def test_other_numbers_are_no_other_program_and_outages_depend_on_the_seed_alone():
    one, two = (
        gymnasium.make_vec("ISS-v0", num_envs=4, config=CONFIG | {"navigation": QUIET | {"outage_share": share}})
        for share in (0.3, 0.6)
    )
    shares = []
    for env in (one, two):
        env.reset(seed=0)
        seen = [env.step(np.tile(action, (4, 1)))[0]["state_valid"] for action in ACTIONS[:14]]
        env.reset(seed=0)
        again = [env.step(0 * np.tile(action, (4, 1)))[0]["state_valid"] for action in ACTIONS[:14]]
        np.testing.assert_array_equal(seen, again, err_msg="what is done must not matter")
        shares.append(np.mean(seen))
    assert shares[0] > shares[1]
    assert one.unwrapped.traces is two.unwrapped.traces or one.unwrapped.traces == two.unwrapped.traces
    assert one.unwrapped.docking_env == two.unwrapped.docking_env and one.unwrapped.traces["step"] == 1


@pytest.mark.parametrize("mode", list(gymnasium.vector.AutoresetMode))
def test_slots_of_a_batch_are_scalar_environments(mode):
    """Two episodes on end of three slots, the second after an automatic reset or one by mask."""
    config = CONFIG | {"horizon": 1.5, "navigation": QUIET | HEAVY}
    envs = gymnasium.make_vec("ISS-v0", num_envs=3, config=config, autoreset_mode=mode)
    scalar = [gymnasium.make("ISS-v0", config=config) for _ in range(3)]
    observation, _ = envs.reset(seed=7)
    expected = [env.reset(seed=7 + slot)[0] for slot, env in enumerate(scalar)]
    quiet = []

    def same(slot, batch, one):
        quiet.append(not one["state_valid"][0])
        for name, value in one.items():
            np.testing.assert_array_equal(batch[name][slot], value, err_msg=name)

    for slot, one in enumerate(expected):
        same(slot, observation, one)
    ended = np.zeros(3, bool)
    for action in ACTIONS:
        if mode is gymnasium.vector.AutoresetMode.DISABLED and ended.any():
            observation, _ = envs.reset(options={"reset_mask": ended})
            for slot in np.flatnonzero(ended):
                same(slot, observation, scalar[slot].reset()[0])
        observation, _, terminated, truncated, info = envs.step(np.tile(action, (3, 1)))
        assert observation in envs.observation_space
        for slot, env in enumerate(scalar):
            if mode is gymnasium.vector.AutoresetMode.NEXT_STEP and ended[slot]:
                same(slot, observation, env.reset()[0])
                continue
            last = env.step(action)[0]
            if mode is gymnasium.vector.AutoresetMode.SAME_STEP and (terminated | truncated)[slot]:
                same(slot, info["final_obs"], last)
                last = env.reset()[0]
            same(slot, observation, last)
        ended = terminated | truncated
    assert 0.2 < np.mean(quiet) < 0.7


def test_each_chaser_of_a_fleet_is_blind_by_itself_and_to_the_others_too():
    env = parallel_env(2, config=CONFIG | {"navigation": QUIET | HEAVY})
    observations, _ = env.reset(seed=3)
    held, apart = {}, 0
    for action in ACTIONS[:15]:
        for agent, observation in observations.items():
            assert observation in env.observation_space(agent)
            if observation["state_valid"][0]:
                assert agent not in held or (observation["state"] != held[agent]).any()
                held[agent] = observation["state"]
            np.testing.assert_array_equal(observation["state"], held[agent])
        apart += len({bool(one["state_valid"][0]) for one in observations.values()}) == 2
        observations, *_ = env.step(dict.fromkeys(env.agents, action))
    assert apart and len(held) == 2


def test_pixels_alone_do_not_tell_whether_navigation_sees():
    config = load_config(CONFIG, observation="pixels", camera={"height": 8, "width": 8})
    assert set(DockingEnv(config).shown_parts) == {"pixels"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A dataset of both."""
    folder = tmp_path_factory.mktemp("navigation") / "set"
    bias = {"position": 0.05, "correlation_time": 2.0}
    config = load_config(CONFIG, horizon=20.0, noise={"bias": bias}, navigation=QUIET | HEAVY)
    generate(folder, config, Request(transitions=2000, val_transitions=100, seed=1, episodes_per_batch=8))
    return folder, config


@pytest.mark.slow
def test_a_dataset_keeps_when_navigation_was_quiet(recorded):
    folder, config = recorded
    read = list(datasets.read(folder, "train"))
    for episode in read:
        state, valid = episode.observation["state"], episode.observation["state_valid"][:, 0]
        assert valid.dtype == bool and valid[0] and (np.diff(state, axis=0) == 0).all(axis=1)[~valid[1:]].all()
        assert (np.diff(state, axis=0) != 0).any(axis=1)[valid[1:]].all()
    share = np.mean([~one.observation["state_valid"] for one in read if len(one) > 40])
    assert share == pytest.approx(0.5, abs=0.05)
    assert verify(folder).sound, verify(folder).wrong
    card = (folder / "README.md").read_text()
    assert "`observation.state_valid` is false" in card and "err 10 times as much" in card
    wrong = [residuals(dict(columns), load_config(config, navigation={"outlier_scale": 12.0})) for columns in [
        {"observation.state": one.observation["state"], "observation.environment_state": one.true_state,
         "observation.state_valid": one.observation["state_valid"]} for one in read]]  # fmt: skip
    assert np.abs(noise_scores(wrong)[1]).max() > 4, "noise of another size is noticed"


def test_pure_rollouts_hold_too():
    env = DockingEnv(CONFIG)
    keys = jax.random.split(jax.random.key(4), 3)
    for flight in episodes(rollout(env, make_policy("dock", env), keys, np.array([0, 1, 2]), chunk=16)):
        valid = flight.observation["state_valid"][:, 0]
        still = (np.diff(flight.observation["state"], axis=0) == 0).all(axis=1)
        np.testing.assert_array_equal(still, ~valid[1:])
        assert not valid.all()
