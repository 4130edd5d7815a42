"""The adapter under the real Stable-Baselines3. Run by `nox -s sb3`, which brings it."""

import re
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import jax
import numpy as np
import pytest
import torch
from gymnasium import Wrapper
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecEnv, VecMonitor, VecNormalize

from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.config import load_config
from owm_envs.sb3 import make_vec_env
from owm_envs.station import PORT_NAMES
from owm_envs.task.events import Outcome

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from small_sensors import PARTS, SENSORS

SHORT = {"horizon": 4.0, "noise": "cooperative"}  # four decisions an episode
NATIVE = {"preset": "rl", "normalize": True, **SHORT}
SLOTS = 3


@pytest.fixture
def venv():
    return make_vec_env("iss-hcw", SLOTS, seed=5, **SHORT)


def actions(count: int, slots: int = SLOTS) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (count, slots, 6)).astype(np.float32)


def test_the_scalar_environment_passes_their_check():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(DockingGymEnv(fidelity="iss-hcw", **NATIVE), skip_render_check=True)


@pytest.mark.parametrize("fidelity", ["iss-hcw", "iss-numerical"])
def test_steps_equal_their_own_vec_env_over_scalar_environments(fidelity):
    ours = make_vec_env(fidelity, SLOTS, seed=5, infos="all", **SHORT)
    theirs = DummyVecEnv([lambda: DockingGymEnv(fidelity=fidelity, **NATIVE)] * SLOTS)
    theirs.seed(5)
    assert isinstance(ours, VecEnv)
    assert (ours.action_space.low.tolist(), ours.action_space.high.tolist()) == ([-1.0] * 6, [1.0] * 6)
    assert ours.action_space == theirs.action_space and ours.observation_space == theirs.observation_space
    np.testing.assert_allclose(ours.reset(), theirs.reset(), rtol=1e-6, atol=1e-6)
    for action in actions(9):
        (obs, reward, done, infos), (obs_, reward_, done_, infos_) = ours.step(action), theirs.step(action)
        np.testing.assert_allclose(obs, obs_, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(reward, reward_, rtol=1e-5)
        np.testing.assert_array_equal(done, done_)
        assert (obs.dtype, reward.dtype, done.dtype) == (obs_.dtype, reward_.dtype, done_.dtype)
        for info, info_ in zip(infos, infos_):
            assert info.keys() == info_.keys()
            assert all(type(info[name]) is type(info_[name]) for name in info)
            assert (info["port"], info["outcome"]) == (info_["port"], info_["outcome"])
            assert info["TimeLimit.truncated"] == info_["TimeLimit.truncated"]
            for name in info.keys() - {"port", "outcome"}:
                np.testing.assert_allclose(info[name], info_[name], rtol=1e-5, atol=1e-6, err_msg=name)
        for start, start_ in zip(ours.reset_infos, theirs.reset_infos):
            np.testing.assert_allclose(start["true_state"], start_["true_state"], rtol=1e-9, atol=1e-9)


def test_numbers_and_terminal_observations_are_the_native_batch_s(venv):
    native = DockingVectorEnv(SLOTS, None, autoreset_mode=AutoresetMode.SAME_STEP, fidelity="iss-hcw", **NATIVE)
    np.testing.assert_array_equal(venv.reset(), native.reset(seed=5)[0])
    ends = 0
    for action in actions(9):
        obs, reward, done, infos = venv.step(action)
        obs_, reward_, terminated, truncated, info = native.step(action)
        np.testing.assert_array_equal(obs, obs_)
        np.testing.assert_array_equal(reward, reward_.astype(np.float32))
        np.testing.assert_array_equal(done, terminated | truncated)
        for slot in range(SLOTS):
            assert ("terminal_observation" in infos[slot]) == done[slot]
            if done[slot]:
                np.testing.assert_array_equal(infos[slot]["terminal_observation"], info["final_obs"][slot])
                assert np.abs(infos[slot]["terminal_observation"] - obs[slot]).max() > 0.01
                ends += 1
            else:
                assert infos[slot] == {"TimeLimit.truncated": False}
    assert ends == 2 * SLOTS
    assert venv.get_attr("traces")[0]["step"] == 1


@pytest.mark.parametrize("sensors", [(), SENSORS], ids=["array", "dict"])
@pytest.mark.parametrize("batch", [False, True], ids=["scalar", "vector"])
def test_gymnasium_s_wrappers_convert_all_to_torch(batch, sensors):
    make = {"config": {"fidelity": "iss-hcw", "horizon": 0.1}, "sensors": sensors}
    if batch:
        env = gymnasium.wrappers.vector.NumpyToTorch(gymnasium.make_vec("ISSHCW-v0", num_envs=2, **make))
    else:
        env = gymnasium.wrappers.NumpyToTorch(gymnasium.make("ISSHCW-v0", **make))
    observation, info = env.reset(seed=0)
    for _ in range(3):
        leaves = jax.tree.leaves((observation, info))
        assert leaves and all(isinstance(leaf, torch.Tensor) for leaf in leaves)
        observation, *_, info = env.step(torch.zeros(env.action_space.shape))


def test_a_second_sensor_makes_observations_dicts():
    """A policy of several inputs learns on them, and its terminal observations are whole."""
    venv = make_vec_env("iss-hcw", SLOTS, seed=5, sensors=SENSORS, **SHORT)
    plain = make_vec_env("iss-hcw", SLOTS, seed=5, **SHORT)
    first = venv.reset()
    assert {name: part.shape[1:] for name, part in first.items()} == PARTS
    np.testing.assert_array_equal(first["state"], plain.reset())
    for action in actions(4):
        observation, _, done, infos = venv.step(action)
        np.testing.assert_array_equal(observation["state"], plain.step(action)[0])
    assert done.all() and (observation["patch"][:, 1] == 0).all()
    last = infos[0]["terminal_observation"]
    assert last in venv.observation_space and (last["patch"][1] == 4).all()
    check_env(DockingGymEnv(fidelity="iss-hcw", sensors=SENSORS, **NATIVE), skip_render_check=True)
    model = PPO("MultiInputPolicy", VecMonitor(venv), n_steps=8, batch_size=8, n_epochs=1, seed=0)
    model.learn(2 * 8 * SLOTS)
    assert model.predict(observation, deterministic=True)[0].shape == (SLOTS, 6)


def test_only_the_horizon_is_a_time_limit():
    venv = make_vec_env("iss-hcw", 8, seed=0, escape_radius=112.0, **SHORT)  # starts lie at 100 to 125 m
    venv.reset()
    ended = {}
    for number in range(4):
        action = np.zeros((8, 6), np.float32)
        if number == 3:
            action[0] = np.nan
        _, reward, done, infos = venv.step(action)
        assert np.isfinite(reward).all()
        for info in (info for info, over in zip(infos, done) if over):
            assert np.isfinite(info["terminal_observation"]).all()
            ended.setdefault(Outcome(info["outcome"]), set()).add(info["TimeLimit.truncated"])
    assert ended == {Outcome.ESCAPED: {False}, Outcome.TIMEOUT: {True}, Outcome.INVALID_ACTION: {False}}


def test_a_seed_is_used_once_and_then_the_chain_goes_on(venv):
    first = venv.reset()
    chained = venv.reset()
    assert np.abs(first - chained).max() > 0.01
    assert venv.seed(5) == [5, 6, 7]
    np.testing.assert_array_equal(venv.reset(), first)
    np.testing.assert_array_equal(venv.reset(), chained)
    assert np.abs(make_vec_env("iss-hcw", SLOTS, **SHORT).reset() - first).max() > 0.01


def test_options_choose_the_port_once(venv):
    venv.set_options({"dock_port": "zvezda_aft"})
    venv.reset()
    assert [PORT_NAMES[info["port"]] for info in venv.reset_infos] == ["zvezda_aft"] * SLOTS
    venv.set_options([{"dock_port": "pirs_nadir"}, {}, {"dock_port": "unity_nadir"}])
    venv.seed(5)
    venv.reset()
    ports = [PORT_NAMES[info["port"]] for info in venv.reset_infos]
    venv.seed(5)
    venv.reset()
    assert ports == ["pirs_nadir", PORT_NAMES[venv.reset_infos[1]["port"]], "unity_nadir"]
    venv.set_options({"dock_prot": "zvezda_aft"})
    with pytest.raises(ValueError, match="did you mean 'dock_port'"):
        venv.reset()


def test_slots_have_attributes_and_methods(venv):
    before = venv.reset()
    assert [config.fidelity for config in venv.get_attr("config")] == ["iss-hcw"] * SLOTS
    assert venv.has_attr("layout") and not venv.has_attr("level")
    venv.set_attr("level", 2, indices=[0, 2])
    assert venv.get_attr("level", indices=[0, 2]) == [2, 2] and not venv.has_attr("level")
    with pytest.raises(AttributeError, match="make another environment"):
        venv.set_attr("config", None)
    assert venv.env_is_wrapped(Wrapper, indices=1) == [False]
    ((observation, info),) = venv.env_method("reset", seed=9, options={"dock_port": "poisk_zenith"}, indices=1)
    assert PORT_NAMES[info["port"]] == "poisk_zenith" and np.abs(observation - before[1]).max() > 0.01
    fresh = make_vec_env("iss-hcw", 1, seed=9, **SHORT)
    fresh.set_options({"dock_port": "poisk_zenith"})
    np.testing.assert_allclose(fresh.reset()[0], observation, rtol=1e-6, atol=1e-6)
    # The neighbours fly on.
    untouched = make_vec_env("iss-hcw", SLOTS, seed=5, **SHORT)
    untouched.reset()
    action = actions(1)[0]
    np.testing.assert_array_equal(venv.step(action)[0][[0, 2]], untouched.step(action)[0][[0, 2]])
    venv.close()


def test_a_step_without_actions_is_an_error(venv):
    venv.reset()
    with pytest.raises(RuntimeError, match="step_async"):
        venv.step_wait()


def test_actions_that_are_not_numbers_raise_where_asked(venv):
    checked = VecCheckNan(venv, raise_exception=True)
    checked.reset()
    checked.step(np.ones((SLOTS, 6), np.float32))
    with pytest.raises(ValueError, match="nan"):
        checked.step(np.full((SLOTS, 6), np.nan, np.float32))


def test_pictures_are_tiled():
    venv = make_vec_env("iss-hcw", 2, seed=0, render_mode="rgb_array", width=480, height=270, **SHORT)
    venv.reset()
    one = venv.env_method("render", indices=0)[0]
    tiled = venv.render()
    assert one.dtype == np.uint8 and tiled.size == 2 * one.size
    assert venv.get_images()[0].shape == one.shape


def test_vec_monitor_sums_what_was_earned(venv):
    monitored = VecMonitor(venv)
    monitored.reset()
    total = np.zeros(SLOTS)
    for action in actions(4):
        _, reward, done, infos = monitored.step(action)
        total += reward
    assert done.all()
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], total, rtol=1e-5)
    assert [info["episode"]["l"] for info in infos] == [4] * SLOTS


@pytest.mark.parametrize("algorithm", [PPO, SAC])
def test_learns_predicts_and_is_saved_with_its_normalisation(algorithm, venv, tmp_path):
    normalized = VecNormalize(VecMonitor(venv))
    sizes = {"n_steps": 8, "batch_size": 12, "n_epochs": 1} if algorithm is PPO else {"learning_starts": 12}
    model = algorithm("MlpPolicy", normalized, seed=0, device="cpu", policy_kwargs={"net_arch": [16]}, **sizes)
    start = [value.clone() for value in model.policy.state_dict().values()]
    model.learn(48)
    assert model.num_timesteps >= 48
    assert any((old != new).any() for old, new in zip(start, model.policy.state_dict().values()))
    model.save(tmp_path / "policy.zip")
    normalized.save(str(tmp_path / "normalize.pkl"))

    fresh = VecNormalize.load(str(tmp_path / "normalize.pkl"), make_vec_env("iss-hcw", SLOTS, seed=1, **SHORT))
    fresh.training = fresh.norm_reward = False
    np.testing.assert_array_equal(fresh.obs_rms.mean, normalized.obs_rms.mean)
    assert fresh.obs_rms.count > 48
    again = algorithm.load(tmp_path / "policy.zip", env=fresh, device="cpu")
    observation = fresh.reset()
    action, _ = again.predict(observation, deterministic=True)
    np.testing.assert_array_equal(action, model.predict(observation, deterministic=True)[0])
    assert action.shape == (SLOTS, 6) and np.abs(action).max() <= 1
    mean, _ = evaluate_policy(again, fresh, n_eval_episodes=SLOTS, warn=False)
    assert np.isfinite(mean)


def test_configurations_come_as_id_mapping_file_or_object(tmp_path):
    file = tmp_path / "rl.toml"
    file.write_text('fidelity = "iss"\nhorizon = 30.0\n', encoding="utf-8")
    want = load_config({"fidelity": "iss", "horizon": 30.0}, preset="rl", normalize=True)
    for given in (str(file), file, {"fidelity": "iss", "horizon": 30.0}, want):
        assert make_vec_env(given).batch.config == want
    assert make_vec_env("owm_envs:ISS-v0", horizon=30.0).batch.config == want
    raw = make_vec_env("iss", normalize=False)
    assert raw.action_space.high.tolist() == [1600.0] * 3 + [2000.0] * 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"id_or_config": "iss-hwc"}, "did you mean 'iss-hcw'"),
        ({"n_envs": 0}, "num_envs must be at least 1"),
        ({"infos": "every"}, "unknown infos 'every'"),
        ({"horizn": 3.0}, "did you mean 'horizon'"),
    ],
)
def test_mistakes_name_what_is_allowed(arguments, message):
    with pytest.raises(ValueError, match=message):
        make_vec_env(**arguments)


def test_outages_are_a_part_of_their_own_which_policies_of_several_inputs_see():
    """Half of the time blind, a second at a time: what is held, what is told, at the end of an episode too."""
    quiet = {"outage_duration": 1.0, "outage_share": 0.5}
    venv = make_vec_env("iss-hcw", SLOTS, seed=5, steps_per_action=5, navigation=quiet, **SHORT)
    observation, seen = venv.reset(), []
    assert observation["state_valid"].all() and observation["state_valid"].shape == (SLOTS, 1)
    for action in actions(40):
        before = observation["state"]
        observation, _, done, infos = venv.step(action)
        valid = observation["state_valid"][:, 0].astype(bool)
        np.testing.assert_array_equal((observation["state"] == before).all(axis=1), ~valid)
        seen.append(valid)
        for slot in np.flatnonzero(done):
            assert set(infos[slot]["terminal_observation"]) == {"state", "state_valid"}
    assert 0.3 < np.mean(seen) < 0.8
    normalized = VecNormalize(venv, norm_obs_keys=["state"])
    PPO("MultiInputPolicy", normalized, n_steps=8, batch_size=8, n_epochs=1).learn(24)


def test_without_stable_baselines_the_error_names_the_extra():
    code = (
        "import sys; sys.modules['stable_baselines3'] = None\n"
        "import owm_envs; assert 'torch' not in sys.modules\n"
        "try:\n    import owm_envs.sb3\nexcept ImportError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert 'pip install "stable-baselines3>=2.6"' in done.stdout


def test_the_example_runs(tmp_path):
    example = Path(__file__).parents[2] / "examples" / "train_sb3_ppo.py"
    options = ["--steps", "512", "--envs", "8", "--horizon", "5", "--out", str(tmp_path)]
    done = subprocess.run([sys.executable, str(example), *options], check=True, capture_output=True, text=True)
    assert "after" in done.stdout
    for name in ("policy.zip", "normalize.pkl", "learning_curve.png"):
        assert (tmp_path / name).stat().st_size > 0


def test_the_block_of_the_readme_runs():
    page = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    (block,) = (
        b for b in re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL) if "stable_baselines3" in b
    )
    assert block.count("learn(1_000_000)") == 1
    exec(
        compile(block.replace("learn(1_000_000)", "learn(1)"), "README", "exec"), {}
    )  # one update of 64 x 256 decisions
