"""A target that turns: what it sees of a chaser, where a chaser starts, what adapters show, who docks with it."""

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.config import load_config
from owm_envs.config.docking import ball
from owm_envs.config.params import goals_of
from owm_envs.datasets.generate import generate
from owm_envs.datasets.recipe import Request
from owm_envs.dynamics.turning import apparent, seen_at_rest, seen_turning
from owm_envs.env import DockingEnv
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.task.events import Outcome
from owm_envs.task.sensors import TARGET_RATE
from owm_envs.testing import check_env
from owm_envs.view import View

RATE = np.radians([1.5, -3.0, 2.0])
seen = jax.jit(seen_turning)
back = jax.jit(seen_at_rest)

numbers = st.lists(st.floats(-100, 100), min_size=13, max_size=13)
rates = st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3)


def rotation(quaternion):
    return Rotation.from_quat(quaternion[..., [1, 2, 3, 0]])


def tumbling(**changes):
    return load_config(preset="tumbling", **{"fidelity": "iss-hcw", "steps_per_action": 5} | changes)


@settings(max_examples=50, deadline=None)
@given(numbers, rates, st.floats(-100, 600))
def test_there_and_back_again(view, rate, elapsed):
    view, rate = np.array(view), np.array(rate)
    view[6:10] += (np.linalg.norm(view[6:10]) < 1e-3) * np.array([1.0, 0, 0, 0])
    view[6:10] /= np.linalg.norm(view[6:10])
    with jax.enable_x64(True):
        again = back(seen(view, rate, elapsed), rate, elapsed)
    np.testing.assert_allclose(again, view, rtol=0, atol=1e-10)


def test_a_view_is_that_of_scipy_s_rotations(x64):
    """Position, attitude and rate against SciPy; velocity as the position's derivative."""
    rng = np.random.default_rng(0)
    start, velocity, own = rng.normal(size=3) * 50, rng.normal(size=3), np.radians(rng.normal(size=3))
    attitude = Rotation.random(random_state=1)

    def at(time):
        turned = attitude * Rotation.from_rotvec(time * own)
        quaternion = np.roll(turned.as_quat(), 1)
        return View.of(
            np.asarray(seen(np.concatenate([start + time * velocity, velocity, quaternion, own]), RATE, time))
        )

    for time in (0.0, 7.0, 333.0):
        target = Rotation.from_rotvec(time * RATE)
        view, step = at(time), 1e-4
        np.testing.assert_allclose(view.position, target.inv().apply(start + time * velocity), atol=1e-9)
        before, after = at(time - step), at(time + step)
        np.testing.assert_allclose(view.velocity, (after.position - before.position) / (2 * step), atol=1e-6)
        turn = rotation(view.attitude).inv() * rotation(after.attitude)
        np.testing.assert_allclose(view.rate, turn.as_rotvec() / step, atol=1e-5)
        change = (after.velocity - before.velocity) / (2 * step)
        np.testing.assert_allclose(apparent(RATE, view.position, view.velocity), change, atol=1e-6)


@pytest.mark.slow
def test_dynamics_pass_the_check_of_the_house(fidelity):
    check_env(DockingEnv(tumbling(fidelity=fidelity, target={"rate_deg": (1.0, 2.0, -3.0)})))


def test_a_free_flyer_flies_straight_on(docking, x64):
    always = {"target_rate_deg": (0.0, 0.0)}
    config = tumbling(fidelity="iss", target={"rate_deg": tuple(np.degrees(RATE))}, randomization=always)
    _, params, reset, step = docking(**dict(config))
    state, _ = reset(params, key=jax.random.key(3))
    first = View.of(np.asarray(back(state.view, RATE)))
    for _ in range(80):
        state, _ = step(params, state, jnp.zeros(6))
    target = Rotation.from_rotvec(20.0 * RATE)
    last = View.of(np.asarray(state.view))
    np.testing.assert_allclose(target.apply(last.position.copy()), first.position + 20 * first.velocity, atol=1e-9)


def test_starts_are_those_of_a_target_at_rest(docking, x64):
    """The orbit's frame has them as any episode has: hardly moving, whatever the target does."""
    _, params, reset, _ = docking(**dict(tumbling()))
    for seed in range(5):
        state, _ = reset(params, key=jax.random.key(seed))
        rate = np.asarray(state.drawn.target_rate)
        assert 1 <= np.degrees(np.linalg.norm(rate)) <= 5
        view = View.of(np.asarray(back(state.view, rate)))
        assert np.linalg.norm(view.velocity) <= 0.1 and np.linalg.norm(view.rate) <= 0.01
        assert 40 <= np.linalg.norm(view.position) <= 80


@pytest.mark.slow
def test_scalar_and_vector_show_the_same_and_measure_the_rate():
    config = tumbling(noise="cooperative", horizon=10.0)
    one, many = DockingGymEnv(config), DockingVectorEnv(2, config)
    assert isinstance(one.observation_space, gymnasium.spaces.Dict)
    alone, info = one.reset(seed=8)
    beside, _ = many.reset(seed=7)
    for part in ("state", TARGET_RATE):
        np.testing.assert_array_equal(beside[part][1], alone[part])
    rate = info["drawn_target_rate"]
    errors = [alone[TARGET_RATE] - rate]
    for _ in range(30):
        observation, *_ = one.step(np.zeros(6))
        assert observation in one.observation_space
        errors.append(observation[TARGET_RATE] - rate)
    assert 0.6e-5 < np.sqrt(np.mean(np.sum(np.square(errors), axis=1))) < 1.5e-5  # 1e-5 rad/s in all, as configured
    one.close()
    many.close()


def test_the_rate_is_quiet_with_the_rest(docking, x64):
    config = tumbling(noise="cooperative", navigation={"outage_share": 0.5, "outage_duration": 1.0})
    _, params, reset, step = docking(**dict(config))
    state, observation = reset(params, key=jax.random.key(0))
    held, quiet = np.asarray(observation[TARGET_RATE]), 0
    for _ in range(40):
        state, (observation, *_) = step(params, state, jnp.zeros(6))
        valid, rate = bool(observation["state_valid"][0]), np.asarray(observation[TARGET_RATE])
        assert bool(observation["target_rate_valid"][0]) == valid
        assert np.array_equal(rate, held) != valid
        held, quiet = rate, quiet + (not valid)
    assert 10 < quiet < 30


def test_one_at_rest_has_no_such_part():
    env = DockingEnv(load_config(randomization={"mass_scale": (0.9, 1.1)}))
    assert TARGET_RATE not in env.observation_parts and not env.structure.turning
    assert env == DockingEnv(
        load_config(target={"rate_deg": (0.0, 0.0, 0.0)}, randomization={"mass_scale": (0.9, 1.1)})
    )


def test_its_own_hold_pose_is_every_goal():
    goals = goals_of(tumbling(target={"hold": (3.0, 0.0, -4.0)}))
    assert goals.shape == (8, 7)
    np.testing.assert_allclose(goals[:, :3], [[3.0, 0.0, -4.0]] * 8)
    nose = rotation(goals[0, 3:]).apply([0, 0, 1])
    np.testing.assert_allclose(nose, [-0.6, 0, 0.8], atol=1e-12)


def test_the_ball_is_full():
    boxes, rng = np.array(ball(3.0)), np.random.default_rng(0)
    ways = rng.normal(size=(20_000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    reach = (boxes[:, 1] / np.abs(ways)[:, None]).min(axis=2).max(axis=1)
    assert reach.min() > 0.79 * 3 and np.linalg.norm(boxes, axis=2).max() < 3.01


@pytest.mark.parametrize(
    "target, told",
    [
        ({"hold": (0.0, 0.0, 0.0)}, "away from the origin"),
        ({"rate_deg": (0, 0, 400)}, "360"),
        ({"rate": 3}, "rate_deg"),
    ],
)
def test_bad_input_is_named(target, told):
    with pytest.raises(ValueError, match=told):
        load_config(target=target)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [2.0, 5.0])
def test_dock_safe_docks_with_it(rate):
    config = tumbling(noise="cooperative", randomization={"target_rate_deg": (rate, rate)}, horizon=240.0)
    policy, env = VectorPolicy(make_policy("dock-safe", config)), DockingVectorEnv(4, config, autoreset_mode="disabled")
    observation, info = env.reset(seed=[1, 2, 3, 4])
    policy.reset(np.ones(4, bool), info["port"])
    fresh, running = np.ones(4, bool), np.ones(4, bool)
    while running.any():
        action, _ = policy.predict(observation, None, fresh, True)
        fresh = np.zeros(4, bool)
        observation, _, terminated, truncated, info = env.step(np.where(running[:, None], action, 0))
        running &= ~(terminated | truncated)
    assert (info["outcome"] == Outcome.DOCKED).all() and info["clearance"].min() > 1.0
    assert (info["closest_speed"] < 0.1).all() and np.degrees(info["closest_attitude"]).max() < 1.0
    env.close()


def test_what_shows_the_station_says_so(tmp_path):
    with pytest.raises(ValueError, match="pixels show the station"):
        tumbling(observation="pixels")
    with pytest.raises(ValueError, match="draws the station"):
        DockingGymEnv(tumbling(), render_mode="rgb_array")
    with pytest.raises(ValueError, match="datasets are of the station"):
        generate(tmp_path / "set", tumbling(), Request(transitions=10, val_transitions=10))
