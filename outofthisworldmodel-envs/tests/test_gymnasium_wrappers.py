"""Gymnasium's own wrappers, vectorisers and specs over the adapters; RecordVideo is in `tests_sb3`, for its weight."""

import copy
import json

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers

import owm_envs  # noqa: F401 - registers the ids
from owm_envs.task.events import Outcome

ID = "ISSHCW-v0"
SHORT = {"noise": "cooperative", "horizon": 0.2}  # four steps an episode
MODES = [mode.name.lower() for mode in AutoresetMode]
STEPS = 11  # two episodes and part of a third, in every mode
UNIT = np.float32(-1), np.float32(1)
RNG = np.random.default_rng(0)
ACTIONS = (RNG.uniform(-1, 1, (STEPS, 2, 6)) * ([1600] * 3 + [2000] * 3)).astype(np.float32)


def scalar(**kwargs):
    return gymnasium.make(ID, **{**SHORT, **kwargs})


def native(mode="next_step", **kwargs):
    return gymnasium.make_vec(ID, num_envs=2, autoreset_mode=mode, **{**SHORT, **kwargs})


def reset_if_waiting(env, ended):
    """What a loop over an environment that does not reset itself has to do."""
    if env.metadata["autoreset_mode"] == AutoresetMode.DISABLED and ended.any():
        env.reset(options={"reset_mask": ended})


def flown(env, actions=ACTIONS):
    """Every return of `step` from seed 0."""
    env.reset(seed=0)
    returns = []
    for action in actions:
        returns.append(env.step(action))
        reset_if_waiting(env, returns[-1][2] | returns[-1][3])
    return returns


SCALAR = {
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "TimeLimit": lambda env: wrappers.TimeLimit(env, 3),
    "RescaleAction": lambda env: wrappers.RescaleAction(env, *UNIT),
    "ClipAction": wrappers.ClipAction,
    "NormalizeObservation": wrappers.NormalizeObservation,
    "NormalizeReward": wrappers.NormalizeReward,
    "FlattenObservation": wrappers.FlattenObservation,
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 2),
    "TimeAwareObservation": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 4)),
    "TransformReward": lambda env: wrappers.TransformReward(env, lambda reward: reward / 2),
    "Autoreset": wrappers.Autoreset,
}


@pytest.mark.parametrize("name", SCALAR)
def test_scalar_wrappers_keep_to_their_spaces(name):
    env = SCALAR[name](scalar())
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    env.action_space.seed(0)
    for _ in range(3):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space and np.isfinite(observation).all() and np.isfinite(reward)
    assert not terminated and truncated == (name == "TimeLimit")
    assert info["outcome"] == Outcome.RUNNING


@pytest.mark.filterwarnings("ignore::UserWarning")  # that it is wrapped, and unbounded
def test_wrapped_environments_pass_gymnasium_s_check():
    check_env(wrappers.FlattenObservation(wrappers.RescaleAction(scalar(), *UNIT)), skip_render_check=True)


def test_scalar_wrappers_do_what_they_say():
    plain, half = scalar(), wrappers.TransformReward(scalar(), lambda reward: reward / 2)
    fractions = wrappers.RescaleAction(scalar(), *UNIT)
    monitored = wrappers.RecordEpisodeStatistics(scalar())
    for env in (plain, half, fractions, monitored):
        env.reset(seed=0)
    total = 0.0
    for _ in range(4):
        observation, reward, *_ = plain.step(np.array([800, 0, 0, 0, 0, -2000], np.float32))
        total += reward
        scaled = fractions.step(np.array([0.5, 0, 0, 0, 0, -1], np.float32))
        np.testing.assert_allclose(scaled[0], observation, rtol=1e-6, atol=1e-6)
        assert half.step(np.array([800, 0, 0, 0, 0, -2000], np.float32))[1] == pytest.approx(reward / 2)
        info = monitored.step(np.array([800, 0, 0, 0, 0, -2000], np.float32))[4]
    assert info["episode"]["r"] == pytest.approx(total, rel=1e-6) and info["episode"]["l"] == 4


VECTOR = {
    "RecordEpisodeStatistics": vector_wrappers.RecordEpisodeStatistics,
    "NormalizeObservation": vector_wrappers.NormalizeObservation,
    "NormalizeReward": vector_wrappers.NormalizeReward,
    "ClipAction": vector_wrappers.ClipAction,
    "RescaleAction": lambda env: vector_wrappers.RescaleAction(env, *UNIT),
    "TransformAction": lambda env: vector_wrappers.TransformAction(env, lambda action: action / 2),
    "TransformObservation": lambda env: vector_wrappers.TransformObservation(env, lambda seen: seen * np.float32(2)),
    "FlattenObservation": vector_wrappers.FlattenObservation,
    "DtypeObservation": lambda env: vector_wrappers.DtypeObservation(env, np.float64),
    "TransformReward": lambda env: vector_wrappers.TransformReward(env, lambda reward: reward / 2),
    "ClipReward": lambda env: vector_wrappers.ClipReward(env, -1.0, 1.0),
    "DictInfoToList": vector_wrappers.DictInfoToList,
}
REFUSED = {  # by the wrappers themselves, for what they cannot do to the last observation of an episode
    "NormalizeObservation": ("same_step", "disabled"),
    **dict.fromkeys(("TransformObservation", "FlattenObservation", "DtypeObservation"), ("same_step",)),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", VECTOR)
def test_vector_wrappers_work_in_the_autoreset_modes_they_claim(name, mode):
    if mode in REFUSED.get(name, ()):
        with pytest.raises(ValueError, match=r"Expected .*autoreset_mode"):
            VECTOR[name](native(mode))
        return
    env = VECTOR[name](native(mode))
    observation, _ = env.reset(seed=0)
    for action in ACTIONS:
        observation, reward, terminated, truncated, info = env.step(
            action / 2000 if name == "RescaleAction" else action
        )
        assert observation in env.observation_space and np.isfinite(observation).all()
        assert reward.shape == (2,) and np.isfinite(reward).all()
        infos = info if name == "DictInfoToList" else [{"outcome": outcome} for outcome in info["outcome"]]
        ended = terminated | truncated
        assert [i["outcome"] != Outcome.RUNNING for i in infos] == (
            [False] * 2 if mode == "same_step" else ended.tolist()
        )
        reset_if_waiting(env, ended)


@pytest.mark.parametrize("mode", MODES)
def test_vector_wrappers_do_what_they_say(mode):
    plain = flown(native(mode))
    clipped = flown(vector_wrappers.ClipAction(native(mode)), ACTIONS)
    rescaled = flown(vector_wrappers.RescaleAction(native(mode), *UNIT), ACTIONS / ([1600] * 3 + [2000] * 3))
    listed = flown(vector_wrappers.DictInfoToList(native(mode)))
    monitored = vector_wrappers.RecordEpisodeStatistics(native(mode))
    counted = flown(monitored)
    episodes = np.zeros(2)
    for (observation, reward, _, truncated, info), c, r, rows, m in zip(plain, clipped, rescaled, listed, counted):
        np.testing.assert_array_equal(c[0], observation)
        np.testing.assert_allclose(r[0], observation, rtol=1e-5, atol=1e-5)
        for slot, row in enumerate(rows[4]):
            np.testing.assert_array_equal(row["true_state"], info["true_state"][slot])
            if mode == "same_step" and truncated[slot]:
                assert row["final_info"]["outcome"] == Outcome.TIMEOUT and row["outcome"] == Outcome.RUNNING
                np.testing.assert_array_equal(row["final_obs"], info["final_obs"][slot])
        episodes += reward
        for slot in np.flatnonzero(truncated):
            assert m[4]["episode"]["l"][slot] == 4
            assert m[4]["episode"]["r"][slot] == pytest.approx(episodes[slot], rel=1e-5)
            episodes[slot] = 0.0
    assert len(monitored.return_queue) == 4  # two episodes a slot


@pytest.mark.parametrize("mode", MODES)
def test_native_steps_equal_a_sync_vector_env_over_scalar_environments(mode):
    theirs = gymnasium.make_vec(
        ID,
        num_envs=2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode[mode.upper()]},
        **SHORT,
    )
    ours = native(mode)
    np.testing.assert_allclose(ours.reset(seed=0)[0], theirs.reset(seed=0)[0], rtol=1e-6, atol=1e-6)
    ends = 0
    for mine, other in zip(flown(ours), flown(theirs)):
        for left, right in zip(mine[:4], other[:4]):
            np.testing.assert_allclose(left, right, rtol=1e-6, atol=1e-6)
            assert left.dtype == right.dtype and left.shape == right.shape
        ends += int((mine[2] | mine[3]).sum())
        infos = [(mine[4], other[4])]
        assert mine[4].keys() == other[4].keys()
        if "final_info" in mine[4]:
            infos.append((mine[4]["final_info"], other[4]["final_info"]))
            np.testing.assert_allclose(mine[4]["final_obs"], np.stack(other[4]["final_obs"]), rtol=1e-6, atol=1e-6)
        for left, right in infos:
            for name in left.keys() - {"final_info", "final_obs"}:
                if left[name].dtype.kind in "fib":
                    np.testing.assert_allclose(left[name], right[name], rtol=1e-6, atol=1e-6, err_msg=name)
                else:
                    assert left[name].tolist() == right[name].tolist(), name
    assert ends == 4


def test_other_processes_fly_the_same_numbers():
    """Spawned workers: `make_vec` in async mode, and an environment that travels there in mid-flight."""
    spawn = {"context": "spawn"}
    ours, theirs = native(), gymnasium.make_vec(ID, 1, vectorization_mode="async", vector_kwargs=spawn, **SHORT)
    np.testing.assert_allclose(ours.reset(seed=0)[0][:1], theirs.reset(seed=0)[0], rtol=1e-6, atol=1e-6)
    for action in ACTIONS[:6]:
        mine, other = ours.step(action), theirs.step(action[:1])
        np.testing.assert_allclose(mine[0][:1], other[0], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(mine[4]["true_state"][:1], other[4]["true_state"], rtol=0, atol=1e-9)
    theirs.close()

    traveller = scalar().unwrapped
    traveller.reset(seed=3)
    traveller.step(ACTIONS[0, 0])
    elsewhere = AsyncVectorEnv([lambda: traveller], context="spawn")
    for action in ACTIONS[1:3, :1]:
        away, here = elsewhere.step(action)[4], traveller.step(action[0])[4]
        assert away["true_state"].dtype == np.float64
        np.testing.assert_allclose(away["true_state"][0], here["true_state"], rtol=0, atol=1e-9)
    elsewhere.close()


@pytest.mark.parametrize("mode", MODES)
def test_copies_of_the_batch_go_on_as_the_original(mode):
    env = native(mode)
    env.reset(seed=3)
    for action in ACTIONS[:5]:  # past the end of an episode
        env.step(action)
    twin = copy.deepcopy(env)
    for action in ACTIONS[5:]:
        mine, theirs = env.step(action), twin.step(action)
        np.testing.assert_allclose(theirs[4]["true_state"], mine[4]["true_state"], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(theirs[0], mine[0])
        ended = mine[2] | mine[3]
        for each in (env, twin):
            reset_if_waiting(each, ended)


def test_specs_make_the_same_environment_again():
    env = wrappers.TimeLimit(wrappers.FlattenObservation(scalar()), 3)
    text = env.spec.to_json()
    assert json.loads(text)["kwargs"]["horizon"] == 0.2
    env.spec.pprint()
    assert "ISSHCW-v0" in env.spec.pprint(disable_print=True)
    for spec in (env.spec, EnvSpec.from_json(text)):
        again = gymnasium.make(spec)
        assert again.unwrapped.config == env.unwrapped.config
        again.reset(seed=0)
        assert [again.step(ACTIONS[0, 0])[3] for _ in range(3)] == [False, False, True]

    batch = native("same_step")
    twin = gymnasium.make_vec(EnvSpec.from_json(batch.spec.to_json()))
    assert (twin.num_envs, twin.metadata["autoreset_mode"]) == (2, AutoresetMode.SAME_STEP)
    np.testing.assert_array_equal(twin.reset(seed=0)[0], batch.reset(seed=0)[0])


def test_frames_are_collected_where_gymnasium_offers_it():
    env = scalar(render_mode="rgb_array_list", width=480, height=270)
    env.reset(seed=0)
    for action in ACTIONS[:2, 0]:
        env.step(action)
    frames = env.render()
    assert len(frames) == 3 and (frames[0] != frames[2]).any()
