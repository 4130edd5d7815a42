import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from owm_envs.config import DockingConfig, load_config
from owm_envs.config.params import params_from_config
from owm_envs.datasets.physics import STEP_TOLERANCE, step_errors
from owm_envs.env import DockingEnv
from owm_envs.task.actuators import actuators_at_rest, deliver
from owm_envs.view import View

LIMIT = np.array([1600.0] * 3 + [2000.0] * 3)
QUANTUM = np.array([400.0] * 3 + [500.0] * 3)
DT = 0.05
STEPS = 120


@pytest.fixture(scope="module")
def fly():
    """Delivers a sequence of commands (T, 6): wrenches (T, 6), quanta (T, 6) and impulse owed (T, 6)."""
    with jax.enable_x64(True):
        chaser = params_from_config(load_config(chaser={"thrusters": "on_off"})).chaser

    def run(commands, minimum_on_time, scale, delay, on_off=True, longest=3):
        mine = chaser._replace(minimum_on_time=minimum_on_time, thrust_scale=scale, actuation_delay=delay)

        def step(state, command):
            state, wrench = deliver(mine, state, command, jnp.asarray(DT))
            pulses = state.pulses
            return state, (wrench, *((pulses.level, pulses.owed) if on_off else ()))

        structure = DockingConfig().structure._replace(longest_delay=longest, on_off=on_off)
        start = actuators_at_rest(structure, commands.dtype)
        return jax.lax.scan(step, start, commands)[1]

    compiled = jax.jit(run, static_argnums=(4, 5))

    def flown(commands, minimum_on_time=DT, scale=(1.0,) * 6, delay=0, **static):
        with jax.enable_x64(True):
            numbers = jnp.asarray(minimum_on_time), jnp.asarray(scale), jnp.asarray(delay, jnp.int32)
            return [np.asarray(x) for x in compiled(jnp.asarray(commands, float), *numbers, *static.values())]

    return flown


def commands(draw, hold):
    """Fractions of the limits, each held for `hold` steps, with a good share of zeros."""
    count = -(-STEPS // hold)
    some = st.one_of(st.just(0.0), st.floats(-1, 1))
    values = draw(st.lists(st.tuples(*[some] * 6), min_size=count, max_size=count))
    return np.repeat(np.array(values), hold, axis=0)[:STEPS] * LIMIT


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_delivered_impulse_is_within_half_a_pulse_of_the_commanded(fly, data):
    wanted = commands(data.draw, data.draw(st.sampled_from([1, 7, 40])))
    wrench, *_ = fly(wanted)
    apart = np.cumsum(wanted - wrench, axis=0) * DT
    assert np.all(np.abs(apart) <= QUANTUM * DT / 2 + 1e-6)


@settings(max_examples=30, deadline=None)
@given(st.data(), st.integers(2, 6))
def test_long_pulses_last_and_stay_within_their_bound(fly, data, length):
    wanted = commands(data.draw, data.draw(st.sampled_from([1, 7, 40])))
    wrench, level, _ = fly(wanted, minimum_on_time=length * DT)
    pulse = QUANTUM * length * DT
    apart = np.cumsum(wanted - wrench, axis=0) * DT
    assert np.all(np.abs(apart) <= pulse / 2 + 2 * LIMIT * (length - 1) * DT + 1e-6)
    for axis in range(6):
        edges = np.flatnonzero(np.diff(level[:, axis], prepend=0.0, append=np.nan))
        for begin, end in itertools.pairwise(edges):
            if level[begin, axis] != 0 and end < STEPS:
                assert end - begin >= length
    started = np.diff(level, axis=0, prepend=0.0) != 0
    assert np.all(level[started] * wanted[started] >= 0)  # a pulse never begins against its command


@pytest.mark.parametrize("length", [1, 5])
@pytest.mark.parametrize("share", [0.01, 0.13, 0.5, 0.77, 1.0])
def test_a_held_command_is_met_on_average_by_whole_quanta(fly, share, length):
    wrench, level, _ = fly(np.tile(share * LIMIT, (STEPS, 1)), minimum_on_time=length * DT)
    np.testing.assert_array_equal(level, np.round(level))
    assert np.all(np.abs(level) <= 4)
    ends = np.arange(length, STEPS + 1, length) - 1
    delivered, wanted = np.cumsum(wrench, axis=0)[ends] * DT, share * LIMIT * (ends[:, None] + 1) * DT
    assert np.all(np.abs(delivered - wanted) <= QUANTUM * (length * DT) * (0.5 + share * 4 * (length > 1)) + 1e-6)
    assert np.abs(delivered[-1] / wanted[-1] - 1).max() < (0.1 if share > 0.1 else 1.0)


def test_no_command_no_thrust_and_no_thrust_against_a_command_that_falls_away(fly):
    assert not fly(np.zeros((STEPS, 6)))[0].any()
    spike = np.zeros((STEPS, 6))
    spike[3] = LIMIT  # one step of a five-step pulse
    wrench, *_ = fly(spike, minimum_on_time=5 * DT)
    np.testing.assert_array_equal(wrench[3:8], np.tile(LIMIT, (5, 1)))
    assert not wrench[8:].any()


def test_a_command_beyond_whole_quanta_does_not_wind_up(fly):
    wrench, _, owed = fly(np.tile(1.4 * LIMIT, (STEPS, 1)))
    np.testing.assert_array_equal(wrench, np.tile(LIMIT, (STEPS, 1)))
    assert np.abs(owed).max() < 1e-6


@pytest.mark.parametrize("on_off", [False, True])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_commands_arrive_late_by_whole_steps_and_scaled(fly, delay, on_off):
    wanted = np.random.default_rng(0).integers(-4, 5, (20, 6)) * QUANTUM
    scale = np.array([0.9, 1.1, 1.0, 0.5, 2.0, 1.0])
    wrench, *_ = fly(wanted, scale=scale, delay=delay, on_off=on_off)
    late = np.concatenate([np.zeros((delay, 6)), wanted])[:20]
    np.testing.assert_allclose(wrench, late * scale, rtol=1e-12)


AFTER = np.arange(STEPS) * DT >= 2.0
FAULTS = {
    "a dead axis": ({"thrust_scale": (0.0,) + (1.0,) * 5}, lambda w: w * [0, 1, 1, 1, 1, 1]),
    "one-sided": ({"one_sided": (0, 1, -1, 0, 0, 0)}, lambda w: np.where(w * [0, 1, -1, 0, 0, 0] < 0, 0, w)),
    "a leak": ({"leak": (0.0, 300.0, 0.0, 0.0, 0.0, 50.0)}, lambda w: w + [0, 300, 0, 0, 0, 50]),
    "a quarter turn about z": (
        {"misalignment": (0.0, 0.0, np.pi / 2)},
        lambda w: np.stack([-w[:, 1], w[:, 0], w[:, 2], -w[:, 4], w[:, 3], w[:, 5]], axis=1),
    ),
}


def delivered_by(config, wanted):
    """What a configuration's thrusters deliver of commands (T, 6), and the state after each."""

    def step(state, command):
        state, wrench = deliver(chaser, state, command, jnp.asarray(DT))
        return state, (wrench, state)

    with jax.enable_x64(True):
        chaser, at_rest = params_from_config(config).chaser, actuators_at_rest(config.structure, jnp.float64)
        return jax.device_get(jax.jit(lambda w: jax.lax.scan(step, at_rest, w)[1])(jnp.asarray(wanted)))


@pytest.mark.parametrize("fault", FAULTS)
def test_thrusters_fail_when_their_time_has_come_and_not_before(fault):
    given, left = FAULTS[fault]
    config = load_config(chaser={"thrust_scale": (0.9,) * 6, "fault": {"time": 2.0} | given})
    wanted = np.random.default_rng(0).uniform(-1, 1, (STEPS, 6)) * LIMIT
    delivered, _ = delivered_by(config, wanted)
    np.testing.assert_allclose(delivered, np.where(AFTER[:, None], left(0.9 * wanted), 0.9 * wanted), atol=1e-9)


def test_what_swings_moves_as_two_bodies_on_a_spring_do():
    """Against SciPy: each body by itself, in an inertial frame, with a wrench that jumps every step."""
    flexible = {"slosh_mass": 2500.0, "slosh_damping": 0.03, "array_inertia": 30_000.0, "array_frequency": 0.4}
    config = load_config(chaser={"flexible": flexible})
    wanted = np.random.default_rng(0).uniform(-1, 1, (STEPS, 6)) * LIMIT
    delivered, state = delivered_by(config, wanted)

    body = np.array([config.chaser.mass] * 3 + list(config.chaser.inertia))
    load = np.repeat([2500.0, 30_000.0], 3)
    spring = load * (2 * np.pi * np.repeat([0.3, 0.4], 3)) ** 2
    damper = 2 * np.repeat([0.03, 0.01], 3) * np.sqrt(spring * load)

    def move(_, at, wrench):
        (x, v), (y, w) = at.reshape(2, 2, 6)
        pull = spring * (y - x) + damper * (w - v)
        return np.concatenate([v, (wrench + pull) / body, w, -pull / load])

    at = np.zeros(24)
    for wrench, came, place in zip(wanted, delivered, state.swing.place, strict=True):
        before, at = at, solve_ivp(move, (0, DT), at, args=(wrench,), rtol=1e-11, atol=1e-13).y[:, -1]
        gained = body * (at[6:12] - before[6:12])
        np.testing.assert_allclose(came * DT, gained, atol=1e-8 * LIMIT.max() * DT)
        np.testing.assert_allclose(place, at[12:18] - at[:6], atol=1e-9)
    momentum = body * at[6:12] + load * at[18:]
    np.testing.assert_allclose(momentum, wanted.sum(axis=0) * DT, rtol=1e-9)


def test_valves_with_hysteresis_follow_a_band_behind():
    config = load_config(chaser={"hysteresis": 0.2})
    wanted = np.array([0.1, 0.3, 0.9, 0.8, 0.6, 0.4, -0.1, -0.5, 0.0, 0.2])[:, None] * LIMIT
    delivered, _ = delivered_by(config, wanted)
    expected = [0.0, 0.1, 0.7, 0.7, 0.7, 0.6, 0.1, -0.3, -0.2, 0.0]
    np.testing.assert_allclose(delivered, np.array(expected)[:, None] * LIMIT, atol=1e-9)


def test_a_delay_grows_to_its_most_under_long_thrust():
    """Full thrust along y holds the pressure down: what comes on x is late by both delays in the end."""
    config = load_config(chaser={"actuation_delay": 2, "delay_growth": 3, "sag_time": 0.2})
    wanted = np.zeros((STEPS, 6))
    wanted[:, 0] = np.where(np.arange(STEPS) < 60, 0, np.random.default_rng(0).uniform(-1, 1, STEPS)) * LIMIT[0]
    wanted[:, 1] = LIMIT[1]
    delivered, state = delivered_by(config, wanted)
    np.testing.assert_allclose(state.sag[:20], 1 - np.exp(-np.maximum(np.arange(20) - 1, 0) * DT / 0.2), atol=1e-9)
    np.testing.assert_allclose(delivered[60:], wanted[55:-5], atol=0.01)


def test_a_delay_does_not_grow_without_thrust():
    """With hardly any thrust it is the fixed one; in between it lies between."""
    wanted = np.random.default_rng(1).uniform(-1, 1, (STEPS, 6)) * LIMIT * 1e-9
    delays = {"actuation_delay": 2}
    fixed, _ = delivered_by(load_config(chaser=delays), wanted)
    growing, state = delivered_by(load_config(chaser=delays | {"delay_growth": 3}), wanted)
    np.testing.assert_allclose(growing, fixed, atol=1e-7 * wanted.max())
    assert (np.diff(state.sag) != 0).any() and state.sag.max() < 1e-8


def test_only_who_may_fail_keeps_a_clock():
    for config, faulty in (
        ({}, False),
        ({"chaser": {"fault": {"time": 5.0}}}, False),
        ({"chaser": {"fault": {"leak": (1.0, 0, 0, 0, 0, 0)}}}, True),
        ({"randomization": {"fault_scale": (0.0, 0.4)}}, True),
        ({"randomization": {"fault_time": (0.0, 9.0)}}, False),
    ):
        assert load_config(config).structure.faulty is faulty
    with pytest.raises(ValueError, match=r"chaser\.fault\.leak"):
        load_config(chaser={"fault": {"leak": (0.0, 2e6, 0.0, 0.0, 0.0, 0.0)}})
    with pytest.raises(ValueError, match="one_sided"):
        load_config(chaser={"fault": {"one_sided": (2, 0, 0, 0, 0, 0)}})


def test_proportional_thrusters_without_delay_keep_no_state():
    assert sum(leaf.size for leaf in jax.tree.leaves(actuators_at_rest(DockingConfig().structure, jnp.float32))) == 0


@pytest.mark.parametrize("thrusters", ["proportional", "on_off"])
def test_an_environment_flies_with_them_and_its_gradient_is_finite(x64, docking, thrusters):
    env, params, reset, step = docking(fidelity="iss", chaser={"thrusters": thrusters, "actuation_delay": 1})
    start, _ = reset(params, key=jax.random.key(0))
    state = start
    push = jnp.asarray([620.0, 0, 0, 0, 0, -130.0])
    for _ in range(41):
        state, _ = step(params, state, push)
    spent = np.linalg.norm(View.of(state.view - start.view).velocity)
    assert float(spent) == pytest.approx(620 * 40 * DT / 12_000, abs=200 * DT / 12_000 + 1e-3)
    slope = jax.jit(jax.grad(lambda a: jnp.sum(View.of(env.step(params, state, a)[0].view).velocity ** 2)))(push)
    assert np.isfinite(slope).all()


@pytest.mark.parametrize(
    ("chaser", "message"),
    [
        ({"thrusters": "onoff"}, "one of|'proportional' or 'on_off'"),
        ({"thrusters": "on_off", "thruster_force": 2000.0}, "thruster_force .* at most force_limit"),
        ({"minimum_on_time": -1.0}, "chaser.minimum_on_time: .* got -1.0 s"),
    ],
)
def test_mistakes_are_named(chaser, message):
    with pytest.raises(ValueError, match=message):
        load_config(chaser=chaser)


def test_recorded_rows_step_anew_only_with_all_that_thrusters_did(x64):
    """Beside a hull and with all on; were any one of them another, the next rows would be."""
    chaser = {"hysteresis": 0.1, "delay_growth": 10, "plume": {"strength": 0.3}, "flexible": {"slosh_mass": 2400.0}}
    others = ({"hysteresis": 0.05}, {"sag_time": 9.0}, {"plume": {"strength": 0.1}}, {"flexible": {"slosh_mass": 1e3}})
    scene = {"fidelity": "iss", "hull": [[[-1.0] * 3, [1.0] * 3]]}
    env = DockingEnv(None, **scene, chaser=chaser)
    params = env.default_params()

    @jax.jit
    def flown(action):
        state, _ = env.reset(params, key=jax.random.key(0))
        beside = View.of(state.view)._replace(position=jnp.asarray([6.0, 0, 0]), attitude=jnp.asarray([1.0, 0, 0, 0]))

        def step(state, push):
            after, _ = env.step(params, state, push)
            return after, {"epoch": env.info(params, state)["epoch"], "observation.environment_state": state.view}

        return jax.lax.scan(step, env.relocate(params, state, beside.numbers()), action)[1]

    action = np.random.default_rng(0).uniform(-1, 1, (6, 6)).repeat(10, axis=0) * LIMIT
    columns = jax.device_get(flown(action)) | {"action": action}
    allowed = np.array(STEP_TOLERANCE["float64"])
    assert (step_errors([columns], env.config) <= allowed).all()
    for other in others:
        assert (step_errors([columns], load_config(**scene, chaser=chaser | other)) > allowed).any(), other
