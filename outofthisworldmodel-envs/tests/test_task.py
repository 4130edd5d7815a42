from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_angle, quat_conjugate, quat_from_rotation_vector, quat_multiply, quat_rotate
from owm_envs.config import REWARD_PRESETS, load_config
from owm_envs.config.params import params_from_config
from owm_envs.env import DockingEnv, FleetEnv
from owm_envs.station import TRAIN_PORTS, port_index
from owm_envs.task.events import Outcome
from owm_envs.task.navigation import goal_error, measure
from owm_envs.task.observation import ObservationLayout
from owm_envs.task.reset import sample_start
from owm_envs.task.reward import pseudo_huber
from owm_envs.view import VIEW_SLICES, View

QUICK = {"fidelity": "iss"}


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def drawn_start(params, key):
    return sample_start(params, key=key, port=jnp.asarray(-1))


def starts(count=2000, **overrides):
    params = params_from_config(load_config(fidelity="iss", **overrides))
    return params, drawn_start(params, jax.random.split(jax.random.key(0), count))


def test_starts_fill_the_ranges_of_the_task(x64):
    params, drawn = starts()
    position, velocity, attitude, rate = View.of(np.asarray(drawn.view))
    radius = np.linalg.norm(position, axis=1)
    assert 100 <= radius.min() < 102 and 223 < radius.max() <= 225
    assert abs(radius.mean() - 162.5) < 3
    assert 0.097 < np.linalg.norm(velocity, axis=1).max() <= 0.1
    assert 0.0097 < np.linalg.norm(rate, axis=1).max() <= 0.01
    outward = position / radius[:, None]
    assert np.abs(outward.mean(0)).max() < 0.05
    nose = jax.vmap(quat_rotate, (0, None))(jnp.asarray(attitude), jnp.asarray([0.0, 0.0, 1.0]))
    off = np.degrees(np.arccos(-np.sum(np.asarray(nose) * outward, axis=1)))
    assert 9 < off.max() <= 10 and off.min() < 1
    days = np.asarray(drawn.epoch) @ [1, 1 / 86_400] - float(params.chief.epoch[0])
    assert days.min() < 0.05 and 6.95 < days.max() < 7
    assert np.all(np.asarray(drawn.epoch)[:, 0] % 1 == 0)


def test_ports_are_drawn_uniformly_from_the_configured_list(x64):
    _, drawn = starts(ports=TRAIN_PORTS)
    indices, counts = np.unique(drawn.port, return_counts=True)
    assert set(indices) == {port_index(name) for name in TRAIN_PORTS}
    assert counts.min() > 330


def test_the_same_seed_starts_the_same_at_any_rate_of_decision_port_list_and_noise(x64):
    views = [
        np.asarray(starts(4, **overrides)[1].view)
        for overrides in ({}, {"dt": 0.1}, {"preset": "rl", "reset": {"radius_max": 225.0}}, {"ports": ["zvezda_aft"]})
    ]
    for view in views[1:]:
        np.testing.assert_array_equal(view, views[0])


@pytest.mark.parametrize("preset", ["none", "cooperative", "noncooperative"])
def test_noise_has_the_stated_total_rms(x64, preset):
    noise = params_from_config(load_config(noise=preset)).noise
    view = View.of(jnp.asarray([60.0, -80.0, 0.0, 0, 0, 0, 0.5, -0.5, 0.5, 0.5, 0, 0, 0]))
    keys = jax.random.split(jax.random.key(1), 20_000)
    measured = View.of(np.asarray(jax.vmap(lambda key: measure(noise, view, key=key))(keys)))
    angles = np.asarray(jax.vmap(lambda q: quat_angle(q, view.attitude))(jnp.asarray(measured.attitude)))
    total = float(noise.position) + 100 * float(noise.position_per_range)
    rms = lambda x: np.sqrt((x**2).sum(1).mean())
    assert rms(measured.position - view.position) == pytest.approx(total, rel=0.02)
    assert rms(measured.velocity) == pytest.approx(float(noise.velocity), rel=0.02)
    assert np.sqrt((angles**2).mean()) == pytest.approx(float(noise.attitude), rel=0.02, abs=1e-12)
    assert rms(measured.rate) == pytest.approx(float(noise.rate), rel=0.02)


def test_goal_error_is_zero_at_the_goal_and_blind_to_quaternion_signs(x64):
    goal = params_from_config(load_config()).goals[3]
    at_goal = jnp.concatenate([goal[:3], jnp.zeros(3), goal[3:], jnp.zeros(3)])
    np.testing.assert_allclose(goal_error(at_goal, goal), 0, atol=1e-12)
    turn = jnp.asarray([0.1, -0.2, 0.3])
    turned = at_goal.at[VIEW_SLICES.attitude].set(quat_multiply(goal[3:], quat_from_rotation_vector(-turn)))
    for view in (turned, turned.at[VIEW_SLICES.attitude].multiply(-1)):
        np.testing.assert_allclose(goal_error(view, goal)[6:9], turn, atol=1e-12)


@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("has_epoch", [False, True])
def test_layout_reads_back_what_it_writes(x64, normalize, has_epoch):
    layout = ObservationLayout(has_epoch, True, normalize, 61_253.0, (1600.0,) * 3 + (2000.0,) * 3)
    view = jnp.asarray([200.0, -150.0, 30.0, 4.0, -3.0, 1.0, 0.5, 0.5, -0.5, 0.5, 0.01, -0.02, 0.03])
    epoch = jnp.asarray([61_256.0, 43_200.0])
    observation = np.asarray(layout.observe(epoch, view, jnp.zeros(12)))
    assert observation.dtype == np.float32 and observation.shape == (layout.size,) and len(layout.names) == layout.size
    np.testing.assert_allclose(layout.measured_view(observation), view, rtol=1e-6)
    if has_epoch:
        np.testing.assert_allclose(layout.measured_epoch(observation), epoch, rtol=1e-6)
    if normalize:
        assert np.abs(observation).max() <= 1.0
    wrench = np.array([800.0, -1600.0, 0.0, 2000.0, -500.0, 3.0])
    np.testing.assert_allclose(layout.wrench(jnp.asarray(layout.action(wrench))), wrench)


def approach(docking, place, view, action=(0.0,) * 6, **overrides):
    """One step from a view at a port's goal frame of reference."""
    env, params, reset, step = docking(**QUICK, **overrides)
    state, _ = reset(params, key=jax.random.key(0), port=port_index("zvezda_aft"))
    goal = np.asarray(params.goals[port_index("zvezda_aft")])
    view = np.asarray(view(goal))
    return params, *step(params, place(env, params, state, view), jnp.asarray(action, float))


def near_goal(offset=(0, 0, 0), velocity=(0, 0, 0), tilt=(0, 0, 0), rate=(0, 0, 0)):
    def view(goal):
        q = quat_multiply(jnp.asarray(goal[3:]), quat_from_rotation_vector(jnp.radians(jnp.asarray(tilt, float))))
        return np.concatenate([goal[:3] + offset, velocity, q, np.radians(rate)])

    return view


@pytest.mark.parametrize(
    ("view", "outcome"),
    [
        (near_goal(offset=(0.09, 0, 0), velocity=(0, 0, 0.49), tilt=(4.9, 0, 0), rate=(0, 0, 0.49)), Outcome.DOCKED),
        (near_goal(offset=(0.11, 0, 0)), Outcome.RUNNING),
        (near_goal(velocity=(0, 0, 0.51)), Outcome.RUNNING),
        (near_goal(tilt=(5.1, 0, 0)), Outcome.RUNNING),
        (near_goal(rate=(0.51, 0, 0)), Outcome.RUNNING),
        (near_goal(offset=(0, 800.0, 0)), Outcome.ESCAPED),
        (near_goal(offset=(0, -4.0, 0)), Outcome.COLLIDED),
    ],
)
def test_an_episode_ends_as_it_should(x64, docking, place, view, outcome):
    _, state, result = approach(docking, place, view)
    assert int(state.outcome) == outcome
    assert bool(result.terminated) == (outcome != Outcome.RUNNING)
    assert not bool(result.truncated)


def test_a_collision_that_does_not_terminate_is_charged_once_a_decision(x64, docking, place):
    _, state, result = approach(docking, place, near_goal(offset=(0, -4.0, 0)), preset="rl")
    free = approach(docking, place, near_goal(offset=(0, -4.0, 0)), preset="rl", reward={"collision": 0.0})[2]
    assert int(state.outcome) == Outcome.RUNNING and bool(state.collided)
    assert float(result.reward - free.reward) == pytest.approx(-2.0)


@pytest.mark.parametrize("preset", ["data", "rl"])
def test_reward_is_the_paper_s_formula(x64, docking, place, preset):
    weights = REWARD_PRESETS[preset]
    offset, speed, tilt, rate = 10.0, 0.2, 8.0, 0.6
    action = np.array([160.0, 0, 0, 0, -200.0, 0])
    view = near_goal((0, offset, 0), (0, 0, speed), (tilt, 0, 0), (0, 0, rate))
    _, state, result = approach(docking, place, view, action, reward=preset)
    goal = params_from_config(load_config()).goals[port_index("zvezda_aft")]
    position, velocity, attitude, turning = View.of(state.view)
    d = float(np.linalg.norm(position - goal[:3]))
    v = float(np.linalg.norm(velocity))
    angle = float(quat_angle(attitude, goal[3:]))
    w = float(np.linalg.norm(turning))
    gate = weights.gate_far + (1 - weights.gate_far) / (1 + (d / 25.0) ** 2)
    expected = (
        weights.position * (np.sqrt(d**2 + 1) - 1) / 225
        + weights.velocity * (np.sqrt(v**2 + 0.01) - 0.1) / 5
        + gate * weights.attitude * (np.sqrt(angle**2 + 0.05**2) - 0.05) / np.pi
        + gate * weights.rate * (np.sqrt(w**2 + 0.005**2) - 0.005) / 0.05
        + weights.progress * (d - offset) / 225
        + np.exp(-d) * (weights.proximity + weights.alignment * np.exp(-angle / 0.1))
        + weights.effort * (0.1 + 0.1)
    )
    assert float(result.reward) == pytest.approx(expected, abs=1e-9)
    assert float(pseudo_huber(0.0, 1.0, 225.0)) == 0.0


def test_holding_an_action_equals_repeating_it(x64, docking, fidelity):
    key, action = jax.random.key(5), jnp.asarray([500.0, -300.0, 200.0, 100.0, -50.0, 30.0])
    _, params, reset, step = docking(fidelity=fidelity)
    state, _ = reset(params, key=key)
    for _ in range(20):
        state, _ = step(params, state, action)
    _, params, reset, hold = docking(fidelity=fidelity, steps_per_action=20)
    held, _ = hold(params, reset(params, key=key)[0], action)
    np.testing.assert_allclose(held.view, state.view, atol=1e-9)


def test_docking_ends_the_rest_of_a_held_action(x64, docking, place):
    coasting = near_goal(offset=(0, 0.12, 0), velocity=(0, -0.4, 0))
    _, state, _ = approach(docking, place, coasting, steps_per_action=20)
    assert int(state.outcome) == Outcome.DOCKED
    assert float(state.physics.elapsed) == pytest.approx(0.1, abs=0.051)
    assert float(state.closest.distance) < 0.1


def test_an_ended_episode_stays_as_it_is(x64, docking, place):
    *_, step = docking(**QUICK)
    params, state, _ = approach(docking, place, near_goal())
    again, result = step(params, state, jnp.ones(6) * 1000)
    np.testing.assert_array_equal(again.view, state.view)
    assert float(result.reward) == 0 and bool(result.terminated)


def test_the_horizon_truncates(x64, docking):
    _, params, reset, step = docking(**QUICK, horizon=0.1)
    state, _ = reset(params, key=jax.random.key(0))
    state, first = step(params, state, jnp.zeros(6))
    state, second = step(params, state, jnp.zeros(6))
    assert not bool(first.truncated) and bool(second.truncated) and int(state.outcome) == Outcome.TIMEOUT


def test_closest_approach_is_kept(x64, docking, place):
    env, params, reset, _ = docking(**QUICK)
    fly_by = near_goal(offset=(0, 5.0, 1.0), velocity=(0, -0.5, 0))
    state, _ = reset(params, key=jax.random.key(0), port=port_index("zvezda_aft"))
    goal = np.asarray(params.goals[port_index("zvezda_aft")])
    state = place(env, params, state, fly_by(goal))
    run = jax.jit(lambda s: jax.lax.scan(lambda s, _: (env.step(params, s, jnp.zeros(6))[0], None), s, length=300)[0])
    state = run(state)
    assert float(state.closest.distance) == pytest.approx(1.0, abs=1e-6)
    assert float(state.closest.time) == pytest.approx(10.0, abs=0.05)


def test_actions_are_delivered_late_scaled_and_turned_as_configured(x64, docking):
    chaser = {"actuation_delay": 2, "thrust_scale": (0.5,) + (1.0,) * 5, "misalignment": (0.0, 0.0, np.pi / 2)}
    _, params, reset, step = docking(**QUICK, chaser=chaser)
    state, _ = reset(params, key=jax.random.key(3))
    velocities = [View.of(state.view).velocity]
    for _ in range(3):
        state, _ = step(params, state, jnp.asarray([1200.0, 0, 0, 0, 0, 0]))
        velocities.append(View.of(state.view).velocity)
    np.testing.assert_allclose(velocities[2], velocities[0], atol=1e-12)
    gained = quat_rotate(quat_conjugate(View.of(state.view).attitude), velocities[3] - velocities[2])
    np.testing.assert_allclose(gained, [0, 0.0025, 0], atol=1e-5)


def test_the_wrench_limit_is_a_parameter(x64, docking):
    _, params, reset, step = docking(**QUICK)
    state, _ = reset(params, key=jax.random.key(3))
    weak = params._replace(chaser=params.chaser._replace(wrench_limit=params.chaser.wrench_limit * 0.1))
    push = jnp.asarray([1600.0, 0, 0, 0, 0, 0])
    full, tenth = (jnp.linalg.norm(View.of(step(p, state, push)[0].view - state.view).velocity) for p in (params, weak))
    assert float(tenth / full) == pytest.approx(0.1, rel=1e-3)


def test_parameters_can_be_swept_and_differentiated(x64, docking):
    env, params, reset, _ = docking(**QUICK)
    state, _ = reset(params, key=jax.random.key(0))

    def final_speed(mass):
        heavier = params._replace(chaser=params.chaser._replace(mass=mass))
        after, _ = env.step(heavier, state, jnp.asarray([800.0, 0, 0, 0, 0, 0]))
        return jnp.sum(View.of(after.view).velocity ** 2)

    masses = jnp.asarray([6_000.0, 11_999.0, 12_000.0, 12_001.0, 24_000.0])
    speeds, slopes = jax.jit(jax.vmap(jax.value_and_grad(final_speed)))(masses)
    assert len(set(np.asarray(speeds).tolist())) == 5
    assert float(slopes[2]) == pytest.approx(float(speeds[3] - speeds[1]) / 2, rel=1e-5)


def shared_buffers(state):
    """Leaves of a state less the buffers they stand in."""
    leaves = jax.tree.leaves(state)
    data = [jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x for x in leaves]
    return len(data) - len({leaf.unsafe_buffer_pointer() for leaf in data})


def test_a_state_may_be_donated(fidelity):
    """No two leaves of a state that was made outside `jit` share a buffer: none can be given away twice."""
    env = DockingEnv(fidelity=fidelity, precision="float32")
    params = env.default_params()
    state, _ = env.reset(params, key=jax.random.key(0))
    assert shared_buffers(state) == 0
    kept = state._replace(noise_key=None, next_key=None)
    jax.jit(lambda state: state, donate_argnums=0)(kept)


@pytest.mark.slow
def test_a_fleet_s_state_may_be_donated():
    env = FleetEnv(2, fidelity="iss", precision="float32")
    state, _ = env.reset(env.default_params(), key=jax.random.key(0))
    assert shared_buffers(state) == 0
