import tracemalloc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_rotate
from owm_envs import rollout as module
from owm_envs.env import DockingEnv
from owm_envs.policies import make_policy
from owm_envs.rollout import Chunk, Decision, Frame, rollout
from owm_envs.rollout import episodes as whole
from owm_envs.task.events import Outcome

CHUNK = 16


@pytest.fixture(scope="module")
def flown(docking):
    with jax.enable_x64(True):
        env, params, *_ = docking(fidelity="iss-numerical")
        noise = DockingEnv(noise="cooperative").default_params().noise
        params = params._replace(noise=noise, horizon_steps=params.horizon_steps * 0 + 40)
    policies = [make_policy(name, env) for name in ("random", "dock")]
    keys = jax.random.split(jax.random.key(0), 4)
    ports, which = np.array([0, 3, 5, 7]), np.array([1, 0, 1, 0])
    episodes = list(whole(rollout(env, policies, keys, ports, which=which, params=params, chunk=CHUNK)))
    return env, params, policies, keys, ports, which, episodes


def test_an_episode_is_whole_and_says_what_it_was(flown):
    _, _, _, _, ports, which, episodes = flown
    for episode, port, choice in zip(episodes, ports, which):
        assert len(episode) == 40 and episode.outcome == Outcome.TIMEOUT
        assert episode.observation["state"].shape == episode.true_state.shape == (41, 13)
        assert episode.observation["state"].dtype == np.float32 and episode.true_state.dtype == np.float64
        assert episode.action.shape == (40, 6) and episode.reward.shape == (40,)
        assert np.flatnonzero(episode.done).tolist() == [39] and not episode.success.any()
        assert episode.port == port and episode.policy_name == ("random", "dock")[choice]
        assert episode.outcome_name == "timeout"
        seconds = episode.epoch @ [86_400.0, 1.0]
        np.testing.assert_allclose(seconds - seconds[0], 0.05 * np.arange(41), atol=2e-5)
        np.testing.assert_array_equal(episode.true_state[-1], episode.info["true_state"])
        noise = np.linalg.norm(episode.observation["state"][:, :3] - episode.true_state[:, :3], axis=1)
        assert 0.02 < np.sqrt(np.mean(noise**2)) < 0.09


def test_each_action_is_the_one_that_led_to_the_next_frame(flown):
    *_, episodes = flown
    for episode in episodes:
        attitude, force = jnp.asarray(episode.true_state[:-1, 6:10]), jnp.asarray(episode.action[:, :3])
        thrust = jax.vmap(quat_rotate)(attitude, force)
        gained = np.diff(episode.true_state[:, 3:6], axis=0)
        # Orbital terms are below 2e-3 m/s2, a neighbour's action would be off by 1e-3 m/s and more.
        np.testing.assert_allclose(gained, np.asarray(thrust) * 0.05 / 12_000.0, rtol=0, atol=2e-4)
        travelled = np.diff(episode.true_state[:, :3], axis=0)
        np.testing.assert_allclose(travelled, episode.true_state[:-1, 3:6] * 0.05, rtol=0, atol=4e-4)


def test_new_keys_ports_and_numbers_run_the_same_program(flown):
    env, params, policies, keys, _, which, _ = flown
    with jax.enable_x64(True):
        lighter = params._replace(chaser=params.chaser._replace(mass=params.chaser.mass * 0.9))
    before = module._fly._cache_size()
    chunks = rollout(env, policies, keys[::-1], np.array([1, 2, 4, 6]), which=which[::-1], params=lighter, chunk=CHUNK)
    assert sum(len(chunk.ended) for chunk in chunks) == 4
    assert module._fly._cache_size() == before


@pytest.fixture(scope="module")
def mixed():
    """Starts so near and tolerances so wide that dock succeeds within seconds, and random does not always."""
    config = {
        "reset": {"radius_min": 25.0, "radius_max": 30.0, "speed": 0.0, "rate": 0.0},
        "docking": {"position": 40.0, "speed": 5.0, "attitude_deg": 40.0, "rate_deg": 20.0},
        "collision_terminates": False,
        "reward": {"collision": 0.0},
        "horizon": 30.0,
        "steps_per_action": 10,
    }
    env = DockingEnv(config, fidelity="iss")
    policies = [make_policy(name, env) for name in ("dock", "random")]
    keys = jax.random.split(jax.random.key(2), 12)
    calls = []
    which = np.arange(12) % 2
    ports = np.arange(12) % 8
    progress = lambda *call: calls.append(call)
    episodes = list(whole(rollout(env, policies, keys, ports, which=which, chunk=CHUNK, progress=progress)))
    return env, policies, keys, ports, which, episodes, calls


def test_an_episode_does_not_depend_on_its_neighbours(mixed):
    env, policies, keys, ports, which, episodes, _ = mixed
    moved = list(whole(rollout(env, policies, keys[::-1], ports[::-1], which=which[::-1], chunk=CHUNK)))
    for one, other in zip(episodes, moved[::-1]):
        assert one.outcome == other.outcome and len(one) == len(other)
        np.testing.assert_array_equal(one.observation["state"], other.observation["state"])
        np.testing.assert_allclose(one.true_state, other.true_state, rtol=0, atol=1e-9)


def test_a_docked_episode_ends_there_while_others_fly_on(mixed):
    *_, episodes, calls = mixed
    docked = [episode for episode in episodes if episode.outcome == Outcome.DOCKED]
    assert docked and len({len(episode) for episode in episodes}) > 2
    for episode in docked:
        assert episode.success.tolist() == episode.done.tolist() == [False] * (len(episode) - 1) + [True]
        assert episode.reward[-1] > 9_000.0 > 1.0 > np.max(episode.reward[:-1], initial=-1.0)
        assert len(episode.true_state) == len(episode) + 1
    assert calls[-1][1] == 0 and calls[0][0] == CHUNK
    assert [running for _, running in calls] == sorted((running for _, running in calls), reverse=True)


@pytest.mark.parametrize("horizon", [40, 320])
def test_no_chunk_outlives_its_turn_however_long_the_episodes(flown, horizon):
    env, params, policies, keys, ports, which, _ = flown
    params = params._replace(horizon_steps=params.horizon_steps * 0 + horizon)
    chunks = rollout(env, policies, keys, ports, which=which, params=params, chunk=CHUNK)
    seen, most, length = [], 0, 0
    for chunk in chunks:
        seen.append(weakref.ref(chunk.frames.true_state))
        length += len(chunk.decisions.outcome)
        del chunk
        most = max(most, sum(ref() is not None for ref in seen))
    # The one that the iterator has just handed over, and none before it.
    assert length >= horizon and most <= 1


def made_up(slots: int, count: int, length: int = 10):
    """Chunks of flights with pictures of 12 kB a frame, all of which end in the last."""
    for number in range(count):
        frames = length + (number == 0)
        state = np.full((frames, slots, 13), number, np.float64)
        picture = np.full((frames, slots, 64, 64, 3), number, np.uint8)
        epoch = np.zeros((frames, slots, 2))
        frame = Frame({"state": state.astype(np.float32), "picture": picture}, state, epoch)
        outcome = np.zeros((length, slots), np.int32)
        outcome[-1] = Outcome.TIMEOUT * (number == count - 1)
        decisions = Decision(np.zeros((length, slots, 6)), np.zeros((length, slots)), outcome)
        ended = np.arange(slots * (number == count - 1))
        info = {"port": np.zeros(slots, np.int32), "goal_pose": np.zeros((slots, 7))}
        yield Chunk(frames=frame, decisions=decisions, ended=ended, stop=np.full(len(ended), length), info=info,
                    policy=np.zeros(slots, np.int32))  # fmt: skip


def test_what_is_set_aside_on_disk_comes_back(tmp_path):
    for one, other in zip(whole(made_up(3, 4)), whole(made_up(3, 4), spill=tmp_path), strict=True):
        assert len(one) == len(other) == 40 and one.observation["picture"].shape == (41, 64, 64, 3)
        jax.tree.map(np.testing.assert_array_equal, vars(one), vars(other))
    assert not list(tmp_path.iterdir())


def test_memory_is_one_chunk_and_one_episode(tmp_path):
    def peak(slots: int) -> float:
        """MB, of a recording of `slots` flights of 2.5 MB each."""
        tracemalloc.start()
        for episode in whole(made_up(slots, 20), spill=tmp_path):
            del episode
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most / 1e6

    few, many = peak(2), peak(16)
    chunk = (
        14 * 10 * 64 * 64 * 3 / 1e6
    )  # what a chunk of fourteen more slots holds, once in it and once while it is made
    assert many < few + 2.5 * chunk < 0.4 * 16 * 2.5


@pytest.mark.parametrize(
    ("ports", "which", "message"),
    [([0, 1], None, "must all have shape"), ([0, 1, 9], None, "from 0 to 7"), ([0, 1, 2], [0, 0, 1], "1 policies")],
)
def test_misuse_is_refused_by_name(flown, ports, which, message):
    env, _, policies, keys, *_ = flown
    with pytest.raises(ValueError, match=message):
        rollout(env, policies[0], keys[:3], ports, which=which)
