"""A second sensor, a small range finder, through every adapter, policy and file: none of them knows of it."""

import json
import pickle

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
from small_sensors import CONFIG, LIMIT, PARTS, SENSORS, Patch, RangeFinder

from owm_envs import datasets
from owm_envs.config import load_config
from owm_envs.datasets.generate import Request, generate
from owm_envs.env import DockingEnv
from owm_envs.pettingzoo import parallel_env
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.rollout import episodes, rollout
from owm_envs.view import View


def make(**kwargs):
    return gymnasium.make("ISS-v0", config=CONFIG, sensors=SENSORS, **kwargs)


def flown(env, seed, actions):
    """Observations and true distances of a flight."""
    observation, info = env.reset(seed=seed)
    seen, truth = [observation], [np.linalg.norm(View.of(info["true_state"]).position)]
    for action in actions:
        observation, _, terminated, truncated, info = env.step(action)
        seen.append(observation)
        truth.append(np.linalg.norm(View.of(info["true_state"]).position))
        if terminated or truncated:
            break
    return seen, np.array(truth)


ACTIONS = np.random.default_rng(0).uniform(-500, 500, (10, 6)).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_a_range_finder_measures_holds_and_misses(seed):
    env = make()
    assert {name: space.shape for name, space in env.observation_space.items()} == PARTS
    seen, truth = flown(env, seed, ACTIONS)
    assert len(seen) == 11
    held = np.float32(0)
    for count, (observation, distance) in enumerate(zip(seen, truth)):
        assert observation in env.observation_space
        valid = count % 2 == 0 and distance < LIMIT
        assert observation["range_valid"].tolist() == [valid]
        if valid:
            assert 1e-6 < abs(observation["range"][0] - distance) < 0.6
            assert observation["range"][0] != held
            held = observation["range"][0]
        assert observation["range"][0] == held
        assert observation["patch"][1].tolist() == [count] * 3
    starts = {seed: flown(env, seed, [])[1][0] < LIMIT for seed in range(8)}
    assert set(starts.values()) == {True, False}, "both kinds of starts are among these seeds"


def test_a_sensor_changes_nothing_but_its_own_parts():
    alone = gymnasium.make("ISS-v0", config=CONFIG)
    plain, _ = flown(alone, 5, ACTIONS)
    seen, _ = flown(make(), 5, ACTIONS)
    assert isinstance(alone.observation_space, gymnasium.spaces.Box)
    np.testing.assert_array_equal([one["state"] for one in seen], plain)


@pytest.mark.parametrize("mode", list(gymnasium.vector.AutoresetMode))
def test_slots_of_a_batch_are_scalar_environments(mode):
    """Two episodes on end of three slots, the second after an automatic reset or one by mask."""
    envs = gymnasium.make_vec("ISS-v0", num_envs=3, config=CONFIG, sensors=SENSORS, autoreset_mode=mode)
    scalar = [make() for _ in range(3)]
    observation, _ = envs.reset(seed=7)
    assert observation in envs.observation_space
    expected = [env.reset(seed=7 + slot)[0] for slot, env in enumerate(scalar)]

    def same(slot, batch, one):
        for name, value in one.items():
            np.testing.assert_array_equal(batch[name][slot], value, err_msg=name)

    for slot, one in enumerate(expected):
        same(slot, observation, one)
    ended = np.zeros(3, bool)
    for action in np.concatenate([ACTIONS, ACTIONS]):
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


def test_each_chaser_of_a_fleet_has_the_sensors():
    env = parallel_env(2, config=CONFIG, sensors=(RangeFinder(limit=1e9), Patch()))
    observations, infos = env.reset(seed=3)
    for agent, observation in observations.items():
        assert observation in env.observation_space(agent)
        assert observation["state"].shape == (31,) and (observation["patch"][0] == infos[agent]["port"]).all()
    observations, *_ = env.step({agent: ACTIONS[0] for agent in env.agents})
    assert [observation["range_valid"].tolist() for observation in observations.values()] == [[False]] * 2
    assert not np.array_equal(observations["chaser_0"]["range"], observations["chaser_1"]["range"])


def test_an_environment_with_sensors_pickles():
    env = make().unwrapped
    env.reset(seed=1)
    copy = pickle.loads(pickle.dumps(env))
    one, two = env.step(ACTIONS[0])[0], copy.step(ACTIONS[0])[0]
    for name in PARTS:
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A dataset recorded with the sensors."""
    folder = tmp_path_factory.mktemp("parts") / "set"
    request = Request(transitions=30, val_transitions=10, seed=1, episodes_per_batch=2)
    generate(folder, load_config(CONFIG), request, sensors=SENSORS)
    return folder


@pytest.mark.slow
def test_a_dataset_keeps_the_parts(recorded):
    info = json.loads((recorded / "train/meta/info.json").read_text())
    features = {name: info["features"][f"observation.{name}"] for name in PARTS}
    assert features["patch"] == {"dtype": "uint8", "shape": [2, 3], "names": None}
    assert features["range_valid"] == {"dtype": "bool", "shape": [1], "names": None}
    for episode in datasets.read(recorded, "train"):
        shapes = {name: (values.shape[1:], values.dtype.name) for name, values in episode.observation.items()}
        assert shapes["patch"] == ((2, 3), "uint8") and shapes["range"] == ((1,), "float32")
        assert shapes["state"] == ((13,), "float32") and shapes["range_valid"] == ((1,), "bool")
        assert (episode.observation["patch"][:, 0] == episode.port).all()
        assert episode.observation["patch"][:, 1, 0].tolist() == list(range(len(episode) + 1))
        assert not episode.observation["range_valid"][1::2].any()
    schema = pq.read_schema(next((recorded / "train/data").rglob("*.parquet")))
    assert str(schema.field("observation.patch").type).count("fixed_size_list") == 2
    statistics = datasets.read_statistics(recorded, "train")
    assert statistics["observation.patch"]["max"].shape == (6,)
    assert "observation.range_valid" in (recorded / "README.md").read_text()


@pytest.mark.slow
def test_recorded_parts_are_those_of_the_rollout(recorded):
    """Byte for byte what the pure environment shows."""
    env = DockingEnv(load_config(CONFIG), sensors=SENSORS)
    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.fold_in(jax.random.key(np.uint32(1)), 1), i))(jnp.arange(2))
    first = datasets.read(recorded, "val")
    with jax.enable_x64(True):
        flights = episodes(rollout(env, make_policy("dock", env), keys, np.array([e.port for e in first[:2]])))
        for one, two in zip(first, flights):
            for name in PARTS:
                np.testing.assert_array_equal(one.observation[name], two.observation[name], err_msg=name)


def test_a_policy_flies_on_dicts():
    envs = gymnasium.make_vec("ISS-v0", num_envs=3, config=CONFIG, sensors=SENSORS)
    plain = gymnasium.make_vec("ISS-v0", num_envs=3, config=CONFIG)
    policies = [VectorPolicy(make_policy("dock", env.unwrapped.docking_env)) for env in (envs, plain)]
    (observation, info), (array, _) = envs.reset(seed=0), plain.reset(seed=0)
    for policy in policies:
        policy.reset(ports=info["port"])
    np.testing.assert_array_equal(policies[0].predict(observation)[0], policies[1].predict(array)[0])


@pytest.mark.parametrize(
    "sensors, says",
    [
        ((RangeFinder(), RangeFinder()), "two parts of the observation are called 'range'"),
        ((RangeFinder(name="state"),), "two parts of the observation are called 'state'"),
        ((RangeFinder(name="my range"),), "must be a Python identifier, got 'my range'"),
        ((RangeFinder(every=0),), "every must be at least 1"),
        ((RangeFinder,), "is a class, not an instance"),
        (("range",), "lacks name, shape"),
    ],
)
def test_sensors_that_cannot_be(sensors, says):
    with pytest.raises((TypeError, ValueError), match=says):
        DockingEnv(CONFIG, sensors=sensors)


def test_a_sensor_measures_what_it_declares():
    env = gymnasium.make("ISS-v0", config=CONFIG, sensors=(RangeFinder(dtype="float64"),))
    with pytest.raises(ValueError, match=r"sensor 'range' declares \(\) float64, but measures \(\) float32"):
        env.reset(seed=0)
