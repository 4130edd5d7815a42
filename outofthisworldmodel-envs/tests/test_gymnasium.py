import copy
import json
import pickle
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import owm_envs  # noqa: F401 - registers the ids
from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.registration import IDS
from owm_envs.station import PORT_NAMES
from owm_envs.task.events import Outcome
from owm_envs.view import View

SHORT = {"noise": "cooperative", "horizon": 0.2}  # four steps an episode
SIZE = {"width": 480, "height": 270}  # of all schematics in the tests, which is one program
IDS_OF = {fidelity: name for name, fidelity in IDS.items() if name.endswith("-v0")}
ACTION = np.array([300.0, -200.0, 100.0, 50.0, -40.0, 30.0], np.float32)


@pytest.fixture
def env(fidelity):
    env = gymnasium.make(IDS_OF[fidelity], **SHORT, **SIZE)
    yield env
    env.close()


@pytest.fixture
def vector():
    """A native vector environment of two slots on the quickest fidelity."""
    return lambda mode="next_step", **kwargs: gymnasium.make_vec(
        "ISSHCW-v0", num_envs=2, autoreset_mode=mode, **{**SHORT, **kwargs}
    )


@pytest.mark.slow
def test_check_env(env):
    with warnings.catch_warnings():
        warnings.filterwarnings("error")
        warnings.filterwarnings("ignore", message=".*A Box observation space m.*infinity.*")
        warnings.filterwarnings("ignore", message=".*For Box action spaces, we recommend using a symmetric.*")
        check_env(env.unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_ids_make_and_specs_survive_json(name):
    env = gymnasium.make(name, noise="cooperative", goal_error=True, ports=["zvezda_aft"], normalize=False)
    assert env.spec.max_episode_steps is None
    assert env.unwrapped.config.fidelity == IDS[name]
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.config == env.unwrapped.config


def test_config_is_a_mapping_or_a_path(tmp_path):
    file = tmp_path / "rl.toml"
    file.write_text('noise = "cooperative"\nsteps_per_action = 20\n')
    from_file = gymnasium.make("ISS-v0", config=str(file)).unwrapped.config
    from_mapping = gymnasium.make("ISS-v0", config={"noise": "cooperative", "steps_per_action": 20})
    assert from_file == from_mapping.unwrapped.config
    assert json.loads(from_mapping.spec.to_json())["kwargs"]["config"]["steps_per_action"] == 20


def test_make_without_importing_the_package():
    code = 'import gymnasium; print(gymnasium.make("owm_envs:ISSNumerical-v0").observation_space.shape)'
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "(27,)"


def test_info_tells_the_truth_and_the_observation_the_measurement(env, fidelity):
    observation, info = env.reset(seed=1, options={"dock_port": "poisk_zenith"})
    assert observation.flags.writeable and info["true_state"].flags.writeable
    assert PORT_NAMES[info["port"]] == "poisk_zenith" and info["outcome"] == Outcome.RUNNING
    layout = env.unwrapped.layout
    np.testing.assert_allclose(layout.measured_view(observation), info["measured_state"], rtol=1e-6)
    measured, true = (View.of(info[name]).position for name in ("measured_state", "true_state"))
    assert 0 < np.linalg.norm(measured - true) < 0.3
    np.testing.assert_allclose(info["true_goal_error"][:3], true - info["goal_pose"][:3], atol=1e-9)
    np.testing.assert_allclose(observation[-12:-9], measured - info["goal_pose"][:3], rtol=1e-5)
    assert info["true_state"].dtype == np.float64
    for _ in range(4):
        observation, _, terminated, truncated, info = env.step(ACTION)
    assert (terminated, truncated, info["outcome"]) == (False, True, Outcome.TIMEOUT)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_a_slot_equals_the_scalar_environment_auto_resets_included(fidelity, mode):
    vector = gymnasium.make_vec(IDS_OF[fidelity], num_envs=2, autoreset_mode=mode, **SHORT)
    batch = [vector.reset(seed=7)[0]]
    for _ in range(9):
        batch.append(vector.step(np.stack([ACTION, -ACTION]))[0])
    for slot, action in enumerate([ACTION, -ACTION]):
        scalar = gymnasium.make(IDS_OF[fidelity], **SHORT)
        expected = [scalar.reset(seed=7 + slot)[0]]
        done = False
        while len(expected) < len(batch):
            if done:
                expected.append(scalar.reset()[0])
                done = False
            else:
                observation, _, terminated, truncated, _ = scalar.step(action)
                done = terminated or truncated
                if done and mode == "same_step":
                    observation, done = scalar.reset()[0], False
                expected.append(observation)
        np.testing.assert_allclose([b[slot] for b in batch], expected, rtol=1e-6, atol=1e-6)


def test_slots_without_a_seed_follow_from_their_own_last_episode(vector):
    env = vector("disabled")
    env.reset(seed=[3, 4])
    mixed = env.reset(seed=[None, 9])[0]
    env.reset(seed=[3, 8])
    np.testing.assert_array_equal(env.reset()[0][0], mixed[0])
    np.testing.assert_array_equal(env.reset(seed=[1, 9])[0][1], mixed[1])


def test_next_step_keeps_the_terminal_observation_then_resets(vector):
    env = vector("next_step")
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    env.reset(seed=0)
    for _ in range(4):
        last, _, _, truncated, info = env.step(np.tile(ACTION, (2, 1)))
    assert truncated.all() and list(info["outcome"]) == [Outcome.TIMEOUT] * 2
    first, reward, terminated, truncated, info = env.step(np.tile(ACTION, (2, 1)))
    assert not (terminated | truncated).any() and not reward.any()
    assert np.abs(first - last)[:, :3].min() > 0.5


def test_same_step_returns_the_new_start_and_keeps_the_old_end(vector):
    env = vector("same_step")
    env.reset(seed=0)
    for _ in range(4):
        observation, reward, _, truncated, info = env.step(np.tile(ACTION, (2, 1)))
    assert truncated.all() and info["_final_obs"].all()
    assert (
        list(info["final_info"]["outcome"]) == [Outcome.TIMEOUT] * 2 and list(info["outcome"]) == [Outcome.RUNNING] * 2
    )
    measured = env.unwrapped.layout.measured_view(info["final_obs"])
    np.testing.assert_allclose(measured, info["final_info"]["measured_state"], rtol=1e-6)
    assert np.abs(observation - info["final_obs"])[:, :3].min() > 0.5
    assert np.abs(reward).min() > 0


def test_disabled_waits_for_a_reset_mask(vector):
    env = vector("disabled")
    env.reset(seed=0)
    for _ in range(5):
        ended, reward, _, truncated, _ = env.step(np.tile(ACTION, (2, 1)))
    assert truncated.all() and not reward.any()
    mask = np.array([False, True])
    observation, info = env.reset(options={"reset_mask": mask, "dock_port": "zvezda_aft"})
    np.testing.assert_array_equal(observation[0], ended[0])
    assert list(info["_port"]) == [False, True] and PORT_NAMES[info["port"][1]] == "zvezda_aft"
    _, _, _, truncated, _ = env.step(np.tile(ACTION, (2, 1)))
    assert list(truncated) == [True, False]


def test_a_port_per_slot(vector):
    env = vector()
    _, info = env.reset(seed=0, options={"dock_port": ["unity_nadir", "pirs_nadir"]})
    assert [PORT_NAMES[port] for port in info["port"]] == ["unity_nadir", "pirs_nadir"]
    with pytest.raises(ValueError, match="2 environments"):
        env.reset(options={"dock_port": ["unity_nadir"] * 3})


def test_bad_input_is_named(env, vector):
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.unwrapped.step(ACTION)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="did you mean 'zvezda_aft'"):
        env.reset(options={"dock_port": "zvezda_aff"})
    with pytest.raises(ValueError, match="did you mean 'dock_port'"):
        env.reset(options={"dock_prt": "zvezda_aft"})
    with pytest.raises(ValueError, match=r"shape \(6,\), got \(5,\)"):
        env.unwrapped.step(np.zeros(5))
    with pytest.raises(ValueError, match="finite"):
        env.unwrapped.step(np.full(6, np.nan))
    with pytest.raises(ValueError, match="did you mean 'next_step'"):
        vector("nextstep")
    with pytest.raises(ValueError, match="reset_mask"):
        vector().reset(options={"reset_mask": np.zeros(2, bool)})


def test_a_slot_with_a_nan_action_ends_alone_and_stays_finite(vector):
    env = vector("disabled")
    env.reset(seed=0)
    actions = np.stack([ACTION, ACTION])
    actions[1, 2] = np.nan
    with pytest.warns(UserWarning, match=r"slots \[1\]"):
        observation, reward, _, truncated, info = env.step(actions)
    assert list(info["outcome"]) == [Outcome.RUNNING, Outcome.INVALID_ACTION] and list(truncated) == [False, True]
    assert np.isfinite(observation).all() and np.isfinite(reward).all()


def test_actions_beyond_the_box_are_clipped(vector):
    views = []
    for scale in (1.0, 10.0):
        env = vector()
        env.reset(seed=0)
        views.append(env.step(np.tile([1600, 0, 0, 0, 2000, 0], (2, 1)) * scale)[0])
    np.testing.assert_array_equal(*views)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_as_the_original(fidelity, duplicate):
    env = gymnasium.make(IDS_OF[fidelity], **SHORT).unwrapped
    env.reset(seed=3)
    env.step(ACTION)
    twin = duplicate(env)
    for _ in range(3):
        mine, theirs = env.step(ACTION), twin.step(ACTION)
    np.testing.assert_allclose(theirs[4]["true_state"], mine[4]["true_state"], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(theirs[0], mine[0])


def test_one_trace_whatever_the_port_seed_and_length(vector):
    env = vector(horizon=0.35)
    for seed, port in [(0, "zvezda_aft"), (1, "unity_nadir")]:
        env.reset(seed=seed, options={"dock_port": port})
        for _ in range(20):
            env.step(np.tile(ACTION, (2, 1)))
    traces = env.unwrapped.traces
    assert traces["reset"] == traces["step"] == traces["restart"] == max(traces.values()) == 1


def test_environments_that_differ_in_numbers_share_their_programs(vector):
    env = vector(horizon=0.3)
    env.reset(seed=0)
    for _ in range(8):
        plain = env.step(np.tile(ACTION, (2, 1)))[4]
    twin = pickle.loads(pickle.dumps(env.unwrapped))
    changes = {
        "noise": "noncooperative",
        "horizon": 0.4,
        "ports": ["zvezda_aft"],
        "reward": "rl",
        "chaser": {"mass": 6_000.0},
        "reset": {"radius_min": 150.0},
        "chief": {"inclination_deg": 28.5},
    }
    other = vector(**changes)
    _, info = other.reset(seed=0)
    assert {PORT_NAMES[port] for port in info["port"]} == {"zvezda_aft"}
    after = other.step(np.tile(ACTION, (2, 1)))[4]
    lighter = View.of(after["true_state"] - info["true_state"]).velocity
    traces = env.unwrapped.traces
    assert other.unwrapped.traces == traces
    assert traces["reset"] == traces["step"] == traces["restart"] == max(traces.values()) == 1
    # Twice the acceleration of half the mass, less the orbital terms of the two starts (2e-3 m/s2).
    np.testing.assert_allclose(np.linalg.norm(lighter, axis=1), np.linalg.norm(ACTION[:3]) / 6_000 * 0.05, atol=2e-4)
    again = twin.step(np.tile(ACTION, (2, 1)))[4]["true_state"]
    np.testing.assert_allclose(again, env.step(np.tile(ACTION, (2, 1)))[4]["true_state"], rtol=0, atol=1e-9)
    assert not np.allclose(again, plain["true_state"]) and twin.traces["step"] == 1


def test_info_tells_what_was_drawn(vector):
    env = vector(randomization={"mass_scale": (0.5, 2.0), "actuation_delay": (0, 2)})
    _, info = env.reset(seed=3)
    assert info["drawn_mass_scale"].shape == (2,) and info["drawn_thrust_scale"].shape == (2, 6)
    assert np.ptp(info["drawn_mass_scale"]) > 0 and np.all(info["drawn_thrust_scale"] == 1)
    scalar = gymnasium.make("ISSHCW-v0", randomization={"mass_scale": (0.5, 2.0), "actuation_delay": (0, 2)}, **SHORT)
    assert scalar.reset(seed=4)[1]["drawn_mass_scale"] == pytest.approx(info["drawn_mass_scale"][1])
    twin = pickle.loads(pickle.dumps(env.unwrapped))
    np.testing.assert_array_equal(twin.step(np.tile(ACTION, (2, 1)))[0], env.unwrapped.step(np.tile(ACTION, (2, 1)))[0])


def test_normalised_spaces(vector):
    env = vector(normalize=True, goal_error=False)
    assert env.single_action_space.high.max() == 1.0 and env.single_observation_space.shape == (13,)
    observation, _ = env.reset(seed=0)
    assert np.abs(observation).max() < 2.0
    raw = vector()
    raw.reset(seed=0)
    scaled = env.step(np.full((2, 6), 0.5))[4]["true_state"]
    plain = raw.step(np.tile([800.0] * 3 + [1000.0] * 3, (2, 1)))[4]["true_state"]
    np.testing.assert_allclose(scaled, plain, atol=1e-12)


def test_rgb_array_shows_the_flight():
    env = gymnasium.make("ISS-v0", render_mode="rgb_array", **SHORT, **SIZE)
    env.reset(seed=0)
    before = env.render()
    env.step(ACTION)
    after = env.render()
    assert before.dtype == np.uint8 and before.shape == (270, 480, 3)
    assert (before != after).any()


@pytest.mark.parametrize("name", ["chaser_isometric", "station_top"])
def test_a_named_camera_gives_its_picture_of_every_slot(vector, name):
    how = {"render_mode": "rgb_array", "width": 20, "height": 12, "camera_name": name}
    batch, alone = vector(**how), gymnasium.make("ISSHCW-v0", **SHORT, **how).unwrapped
    batch.reset(seed=0)
    alone.reset(seed=1)
    pictures = batch.render()
    assert len(pictures) == 2 and pictures[0].shape == (12, 20, 3) and pictures[0].any()
    assert np.abs(pictures[1].astype(int) - alone.render()).max() <= 1


def test_a_picture_that_cannot_be_is_refused():
    for mistake, message in (
        ({"camera_name": "chaser_fvp"}, "did you mean 'chaser_fpv'"),
        ({"camera_name": "chaser_fpv", "width": 0}, "width and height must be at least 1 and 1, got 0 and 540"),
        ({"height": 100}, "width and height must be at least 160 and 120, got 960 and 100"),
    ):
        with pytest.raises(ValueError, match=message):
            DockingGymEnv(render_mode="rgb_array", **mistake)


PINNED = {
    "iss": [73.1871759, -143.1369274, 150.8257451, -0.05952530148, -0.01729741486, 0.00338504887, 0.06076823477,
            -0.5710538839, 0.6846270248, 0.4488769544, 0.008943564444, -0.004052186891, 3.837294818e-06],
    "iss-hcw": [73.18698994, -143.1367367, 150.8269028, -0.05971100145, -0.01714929709, 0.004560086945, 0.06076945889,
                -0.5710625989, 0.684623399, 0.4488712316, 0.008948959905, -0.004039698995, -1.449443037e-05],
    "iss-numerical": [73.18699255, -143.1367365, 150.8269012, -0.05970837688, -0.01714912376, 0.004558469179,
                      0.06076946424, -0.5710625937, 0.6846233962, 0.4488712417, 0.008948949925, -0.004039723256,
                      -1.44940253e-05],
}  # fmt: skip


def test_the_pinned_trajectory(fidelity):
    """A change here changes every published number: bump the id's version."""
    env = gymnasium.make(IDS_OF[fidelity], noise="cooperative")
    env.reset(seed=42)
    for _ in range(40):
        *_, info = env.step(ACTION)
    np.testing.assert_allclose(info["true_state"], PINNED[fidelity], rtol=0, atol=1e-7)


def test_an_orbit_that_does_not_drift_flies_as_it_did():
    env = gymnasium.make(IDS_OF["iss-numerical"], noise="cooperative", chief={"secular_drift": False})
    env.reset(seed=42)
    for _ in range(40):
        *_, info = env.step(ACTION)
    still = [73.18699284, -143.1367372, 150.826901, -0.05970808914, -0.01714977292, 0.004558304094, 0.06076946472]
    np.testing.assert_allclose(info["true_state"][:7], still, rtol=0, atol=1e-7)


def test_make_vec_takes_what_make_takes():
    """`max_episode_steps` truncates in the native batch as it does in the scalar environment."""
    envs = gymnasium.make_vec("ISSHCW-v0", num_envs=2, max_episode_steps=3, disable_env_checker=True)
    alone = gymnasium.make("ISSHCW-v0", max_episode_steps=3, disable_env_checker=True)
    envs.reset(seed=0), alone.reset(seed=0)
    for _ in range(3):
        *_, together, _ = envs.step(np.tile(ACTION, (2, 1)))
        *_, cut, _ = alone.step(ACTION)
        assert together.tolist() == [cut, cut]
    assert cut
    with pytest.raises(ValueError, match="max_episode_steps must be at least 1 and a whole number, got 0"):
        gymnasium.make_vec("ISSHCW-v0", num_envs=2, max_episode_steps=0)


def test_a_batch_says_how_it_starts_again_and_what_is_a_success(vector):
    env = vector()
    assert env.autoreset_mode == AutoresetMode.NEXT_STEP
    _, info = env.reset(seed=0)
    assert info["is_success"].dtype == bool and not info["is_success"].any()


MASKED = np.ma.masked_array(ACTION, mask=[0, 1, 0, 0, 0, 0])
NO_ACTIONS = {
    "complex": ACTION + 1j,
    "masked": MASKED,
    "text": [str(number) for number in ACTION],
    "truth": ACTION > 0,
    "nothing": [None] * 6,
    "beyond every float": [10**400] * 6,
    "ragged": [[1.0], [1.0, 2.0]],
    "a mapping": {"force": ACTION},
    "dates": ACTION.astype("datetime64[s]"),
}


@pytest.mark.parametrize("name", NO_ACTIONS)
def test_what_is_no_action_is_refused(vector, name):
    env, action = DockingGymEnv(fidelity="iss-hcw", **SHORT), NO_ACTIONS[name]
    with pytest.raises(ValueError, match=r"^action must (be real numbers of shape \(6,\), got|not be masked)"):
        env.step(action)
    with pytest.raises(ValueError, match=r"^action must (be real numbers of shape \(2, 6\), got|not be masked)"):
        vector().step([action, action])


def test_a_masked_array_that_masks_nothing_is_an_action(vector):
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector().step(np.ma.masked_array([ACTION, ACTION]))


@pytest.mark.parametrize("port", [True, False, np.True_, 2.0, 99, -1, {"zvezda_aft": 1}, b"zvezda_aft"])
def test_what_is_no_port_is_refused(vector, port):
    env = DockingGymEnv(fidelity="iss-hcw", **SHORT)
    with pytest.raises(ValueError, match=r"unknown dock_port .*known: harmony_forward"):
        env.reset(options={"dock_port": port})
    with pytest.raises(ValueError, match=r"unknown dock_port .*known: harmony_forward"):
        vector().reset(options={"dock_port": [port, 0]})


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"num_envs": True}, "num_envs must be at least 1 and a whole number, got True"),
        ({"num_envs": 2.5}, "num_envs must be at least 1 and a whole number, got 2.5"),
        ({"num_envs": 2**40}, "num_envs must be at most"),
        ({"max_episode_steps": True}, "max_episode_steps must be at least 1 and a whole number, got True"),
        ({"render_mode": "rgb_array", "width": True}, "width must be a whole number of pixels"),
        ({"render_mode": "rgb_array", "height": 1e9}, "height must be a whole number of pixels"),
    ],
)
def test_truths_and_fractions_are_no_counts(keywords, message):
    with pytest.raises(ValueError, match=message):
        DockingVectorEnv(**{"num_envs": 2, "fidelity": "iss-hcw", **keywords})
