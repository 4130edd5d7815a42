from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from owm_envs.config import load_config
from owm_envs.config.params import params_from_config
from owm_envs.env import START_SEPARATION, FleetEnv, FleetLayout, FleetState, assign_ports
from owm_envs.policies import make_policy
from owm_envs.station import PORTS, port_index
from owm_envs.task.events import Outcome
from owm_envs.task.navigation import goal_error
from owm_envs.task.separation import swept_separation
from owm_envs.view import VIEW_SIZE, View

RADIUS = 2.25
NAMES = ("zvezda_aft", "poisk_zenith", "unity_nadir")
TO = np.array([port_index(name) for name in NAMES])
PUSH = np.array([[400.0, -300, 200, 100, -50, 30], [-200, 100, 0, 0, 60, 0], [0, 0, 500, 20, 0, -20]])
quick = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})  # halves the compilation
HELD = {"fidelity": "iss", "preset": "rl"}  # 20 steps an action, contact does not terminate


@pytest.fixture(scope="session")
def fleet():
    """Builds (env, params, jitted reset, jitted step) of three chasers once a session; use within `x64`."""
    built = {}

    def build(**overrides):
        key = repr(sorted(overrides.items()))
        if key not in built:
            env = FleetEnv(3, **overrides)
            built[key] = env, env.default_params(), quick(env.reset), quick(env.step)
        return built[key]

    return build


def by_chaser(state, take):
    """`take` on every leaf that has an axis of chasers."""
    physics = state.physics._replace(chaser=jax.tree.map(take, state.physics.chaser))
    return jax.tree.map(take, state._replace(physics=None))._replace(physics=physics)


@lru_cache
def initial(dynamics):
    """A fidelity's `init` of three chasers, compiled once."""
    return quick(jax.vmap(dynamics.init, (None, None, 0)))


def place_fleet(env, params, state, views):
    """A state, of whatever fidelity, as one of `env` with its chasers at views (3, 13)."""
    before = state.chasers.physics
    physics = initial(env.docking.dynamics)(params, before.epoch, views)
    physics = before._replace(chaser=physics.chaser, chief=physics.chief[0])
    unknown = state.chasers.clearance._replace(now=jnp.zeros(3))
    error = quick(jax.vmap(goal_error))(jnp.asarray(views), params.goals[state.chasers.port])
    chasers = state.chasers._replace(physics=physics, view=jnp.asarray(views), error=error, clearance=unknown)
    return state._replace(chasers=chasers)


def coasting(positions, velocities=0.0):
    """Views (3, 13) of chasers that do not turn."""
    positions = np.asarray(positions, float)
    still = np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(positions), 1))
    return np.concatenate([positions, np.broadcast_to(velocities, positions.shape), still], axis=1)


def gap(views):
    """Metres between the centres of the first two chasers."""
    first, second, *_ = View.of(views).position
    return np.linalg.norm(first - second)


CROSSING = coasting(
    [[-6, -150, 1], [6, -150, -1], [120, -100, 0]], [[240.0, 0, 0], [-240, 0, 0], [0, 0, 0]]
)  # 24 m a step against each other, 12 m apart: past each other within a step


# A chaser of a fleet is a chaser


@pytest.mark.slow
def test_chasers_that_do_not_meet_fly_as_alone(x64, fleet, fidelity):
    options = {"fidelity": fidelity, "noise": "cooperative", "steps_per_action": 4, "chaser": {"actuation_delay": 2}}
    env, params, _, step = fleet(**options)
    step_one = quick(env.docking.step)
    state, _ = fleet(fidelity="iss")[2](params, key=jax.random.key(7), ports=TO)
    state = place_fleet(env, params, state, state.chasers.view)
    alone = quick(lambda chasers: [by_chaser(chasers, lambda leaf, i=i: leaf[i]) for i in range(3)])(state.chasers)
    for _ in range(3):
        state, result = step(params, state, PUSH)
        for i in range(3):
            alone[i], single = step_one(params, alone[i], PUSH[i])
            np.testing.assert_allclose(state.chasers.view[i], alone[i].view, rtol=0, atol=1e-9)
            np.testing.assert_allclose(result.reward[i], single.reward, rtol=0, atol=1e-9)
            own = result.observation["state"][i, : env.layout.own.size]
            np.testing.assert_allclose(own, single.observation["state"], rtol=1e-6, atol=1e-6)
    assert len({tuple(view) for view in np.asarray(state.chasers.view).tolist()}) == 3
    info = env.info(params, state)
    assert np.ptp(info["epoch"], axis=0).max() == 0


def test_the_first_chaser_starts_as_a_lone_one_from_the_same_key(x64, fleet):
    env, params, reset, _ = fleet(fidelity="iss")
    state, observations = reset(params, key=jax.random.key(7), ports=TO)
    lone, first = quick(env.docking.reset)(params, key=jax.random.key(7), port=TO[0])
    np.testing.assert_allclose(state.chasers.view[0], lone.view, rtol=0, atol=1e-9)
    np.testing.assert_allclose(observations["state"][0, : env.layout.own.size], first["state"], rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(jax.random.key_data(state.next_key), jax.random.key_data(lone.next_key))


def test_relabelling_the_chasers_relabels_the_flight(x64, fleet):
    env, params, reset, step = fleet(fidelity="iss")
    state = place_fleet(env, params, reset(params, key=jax.random.key(0), ports=TO)[0], CROSSING)
    order = np.array([2, 0, 1])
    turned = FleetState(by_chaser(state.chasers, lambda leaf: leaf[order]), state.separation[order])
    after, result = step(params, state, PUSH)
    other, again = step(params, turned, PUSH[order])
    for name in ("reward", "terminated", "truncated"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name)[order])
    np.testing.assert_allclose(other.separation, after.separation[order], atol=1e-12)
    np.testing.assert_array_equal(other.chasers.outcome, after.chasers.outcome[order])
    np.testing.assert_allclose(other.chasers.view, after.chasers.view[order], atol=1e-12)
    # From 2 one sees 0, 1; relabelled it is 0 and sees what are now 1, 2.
    np.testing.assert_allclose(again.observation["state"][0], result.observation["state"][2], atol=1e-6)


# Contact

separation = jax.jit(swept_separation)


@settings(max_examples=200, deadline=None)
@given(
    ends=st.lists(st.floats(-20, 20), min_size=12, max_size=12),
    still=st.tuples(st.booleans(), st.booleans()),
)
def test_separation_against_sub_steps(ends, still):
    """The oracle samples both tracks at the same times; it is too large by at most half a sample's travel."""
    start, end, other_start, other_end = np.reshape(ends, (4, 3))
    end = start if still[0] else end
    other_end = other_start if still[1] else other_end
    times = np.linspace(0, 1, 4001)[:, None]
    track = other_start + times * (other_end - other_start) - start - times * (end - start)
    sampled = np.linalg.norm(track, axis=1).min()
    travel = np.linalg.norm(other_end - other_start - end + start)
    with jax.enable_x64(True):
        exact = float(separation(start, end, other_start, other_end))
    assert sampled - travel / 8000 - 1e-9 <= exact <= sampled + 1e-9


def test_two_that_pass_through_each_other_within_a_step_have_both_collided(x64, fleet):
    env, params, reset, step = fleet(fidelity="iss")
    state = place_fleet(env, params, reset(params, key=jax.random.key(0), ports=TO)[0], CROSSING)
    after, result = step(params, state, np.zeros((3, 6)))
    assert gap(after.chasers.view) > 2 * RADIUS < gap(CROSSING)
    assert after.chasers.outcome.tolist() == [Outcome.COLLIDED, Outcome.COLLIDED, Outcome.RUNNING]
    assert after.chasers.collided.tolist() == [True, True, False]
    assert result.terminated.tolist() == [True, True, False]
    assert result.reward[0] < -1e5 and result.reward[1] < -1e5 and result.reward[2] > -10
    np.testing.assert_allclose(after.separation[:2], 2 - 2 * RADIUS, atol=1e-9)  # the tracks are 2 m apart
    clear = CROSSING - np.array([[0], [2.6], [0]]) * np.eye(VIEW_SIZE)[2]
    after, result = step(params, place_fleet(env, params, state, clear), np.zeros((3, 6)))
    assert not after.chasers.collided.any() and not result.terminated.any()
    np.testing.assert_allclose(after.separation[:2], 4.6 - 2 * RADIUS, atol=1e-9)


def test_contact_within_a_held_action_is_charged_once(x64, fleet):
    env, params, _, step = fleet(**HELD)
    start, _ = fleet(fidelity="iss")[2](params, key=jax.random.key(0), ports=TO)
    views = coasting([[-20, -150, 0], [20, -150, 0], [120, -100, 0]], [[40.0, 0, 0], [-40, 0, 0], [0, 0, 0]])
    state = place_fleet(env, params, start, views)
    after, result = step(params, state, np.zeros((3, 6)))
    assert gap(after.chasers.view) > 30
    assert after.chasers.collided.tolist() == [True, True, False]
    assert after.chasers.outcome.tolist() == [Outcome.RUNNING] * 3
    free = {**params.reward, "collision": jnp.zeros(())}
    uncharged = step(params._replace(reward=free), state, np.zeros((3, 6)))[1].reward
    np.testing.assert_allclose(result.reward - uncharged, [-2, -2, 0], atol=1e-12)


def test_a_parked_vehicle_is_an_obstacle_and_keeps_its_outcome(x64, fleet):
    env, params, reset, step = fleet(fidelity="iss")
    state, _ = reset(params, key=jax.random.key(0), ports=TO)
    goal = np.asarray(params.goals[TO[0]])
    views = coasting([goal[:3], goal[:3] + [0, 8.0, 0], [120, -100, 0]], [[0, 0.4, 0], [0, -20, 0], [0, 0, 0]])
    View.of(views).attitude[0] = goal[3:]
    parked, result = step(params, place_fleet(env, params, state, views), np.zeros((3, 6)))
    assert parked.chasers.outcome.tolist() == [Outcome.DOCKED, Outcome.RUNNING, Outcome.RUNNING]
    # It is seen at rest where it was captured, whatever its speed then.
    np.testing.assert_allclose(result.observation["state"][1, -12:-9], [0, -7 + 0.02, 0], atol=1e-5)
    np.testing.assert_allclose(result.observation["state"][1, -9:-6], [0, 20, 0], atol=1e-5)
    state = parked
    for _ in range(4):
        state, result = step(params, state, np.full((3, 6), 500.0))
    assert state.chasers.outcome.tolist() == [Outcome.DOCKED, Outcome.COLLIDED, Outcome.RUNNING]
    assert state.chasers.collided.tolist() == [True, True, False]
    assert float(result.reward[0]) == 0 and result.terminated.tolist() == [True, True, False]
    np.testing.assert_array_equal(state.chasers.view[0], parked.chasers.view[0])
    assert float(state.chasers.physics.elapsed) == pytest.approx(0.25)


def test_docking_within_a_held_action_stops_one_and_not_the_others(x64, fleet):
    env, params, _, step = fleet(**HELD)
    state, _ = fleet(fidelity="iss")[2](params, key=jax.random.key(0), ports=TO)
    goal = np.asarray(params.goals[TO[0]])
    views = coasting([goal[:3] + [0, 0.12, 0], [0, 100, 100], [120, -100, 0]], [[0, -0.4, 0], [0, 1, 0], [0, 0, 0]])
    View.of(views).attitude[0] = goal[3:]
    state, _ = step(params, place_fleet(env, params, state, views), np.zeros((3, 6)))
    assert state.chasers.outcome.tolist() == [Outcome.DOCKED, Outcome.RUNNING, Outcome.RUNNING]
    np.testing.assert_allclose(state.chasers.view[:2, 1], [goal[1] + 0.12 - 0.02 * 2, 101], atol=0.021)
    assert float(state.chasers.view[1, 1]) == pytest.approx(101, abs=1e-9)
    assert float(state.chasers.closest.time[0]) <= 0.1


# Starts


@pytest.fixture(scope="session")
def starts(fleet):
    """Many starts of three chasers, the second bound for TO[0]: the states and observations for parameters and keys."""
    env = fleet(fidelity="iss")[0]
    ports = np.array([-1, TO[0], -1])
    return quick(jax.vmap(lambda params, key: env.reset(params, key=key, ports=ports), (None, 0)))


def nearest_pair(state):
    position = np.asarray(View.of(state.chasers.view).position)
    return (np.linalg.norm(position[:, :, None] - position[:, None], axis=-1) + 1e3 * np.eye(3)).min(axis=(1, 2))


def within(params, low, high):
    return params._replace(reset=params.reset._replace(radius_min=jnp.asarray(low), radius_max=jnp.asarray(high)))


def test_starts_are_apart_and_ports_distinct(x64, fleet, starts):
    params = fleet(fidelity="iss")[1]
    keys = jax.random.split(jax.random.key(3), 1000)
    state, _ = starts(within(params, 70.0, 75.0), keys)
    apart = nearest_pair(state)
    assert START_SEPARATION <= apart.min() < 1.5 * START_SEPARATION  # one set in twelve would be nearer
    np.testing.assert_allclose(state.separation.min(axis=1), apart - 2 * RADIUS, atol=1e-9)
    ports = np.asarray(state.chasers.port)
    assert all(len(set(row)) == 3 and row[1] == TO[0] for row in ports.tolist())
    drawn, counts = np.unique(ports[:, [0, 2]], return_counts=True)
    assert set(drawn) == set(range(8)) - {TO[0]} and 220 < counts.min() < counts.max() < 350  # 286 expected of each


def test_where_nobody_fits_the_widest_of_the_sets_is_taken(x64, fleet, starts):
    state, observations = starts(within(fleet(fidelity="iss")[1], 0.5, 1.0), jax.random.split(jax.random.key(3), 1000))
    assert (
        np.isfinite(state.separation).all()
        and np.isfinite(observations["state"]).all()
        and state.chasers.collided.all()
    )
    assert np.median(nearest_pair(state)) > 1.0  # 0.6 m for a single draw


def test_ports_are_assigned_without_replacement():
    for seed in range(20):
        given = assign_ports(jnp.asarray([1, 3, 5]), jnp.asarray([-1, 3, -1]), key=jax.random.key(seed))
        assert given[1] == 3 and set(given.tolist()) == {1, 3, 5}


# What a chaser sees of the others


def test_the_others_are_measured_with_the_noise_of_the_preset(x64, fleet, starts):
    env, params, *_ = fleet(fidelity="iss")
    noise = params.noise._replace(position=jnp.asarray(0.05), velocity=jnp.asarray(0.002))
    state, observations = starts(params._replace(noise=noise), jax.random.split(jax.random.key(0), 1000))
    view = np.asarray(state.chasers.view[..., :6])
    truth = np.stack([view[:, others] - view[:, [i]] for i, others in enumerate(([1, 2], [0, 2], [0, 1]))], axis=1)
    error = env.layout.others(np.asarray(observations["state"])) - truth
    rms = lambda x: np.sqrt((x**2).sum(-1).mean(0))
    np.testing.assert_allclose(rms(error[..., :3]), 0.05, rtol=0.08)
    np.testing.assert_allclose(rms(error[..., 3:]), 0.002, rtol=0.08)
    flat = error[..., :3].reshape(1000, -1)
    assert np.abs(np.corrcoef(flat.T) - np.eye(18)).max() < 0.15  # nobody shares a draw


def test_the_layout_names_every_number():
    env = FleetEnv(3, normalize=True)
    layout = env.layout
    assert layout.size == len(layout.names) == 27 + 12 == len(set(layout.names))
    observation = np.zeros((2, layout.size), np.float32)
    observation[:, layout.names.index("other_1_velocity_z")] = 0.5
    np.testing.assert_allclose(layout.others(observation)[:, 1, 5], 2.5)
    assert FleetEnv(3, observe_others=False).layout == FleetLayout(
        layout.own.__class__(True, True, False, layout.own.reference_day, layout.own.wrench_limit), 0
    )


# Uses


def test_a_batch_of_episodes_equals_each(x64, fleet):
    env, params, reset, step = fleet(fidelity="iss")
    drawn = [reset(params, key=key)[0] for key in jax.random.split(jax.random.key(1), 4)]
    each = [place_fleet(env, params, state, CROSSING) for state in drawn[:2]] + drawn[2:]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    actions = np.stack([PUSH, -PUSH, 2 * PUSH, 0 * PUSH])
    after, result = quick(jax.vmap(env.step, (None, 0, 0)))(params, batch, actions)
    assert after.chasers.view.shape == (4, 3, 13)
    for i in range(4):
        one, single = step(params, each[i], actions[i])
        np.testing.assert_allclose(after.chasers.view[i], one.chasers.view, rtol=0, atol=1e-9)
        np.testing.assert_allclose(result.reward[i], single.reward, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(after.chasers.outcome[i], one.chasers.outcome)
        np.testing.assert_allclose(result.observation["state"][i], single.observation["state"], rtol=1e-6, atol=1e-6)


def test_gradients_are_finite_and_right(x64, fleet):
    env, params, reset, step = fleet(fidelity="iss")
    state, _ = reset(params, key=jax.random.key(0), ports=TO)
    on_top = place_fleet(env, params, state, np.concatenate([CROSSING[:1], CROSSING[:1], CROSSING[2:]]))

    def earned(actions, state, step=env.step):
        after, result = step(params, state, actions)
        exact = jnp.sum(result.reward) + jnp.sum(after.separation) + jnp.sum(after.chasers.view**2)
        return exact + 0 * jnp.sum(
            result.observation["state"]
        )  # nothing, unless the observation's gradient is not finite

    slope = quick(jax.grad(earned))
    assert np.isfinite(slope(0 * PUSH, on_top)).all()
    nudge = 50.0 * np.eye(6)[0] * np.array([[1.0], [0], [0]])
    difference = float(earned(PUSH + nudge, state, step) - earned(PUSH - nudge, state, step))
    assert float(slope(PUSH, state)[0, 0]) * 100 == pytest.approx(difference, rel=1e-3)


def test_three_chasers_dock_side_by_side(x64, fleet):
    """From 15 m up their corridors, by the proportional pilot: all captured, nobody touched anything."""
    env, params, _, step = fleet(**HELD)
    params = params._replace(noise=params_from_config(load_config(noise="cooperative")).noise)
    state, _ = fleet(fidelity="iss")[2](params, key=jax.random.key(0), ports=TO)
    goals = np.asarray(params.goals)[TO]
    views = coasting(goals[:, :3] + 15.0 * np.array([PORTS[port].normal for port in TO]))
    View.of(views).attitude[:] = goals[:, 3:]
    state, result = step(params, place_fleet(env, params, state, views), np.zeros((3, 6)))
    policy = make_policy("dock", env.docking)
    act = quick(jax.vmap(lambda port, observation: policy.act(port, observation)[0]))
    while not (result.terminated | result.truncated).all():
        state, result = step(params, state, act(TO, result.observation))
    info = env.info(params, state)
    assert info["outcome"].tolist() == [Outcome.DOCKED] * 3
    assert not info["collided"].any() and float(info["separation"].min()) > 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_chasers": 9}, "from 1 to 8, the configured ports, got 9"),
        ({"num_chasers": 0}, "got 0"),
        ({"num_chasers": 2, "ports": ["zvezda_aft"]}, "from 1 to 1"),
        ({"ports": ["zvezda_aft"] * 3}, "distinct"),
        ({"nose": "none"}, "did you mean 'noise'"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        FleetEnv(**arguments)
