import copy
import pickle
import warnings

import gymnasium
import jax
import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

from owm_envs.camera.schematic import COLOURS
from owm_envs.pettingzoo import env as aec_env
from owm_envs.pettingzoo import parallel_env
from owm_envs.station import PORT_NAMES
from owm_envs.task.events import Outcome
from owm_envs.view import VIEW_SIZE, View

# Some start beyond the escape radius and leave after one step, the others time out after five: agents end apart.
SHORT = {"fidelity": "iss", "noise": "cooperative", "normalize": True, "horizon": 0.5, "steps_per_action": 2}
SHORT["escape_radius"] = 160.0
PUSH = np.array([0.3, -0.2, 0.1, 0.05, -0.04, 0.03], np.float32)


def make(**kwargs):
    return parallel_env(3, **SHORT, **kwargs)


def leaving_apart(env):
    """Starts an episode in which some chasers begin beyond the escape radius and some do not."""
    for seed in range(100):
        _, infos = env.reset(seed=seed)
        away = {agent: np.linalg.norm(View.of(info["true_state"]).position) for agent, info in infos.items()}
        beyond = {agent for agent, distance in away.items() if distance > 161}
        if 0 < len(beyond) < 3 and all(abs(distance - 160) > 1 for distance in away.values()):
            return seed, beyond
    raise AssertionError("no seed of a hundred starts so")


def test_parallel_api():
    with warnings.catch_warnings():
        warnings.filterwarnings("error")
        warnings.filterwarnings("ignore", message="unknown reset option 'options'")
        parallel_api_test(make(), num_cycles=20)


def test_seeds():
    parallel_seed_test(make, num_cycles=20)


def test_aec_api():
    with warnings.catch_warnings():
        warnings.filterwarnings("error")
        warnings.filterwarnings("ignore", message="unknown reset option 'options'")
        warnings.filterwarnings("ignore", message=".*imum observation space value is.*infinity")
        warnings.filterwarnings("ignore", message="Environment has not defined a render")
        api_test(aec_env(3, **SHORT), num_cycles=20)


def test_agents_leave_when_their_episodes_end():
    env = make()
    _, beyond = leaving_apart(env)
    assert env.agents == ["chaser_0", "chaser_1", "chaser_2"] == env.possible_agents
    first = env.step({agent: PUSH for agent in env.agents})
    assert all(set(part) == set(env.possible_agents) for part in first)
    assert {agent for agent, ended in first[2].items() if ended} == beyond
    assert env.agents == [agent for agent in env.possible_agents if agent not in beyond]
    assert all(first[4][agent]["outcome"] == Outcome.ESCAPED for agent in beyond)
    for _ in range(4):
        acting = list(env.agents)
        observations, rewards, _, truncated, infos = env.step({agent: PUSH for agent in acting})
        assert set(observations) == set(rewards) == set(infos) == set(acting)
    assert all(truncated.values()) and not env.agents
    assert {info["outcome"] for info in infos.values()} == {Outcome.TIMEOUT}
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_one_compilation_whatever_seeds_ports_and_lengths():
    env = parallel_env(3, **SHORT, chaser={"mass": 11_000.0})
    for seed, ports in [(0, ["zvezda_aft"]), (1, None), (None, ["unity_nadir", None, "pirs_nadir"])]:
        env.reset(seed=seed, options={"dock_ports": ports})
        while env.agents:
            env.step({agent: PUSH for agent in env.agents})
    assert parallel_env(3, **SHORT, chaser={"mass": 11_000.0}).traces == {"reset": 1, "step": 1}
    assert not jax.config.jax_enable_x64


def test_ports_are_assigned_or_drawn_and_distinct():
    env = make()
    for seed in range(5):
        _, infos = env.reset(seed=seed, options={"dock_ports": [None, "zvezda_aft"]})
        ports = [infos[agent]["port"] for agent in env.agents]
        assert PORT_NAMES[ports[1]] == "zvezda_aft" and len(set(ports)) == 3


def test_without_a_seed_episodes_follow_from_the_first():
    runs = []
    for _ in range(2):
        env = make()
        env.reset(seed=5)
        runs.append([env.reset()[0]["chaser_1"], env.reset()[0]["chaser_1"]])
    np.testing.assert_array_equal(*runs)
    assert (runs[0][0] != runs[0][1]).any()


def test_observations_are_measured_and_infos_true():
    env = make()
    observations, infos = env.reset(seed=2)
    position = {agent: View.of(info["true_state"]).position for agent, info in infos.items()}
    for agent, others in [("chaser_0", ["chaser_1", "chaser_2"]), ("chaser_1", ["chaser_0", "chaser_2"])]:
        seen = observations[agent]
        assert env.observation_space(agent).contains(seen)
        np.testing.assert_allclose(env.layout.own.measured_view(seen), infos[agent]["measured_state"], rtol=1e-5)
        for row, other in zip(env.layout.others(seen), others):
            off = np.linalg.norm(row[:3] - (position[other] - position[agent]))
            assert 0 < off < 0.3
    assert infos["chaser_0"]["true_state"].dtype == np.float64 and infos["chaser_0"]["port"].dtype == np.int32
    state = env.state()
    assert env.state_space.contains(state)
    np.testing.assert_allclose(state.reshape(3, 26)[1, :VIEW_SIZE], infos["chaser_1"]["true_state"], rtol=1e-6)
    assert state.reshape(3, 26)[:, 25].tolist() == [1, 1, 1]


def test_bad_input_is_named():
    env = make()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step({})
    env.reset(seed=leaving_apart(env)[0])
    good = {agent: PUSH for agent in env.agents}
    with pytest.raises(ValueError, match="action of chaser_1 must be finite"):
        env.step({**good, "chaser_1": np.array([0, np.nan, 0, 0, 0, 0])})
    with pytest.raises(ValueError, match=r"chaser_2 must have shape \(6,\), got \(5,\)"):
        env.step({**good, "chaser_2": np.zeros(5)})
    with pytest.raises(ValueError, match=r"action of chaser_2 must be real numbers of shape \(6,\), got complex64"):
        env.step({**good, "chaser_2": PUSH.astype(np.complex64)})
    with pytest.raises(ValueError, match="no action for chaser_0"):
        env.step({agent: good[agent] for agent in ("chaser_1", "chaser_2")})
    with pytest.raises(ValueError, match="did you mean 'chaser_1'"):
        env.step({**good, "chaser1": PUSH})
    with pytest.raises(ValueError, match="did you mean 'zvezda_aft'"):
        env.reset(options={"dock_ports": ["zvezda_aff"]})
    with pytest.raises(ValueError, match="distinct"):
        env.reset(options={"dock_ports": ["zvezda_aft", "zvezda_aft"]})
    with pytest.raises(ValueError, match="at most 3"):
        env.reset(options={"dock_ports": ["zvezda_aft"] * 4})
    with pytest.warns(UserWarning, match="did you mean 'dock_ports'"):
        env.reset(options={"dock_port": ["zvezda_aft"]})
    with pytest.raises(ValueError, match="render_mode"):
        make(render_mode="human")
    with pytest.raises(ValueError, match="did you mean 'station_top'"):
        make(render_mode="rgb_array", camera_name="station_tpo")
    with pytest.raises(ValueError, match="from 1 to 8"):
        parallel_env(9)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_as_the_original(duplicate):
    env = make()
    env.reset(seed=leaving_apart(env)[0])
    env.step({agent: PUSH for agent in env.agents})
    twin = duplicate(env)
    assert twin.agents == env.agents
    mine, theirs = (e.step({agent: PUSH for agent in e.agents})[4] for e in (env, twin))
    for agent in mine:
        np.testing.assert_allclose(theirs[agent]["true_state"], mine[agent]["true_state"], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(env.reset()[0]["chaser_0"], twin.reset()[0]["chaser_0"])


def test_rgb_array_shows_every_chaser():
    env = make(render_mode="rgb_array", width=480, height=270)
    env.reset(seed=0)
    pictures = [env.render()]
    env.step({agent: PUSH for agent in env.agents})
    pictures.append(env.render())
    assert pictures[0].dtype == np.uint8 and pictures[0].shape == (270, 480, 3)
    for colour in COLOURS[:3]:
        assert np.all(np.abs(pictures[0].astype(int) - colour) < 12, axis=-1).sum() > 20
    assert (pictures[0] != pictures[1]).any()
