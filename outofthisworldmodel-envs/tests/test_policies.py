import itertools

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_rotate
from owm_envs.env import DockingEnv
from owm_envs.episode import POLICY_NAMES
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.policies.base import pointing_error, read_view
from owm_envs.rollout import episodes, rollout
from owm_envs.station import PORT_NAMES, PORTS, goal_poses, hull_boxes
from owm_envs.task.events import Outcome
from owm_envs.view import View

PULLED = ("random", "orbit", "dock", "excite")
FOLLOWING = ("dock-geodesic", "dock-geodesic-integral")
SAFE = "dock-safe"  # flown by the tests of the package above, which score it: it costs too much to fly twice


@pytest.fixture(scope="module")
def env():
    return DockingEnv(fidelity="iss-hcw", noise="cooperative", steps_per_action=5, collision_terminates=False)


@pytest.fixture(scope="module")
def policies(env, quick_fields):
    from owm_envs.field import solve_field
    from owm_envs.field.eikonal import FieldConfig

    # The most open port and the most hidden one, which stand first: solving takes a second a port.
    # In the other order than the ports, so that a policy must look up which row is whose.
    normals = np.array([port.normal for port in PORTS[1::-1]])
    field = solve_field(hull_boxes(), goal_poses()[1::-1, :3], normals, config=FieldConfig(fine_spacing=2.0))
    built = {name: make_policy(name, env) for name in PULLED}
    return {**built, **{name: make_policy(name, env, geodesic_field=field) for name in (*FOLLOWING, SAFE)}}


@pytest.fixture(scope="module")
def flights(env, policies):
    """Eight whole flights of each policy at 4 Hz: one to each port, or four to each of the two the field knows."""
    names = (*PULLED, *FOLLOWING)
    keys = jax.random.split(jax.random.key(11), 8 * len(names))
    which = np.repeat(np.arange(len(names)), 8)
    ports = np.tile(np.arange(8), len(names))
    ports = np.where(which >= len(PULLED), ports % 2, ports)
    flown = list(episodes(rollout(env, [policies[name] for name in names], keys, ports, which=which)))
    return {name: flown[8 * i : 8 * i + 8] for i, name in enumerate(names)}


def test_every_name_makes_a_policy_of_that_name(policies):
    assert {policy.name for policy in policies.values()} == set(POLICY_NAMES) == set(policies)


def test_an_unknown_name_names_the_nearest(env):
    with pytest.raises(ValueError, match="did you mean 'dock-geodesic'"):
        make_policy("dock-geodesi", env)


def test_dock_reaches_every_port_where_nothing_stands_in_the_way(flights):
    for episode in flights["dock"]:
        assert episode.outcome == Outcome.DOCKED or episode.info["collided"], episode.info


@pytest.mark.parametrize("name", FOLLOWING)
def test_following_the_field_docks_without_touching_the_hull(name, flights):
    for episode in flights[name]:
        assert episode.outcome == Outcome.DOCKED, episode.info
        assert not episode.info["collided"]
        assert len(episode) * 0.25 < 200.0


@pytest.mark.parametrize("name", (*FOLLOWING, SAFE))
def test_following_the_field_is_impossible_to_a_port_it_lacks(name, env, policies):
    policy = policies[name]
    observation = jnp.zeros(env.layout.size).at[env.layout.view.start].set(120.0).at[env.layout.view.start + 6].set(1.0)
    key = jax.random.key(0)
    assert jnp.isfinite(policy.act(policy.init(key, 1), observation)[0]).all()
    assert not jnp.isfinite(policy.act(policy.init(key, 2), observation)[0]).all()


def test_integral_action_holds_off_a_steady_disturbance(env, policies):
    """A rigid body near the goal under 0.02 m/s2 and 5e-4 rad/s2 that no policy is told of."""
    goal = goal_poses()[0].astype(np.float32)
    vehicle = policies["dock-geodesic"].vehicle

    def miss(policy):
        def step(carry, _):
            state, view = carry
            observation = jnp.zeros(env.layout.size).at[env.layout.view].set(view)
            action, state = policy.act(state, observation)
            force, torque = jnp.split(jnp.clip(action, -1600, 1600), 2)
            position, velocity, attitude, rate = View.of(view)
            accel = quat_rotate(attitude, force / vehicle.mass) + jnp.float32([0.02, 0, 0])
            rate = rate + 0.25 * (torque / jnp.float32(vehicle.inertia) + jnp.float32([0, 5e-4, 0]))
            velocity = velocity + 0.25 * accel
            turned = quat_multiply(attitude, quat_from_rotation_vector(0.25 * rate))
            return (state, View(position + 0.25 * velocity, velocity, turned, rate).numbers()), state

        view = jnp.concatenate([goal[:3] + jnp.float32([0, -2, 0]), jnp.zeros(3), goal[3:], jnp.zeros(3)])
        (_, view), states = jax.lax.scan(step, (policy.init(jax.random.key(0), 0), view), length=480)
        position, _, attitude, _ = View.of(view)
        turn = 2 * jnp.linalg.norm(attitude - goal[3:])
        return jnp.linalg.norm(position - goal[:3]), turn, states

    plain, plain_turn, _ = jax.jit(miss)(policies["dock-geodesic"])
    held, held_turn, states = jax.jit(miss)(policies["dock-geodesic-integral"])
    assert plain > 0.1 and held < 0.06
    assert held_turn < 0.4 * plain_turn
    assert jnp.linalg.norm(states.accel, axis=1).max() < 0.041  # 0.3 of 1600 N over 12 t


def test_orbit_keeps_to_a_circle_with_the_nose_at_its_centre(env, flights):
    for episode in flights["orbit"]:
        assert episode.outcome == Outcome.TIMEOUT
        settled = View.of(episode.true_state[len(episode) // 2 :])
        radius = np.linalg.norm(settled.position, axis=1)
        assert np.ptp(radius) < 4.0 and 78.0 < radius.mean() < 132.0
        centripetal = np.linalg.norm(settled.velocity, axis=1) ** 2 / radius * 12_000.0
        assert np.all((centripetal > 0.5 * 960.0) & (centripetal < 1.1 * 960.0))
        nose = -settled.position / radius[:, None]
        views = [
            read_view(env.layout, jnp.asarray(row)) for row in episode.observation["state"][len(episode) // 2 :: 90]
        ]
        errors = [np.linalg.norm(pointing_error(v, jnp.asarray(n))) for v, n in zip(views, nose[::90])]
        assert np.degrees(max(errors)) < 6.0


def test_random_fills_the_whole_range_and_never_repeats(flights):
    actions = np.concatenate([episode.action for episode in flights["random"]]) / ([1600.0] * 3 + [2000.0] * 3)
    assert np.all(np.abs(actions) <= 1.0)
    np.testing.assert_allclose(actions.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(actions.std(axis=0), 1 / np.sqrt(3), atol=0.02)
    assert len(np.unique(actions[:, 0])) > 0.99 * len(actions)


def test_excite_holds_for_two_seconds_and_keeps_rates_in_a_planners_range(flights):
    for episode in flights["excite"]:
        held = episode.action[: len(episode) // 8 * 8].reshape(-1, 8, 6)
        assert np.all(held == held[:, :1])
        assert len(np.unique(held[:, 0, 0])) > len(held) // 2
        assert np.linalg.norm(View.of(episode.true_state).rate, axis=1).max() < 0.2


@pytest.mark.parametrize("name", POLICY_NAMES)
def test_actions_are_in_the_layout_of_a_normalised_environment(name, env, policies):
    scaled = DockingEnv(env.config, normalize=True)
    policy = make_policy(name, scaled, geodesic_field=getattr(policies[name], "field", None))
    key, port = jax.random.key(1), jnp.asarray(1)
    view = np.array([20, 60, -30, 0.5, 0, 0.2, 0.6, 0.8, 0, 0, 0.01, 0, 0], np.float32)
    error = np.zeros(12)
    with jax.enable_x64(True):
        observations = [e.layout.observe(np.zeros(2), view.astype(float), error) for e in (env, scaled)]
    plain, _ = policies[name].act(policies[name].init(key, port), observations[0])
    action, _ = policy.act(policy.init(key, port), observations[1])
    assert action.dtype == jnp.float32
    np.testing.assert_allclose(action * np.array([1600.0] * 3 + [2000.0] * 3), plain, rtol=1e-4, atol=0.05)


def test_no_policy_can_be_taken_for_another(policies):
    """By a cache of compiled programs, which compares structures."""
    structures = [jax.tree.structure(policy) for policy in policies.values()]
    assert all(a != b for a, b in itertools.combinations(structures, 2))


def _observations(env, count):
    rng = np.random.default_rng(0)
    observation = rng.normal(size=(count, env.layout.size)).astype(np.float32)
    position, _, attitude, _ = View.of(observation[:, env.layout.view])
    position *= 100
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return observation


@pytest.mark.parametrize("name", ["random", "orbit", "excite"])
def test_a_slot_whose_episode_starts_forgets_and_the_others_do_not(name, env, policies):
    observations = _observations(env, 3)
    flown, fresh = (VectorPolicy(policies[name], seed=4) for _ in range(2))
    for policy in (flown, fresh):
        policy.reset(ports=np.array([0, 1, 2]))
    for _ in range(3):
        action, _ = flown.predict(observations)
    undisturbed = VectorPolicy(policies[name], seed=4)
    undisturbed.reset(ports=np.array([0, 1, 2]))
    for _ in range(4):
        expected, _ = undisturbed.predict(observations)
    with pytest.warns(UserWarning, match="slot 1 begins an episode, but its port was not announced"):
        action, _ = flown.predict(observations, episode_start=np.array([False, True, False]))
    first, _ = fresh.predict(observations)
    np.testing.assert_array_equal(action[[0, 2]], expected[[0, 2]])
    assert not np.allclose(action[1], expected[1]), "the slot went on as if its episode had not ended"
    assert not np.allclose(action[1], first[1]), "the second episode drew the same numbers as the first"


def test_a_port_that_is_announced_or_is_everyones_is_no_old_one(env, policies, recwarn):
    observations = _observations(env, 3)
    policy = VectorPolicy(policies["dock"])
    policy.reset(ports="zvezda_aft")
    policy.predict(observations, episode_start=np.ones(3, bool))
    policy.predict(observations, episode_start=np.array([False, True, False]))
    policy.reset(mask=np.array([True, False, False]), ports=np.array([1, 2, 3]))
    policy.predict(observations, episode_start=np.array([True, False, False]))
    assert not [w for w in recwarn if "port" in str(w.message)]


def test_reset_moves_the_masked_slots_to_their_new_ports(env, policies):
    observations = np.repeat(_observations(env, 1), 3, axis=0)
    policy = VectorPolicy(policies["dock"])
    policy.reset(ports=np.array([0, 0, 3]))
    before, _ = policy.predict(observations)
    policy.reset(mask=np.array([True, False, False]), ports=["zvezda_aft", "pirs_nadir", "pirs_nadir"])
    after, _ = policy.predict(observations)
    np.testing.assert_array_equal(after[0], before[2])
    np.testing.assert_array_equal(after[1:], before[1:])


def test_predict_takes_state_back_and_single_observations(env, policies):
    observations = _observations(env, 2)
    policy = VectorPolicy(policies["random"], seed=1)
    policy.reset(ports=[1, 2])
    _, state = policy.predict(observations)
    second, _ = policy.predict(observations)
    again, _ = policy.predict(observations, state=state)
    np.testing.assert_array_equal(second, again)
    assert second.dtype == np.float32 and second.shape == (2, 6)
    single = VectorPolicy(policies["dock"])
    single.reset(ports=2)
    assert single.predict(observations[0])[0].shape == (6,)


@pytest.mark.parametrize(
    ("ports", "mask", "observations", "message"),
    [
        ([0, 8], None, None, "from 0 to 7"),
        (["zvezda_aff", "pirs_nadir"], None, None, "did you mean 'zvezda_aft'"),
        (None, [True, True], None, "ports must be given"),
        ([0, 1], None, (3, 25), r"\(2, 25\), got \(3, 25\)"),
        ([0, 1], None, (2, 13), r"\(2, 25\), got \(2, 13\)"),
    ],
)
def test_misuse_is_refused_by_name(policies, ports, mask, observations, message):
    policy = VectorPolicy(policies["dock"])
    with pytest.raises(ValueError, match=message):
        policy.reset(mask=mask, ports=ports)
        policy.predict(np.zeros(observations, np.float32))


@pytest.mark.parametrize("port", ["zvezda_aft", PORT_NAMES.index("zvezda_aft")])
def test_a_single_port_is_that_of_every_slot(env, policies, port):
    observations = _observations(env, 3)
    one, each = (VectorPolicy(policies["random"], seed=1) for _ in range(2))
    for flown in (3, 2):  # however many there are
        one.reset(ports=port)
        each.reset(ports=["zvezda_aft"] * flown)
        np.testing.assert_array_equal(one.predict(observations[:flown])[0], each.predict(observations[:flown])[0])
    again = [True, False]
    one.reset(mask=again, ports=port)
    each.reset(mask=again, ports=["zvezda_aft"] * 2)
    np.testing.assert_array_equal(one.predict(observations[:2])[0], each.predict(observations[:2])[0])
    with pytest.raises(ValueError, match="unknown port 'zvezda'; did you mean 'zvezda_aft'"):
        one.reset(ports="zvezda")


def test_a_policy_is_made_for_whatever_environment_is_at_hand(env):
    made = make_policy("dock", env)
    vector = gymnasium.make_vec("ISSHCW-v0", num_envs=2, config=env.config)
    for subject in (env.config, gymnasium.make("ISSHCW-v0", config=env.config), vector):
        assert make_policy("dock", subject) == made
    for subject in (3, "ISSHCW-v0", gymnasium.make("CartPole-v1")):
        with pytest.raises(TypeError, match=r"env must be a DockingEnv, .*, got (int|str|TimeLimit)"):
            make_policy("dock", subject)


def test_a_seed_that_is_none_is_refused_at_once(policies):
    for seed, told in ((-1, "seed must be an integer of at least 0, got -1"), (2**32, r"seed must be below 2\*\*32")):
        with pytest.raises(ValueError, match=told):
            VectorPolicy(policies["dock"], seed=seed)


def test_predict_before_reset_asks_for_the_ports(policies):
    with pytest.raises(ValueError, match="call reset"):
        VectorPolicy(policies["dock"]).predict(np.zeros((1, 25), np.float32))


def test_an_ended_slot_gets_no_action_until_it_begins_again(env, policies):
    observations = _observations(env, 2)
    policy = VectorPolicy(policies["dock"])
    policy.reset(ports=[0, 1])
    whole, _ = policy.predict(observations)
    policy.active = np.array([True, False])
    part, _ = policy.predict(observations)
    np.testing.assert_array_equal(part, [whole[0], np.zeros(6)])
    policy.reset(mask=[False, True])
    np.testing.assert_array_equal(policy.predict(observations)[0], whole)


def test_the_first_reset_starts_all_slots(policies):
    policy = VectorPolicy(policies["dock"])
    with pytest.raises(ValueError, match=r"mask must have shape \(2,\)"):
        policy.reset(mask=[True], ports=[0, 1])
    with pytest.raises(ValueError, match="must start every slot"):
        VectorPolicy(policies["dock"]).reset(mask=[True, False], ports=[0, 1])
