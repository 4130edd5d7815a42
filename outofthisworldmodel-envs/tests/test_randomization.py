import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_angle, quat_from_rotation_vector, quat_rotate
from owm_envs.config import load_config
from owm_envs.config.params import params_from_config
from owm_envs.env import DockingEnv
from owm_envs.rollout import _start
from owm_envs.task.randomization import draw, episode_params
from owm_envs.view import View

RANGES = {
    "mass_scale": (0.8, 1.3),
    "inertia_scale": (0.9, 1.1),
    "thrust_scale": (0.7, 1.0),
    "misalignment_deg": (1.0, 3.0),
    "actuation_delay": (1, 4),
    "chief_semi_major_axis": (-10_000.0, 20_000.0),
    "chief_eccentricity": (0.0, 0.001),
    "chief_inclination_deg": (-1.0, 2.0),
    "chief_raan_deg": (0.0, 360.0),
    "chief_argument_of_perigee_deg": (0.0, 90.0),
    "chief_mean_anomaly_deg": (-180.0, 180.0),
}
FLOWN = {name: bounds for name, bounds in RANGES.items() if name != "actuation_delay"}
CHASER = {"actuation_delay": 1, "misalignment": (0.0, 0.0, 0.01), "thrust_scale": (0.9,) + (1.0,) * 5}
CONFIG = {"randomization": RANGES, "chaser": CHASER}
BOX = ((0.0, 80.0, 0.0), (1.0, 81.0, 1.0))
PUSH = jnp.array([800.0, -400.0, 300.0, 200.0, 100.0, -50.0], jnp.float32)


@pytest.fixture(scope="module")
def drawn():
    with jax.enable_x64(True):
        ranges = params_from_config(load_config(**CONFIG)).randomization
        keys = jax.random.split(jax.random.key(0), 4000)
        return jax.device_get(jax.jit(jax.vmap(lambda key: draw(ranges, key=key)))(keys))


def columns(drawn):
    return {
        "mass_scale": drawn.mass_scale,
        "inertia_scale": drawn.inertia_scale,
        "thrust_scale": drawn.thrust_scale,
        "misalignment_deg": np.degrees(np.linalg.norm(drawn.misalignment, axis=1)),
        "chief_semi_major_axis": drawn.chief_elements[:, 0],
        "chief_eccentricity": drawn.chief_elements[:, 1],
        "chief_inclination_deg": np.degrees(drawn.chief_elements[:, 2]),
        "chief_raan_deg": np.degrees(drawn.chief_elements[:, 3]),
        "chief_argument_of_perigee_deg": np.degrees(drawn.chief_elements[:, 4]),
        "chief_mean_anomaly_deg": np.degrees(drawn.chief_elements[:, 5]),
    }


def test_draws_fill_their_ranges_uniformly(drawn):
    for name, values in columns(drawn).items():
        low, high = RANGES[name]
        assert values.min() >= low - 1e-9 and values.max() <= high + 1e-9, name
        # Mean and spread of a uniform distribution, at five standard errors of 4000 draws.
        assert np.abs(values.mean(0) - (low + high) / 2).max() < 5 * (high - low) / np.sqrt(12 * 4000), name
        assert np.abs(values.std(0) * np.sqrt(12) / (high - low) - 1).max() < 0.06, name
    steps, counts = np.unique(drawn.actuation_delay, return_counts=True)
    assert steps.tolist() == [1, 2, 3, 4] and counts.min() > 850
    axis = drawn.misalignment / np.linalg.norm(drawn.misalignment, axis=1, keepdims=True)
    assert np.abs(axis.mean(0)).max() < 0.05


def test_draws_are_independent_of_each_other(drawn):
    table = np.stack([np.reshape(v, (len(v), -1))[:, 0] for v in columns(drawn).values()])
    assert np.abs(np.corrcoef(table) - np.eye(len(table))).max() < 0.09
    inside = np.corrcoef(np.concatenate([drawn.inertia_scale, drawn.thrust_scale], axis=1).T)
    assert np.abs(inside - np.eye(9)).max() < 0.09


def test_the_episode_s_numbers_are_the_configured_ones_scaled_and_shifted(x64):
    params = params_from_config(load_config(**CONFIG))
    drawn = jax.jit(lambda ranges: draw(ranges, key=jax.random.key(3)))(params.randomization)
    mine = jax.jit(lambda chaser, chief, drawn: episode_params(params._replace(chaser=chaser, chief=chief), drawn))(
        params.chaser, params.chief, drawn
    )
    assert float(mine.chaser.mass) == pytest.approx(12_000 * float(drawn.mass_scale))
    principal = np.array([80_000, 80_000, 50_000]) * np.asarray(drawn.inertia_scale)
    np.testing.assert_allclose(mine.chaser.inertia, np.diag(principal), rtol=1e-12)
    np.testing.assert_allclose(mine.chaser.thrust_scale, params.chaser.thrust_scale * drawn.thrust_scale)
    np.testing.assert_allclose(mine.chief.elements, params.chief.elements + drawn.chief_elements)
    assert int(mine.chaser.actuation_delay) == 1 + int(drawn.actuation_delay)
    vector = jnp.asarray([0.3, -0.5, 0.8])
    once = quat_rotate(quat_from_rotation_vector(drawn.misalignment), vector)
    twice = quat_rotate(quat_from_rotation_vector(params.chaser.misalignment), once)
    np.testing.assert_allclose(quat_rotate(quat_from_rotation_vector(mine.chaser.misalignment), vector), twice)
    for name in set(params._fields) - {"chaser", "chief"}:
        jax.tree.map(np.testing.assert_array_equal, getattr(mine, name), getattr(params, name))
    assert episode_params(params, None) is params


@pytest.mark.slow
def test_an_episode_flies_as_one_configured_to_what_was_drawn(x64, docking, fidelity):
    """Against the environment without randomisation, configured to the drawn numbers."""
    _, params, reset, step = docking(fidelity=fidelity, randomization=FLOWN)
    first, _ = reset(params, key=jax.random.key(5))
    drawn = jax.device_get(first.drawn)
    names = ("semi_major_axis", "eccentricity", "inclination_deg", "raan_deg", "argument_of_perigee_deg")
    offsets = drawn.chief_elements * np.array([1, 1, *[180 / np.pi] * 4])
    values = offsets + np.array([6_795_000, 0.0005, 51.64, 0, 0, 0])
    config = load_config(
        fidelity=fidelity,
        chief=dict(zip((*names, "mean_anomaly_deg"), values.tolist())),
        chaser={
            "mass": 12_000 * float(drawn.mass_scale),
            "inertia": (np.array([80_000, 80_000, 50_000]) * drawn.inertia_scale).tolist(),
            "thrust_scale": drawn.thrust_scale.tolist(),
            "misalignment": drawn.misalignment.tolist(),
        },
    )
    _, _, reset_plain, step_plain = docking(fidelity=fidelity)
    fixed = params_from_config(config)
    state, expected = first, reset_plain(fixed, key=jax.random.key(5))[0]
    for _ in range(12):
        state, _ = step(params, state, PUSH)
        expected, _ = step_plain(fixed, expected, PUSH)
    ours, theirs, before = (View.of(at.view) for at in (state, expected, first))
    np.testing.assert_allclose(ours.position, theirs.position, rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours.velocity, theirs.velocity, rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours.rate, theirs.rate, rtol=0, atol=1e-10)
    assert float(quat_angle(ours.attitude, theirs.attitude)) < 1e-9
    assert float(jnp.linalg.norm(ours.velocity - before.velocity)) > 0.01


def test_randomisation_moves_no_other_draw(x64, docking):
    noise = params_from_config(load_config(noise="cooperative")).noise
    seen = []
    for ranges in ({}, FLOWN):
        _, params, reset, step = docking(fidelity="iss", **({"randomization": ranges} if ranges else {}))
        params = params._replace(noise=noise)
        state, observation = reset(params, key=jax.random.key(11))
        after, _ = step(params, state, jnp.zeros(6))
        seen.append(
            (observation["state"], state.view, state.port, after.measured["state"] - after.view, after.next_key)
        )
    for plain, randomised in zip(*seen, strict=True):
        if jnp.issubdtype(plain.dtype, jax.dtypes.prng_key):
            plain, randomised = jax.random.key_data(plain), jax.random.key_data(randomised)
        np.testing.assert_allclose(randomised, plain, rtol=0, atol=1e-12)


def test_degenerate_ranges_draw_the_configured_vehicle(x64, docking):
    env, params, reset, _ = docking(fidelity="iss", randomization=FLOWN)
    same = params_from_config(load_config(fidelity="iss")).randomization
    state, _ = reset(params._replace(randomization=same), key=jax.random.key(1))
    mine = episode_params(params, state.drawn)
    np.testing.assert_array_equal(mine.chaser.mass, params.chaser.mass)
    np.testing.assert_array_equal(mine.chief.elements, params.chief.elements)
    np.testing.assert_allclose(mine.chaser.inertia, params.chaser.inertia, rtol=1e-15)
    assert env.info(params, state)["drawn_actuation_delay"] == 0


def test_ranges_are_swept_without_a_new_program(x64):
    env = DockingEnv(fidelity="iss", randomization=FLOWN)
    params = env.default_params()
    traces = []

    @jax.jit
    def masses(scales):
        traces.append(1)

        def one(scale):
            ranges = params.randomization._replace(mass_scale=scale)
            state, _ = env.reset(params._replace(randomization=ranges), key=jax.random.key(2))
            return state.drawn.mass_scale

        return jax.vmap(one)(scales)

    swept = np.asarray(masses(jnp.asarray([[1.0, 1.0], [0.5, 1.5], [2.0, 3.0]])))
    assert swept[0] == 1.0 and 0.5 <= swept[1] <= 1.5 and 2.0 <= swept[2] <= 3.0
    masses(jnp.asarray([[1.0, 1.1], [0.9, 1.5], [2.0, 2.1]]))
    assert len(traces) == 1


def test_configurations_that_differ_in_numbers_are_one_program(x64, docking):
    """Mass, noise, ports, reward, horizon, tolerances, start, orbit and ranges are numbers; switches and sizes not."""
    base, _, reset, _ = docking(fidelity="iss", randomization=FLOWN)
    other = DockingEnv(
        fidelity="iss",
        noise="noncooperative",
        reward="rl",
        ports=["zvezda_aft", "unity_nadir"],
        horizon=100.0,
        dt=0.1,
        chaser={"mass": 9000.0, "radius": 3.0, "force_limit": 900.0},
        chief={"reference_epoch": "2027-01-01T00:00:00Z"},
        docking={"position": 1.0},
        randomization={**FLOWN, "mass_scale": (1.0, 2.0)},
    )
    assert other == base and hash(other) == hash(base) and other.structure == base.structure
    keys, ports = jax.random.split(jax.random.key(0), 2), jnp.asarray([-1, -1])
    before = _start._cache_size()
    _, first = _start(base, base.default_params(), (), keys, ports)
    (state, *_), second = _start(other, other.default_params(), (), keys, ports)
    assert _start._cache_size() == before + 1
    alone, _ = reset(other.default_params(), key=keys[1])
    np.testing.assert_allclose(second.true_state[1], alone.view, rtol=0, atol=1e-9)
    np.testing.assert_allclose(state.drawn.mass_scale[1], alone.drawn.mass_scale)
    assert np.abs(first.epoch - second.epoch)[:, 0].min() > 100
    assert set(np.asarray(state.port).tolist()) <= {3, 7}
    for change in ({"goal_error": False}, {"steps_per_action": 2}, {"normalize": True}, {"obstacles": [BOX]}):
        assert DockingEnv(fidelity="iss", randomization=FLOWN, **change) != base


@pytest.mark.parametrize(
    ("delay", "extra", "same"), [(3, (0, 1), True), (0, (2, 4), True), (4, (0, 0), True), (4, (0, 1), False)]
)
def test_only_the_longest_delay_is_a_size(delay, extra, same):
    def structure(delay, extra):
        ranges = {"mass_scale": (0.9, 1.1), "actuation_delay": extra}
        return load_config(chaser={"actuation_delay": delay}, randomization=ranges).structure

    assert (structure(delay, extra) == structure(0, (0, 4))) == same


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"mass_scale": (1.2, 0.8)}, "randomization.mass_scale: .* low end first"),
        ({"mass_scale": (0.0, 1.0)}, "mass_scale.0: must be at least 0.001, got 0"),
        ({"actuation_delay": (0, -1)}, "actuation_delay.1"),
        ({"misalignment_deg": (0.0, 181.0)}, "must be at most 180.0, got 181"),
        ({"chief_eccentricity": (-0.001, 0.0)}, "chief.eccentricity with its range"),
        ({"chief_semi_major_axis": (-500_000.0, 0.0)}, "chief.semi_major_axis with its range"),
        ({"mas_scale": (1.0, 1.0)}, "did you mean 'randomization.mass_scale'"),
    ],
)
def test_mistakes_are_named(ranges, message):
    with pytest.raises(ValueError, match=message):
        load_config(randomization=ranges)


FAULTS = {"fault_time": (20.0, 90.0), "fault_scale": (0.0, 0.4), "fault_misalignment_deg": (10.0, 45.0)}


def test_faults_are_drawn_within_their_ranges():
    with jax.enable_x64(True):
        ranges = params_from_config(load_config(randomization=FAULTS)).randomization
        keys = jax.random.split(jax.random.key(0), 2000)
        drawn = jax.device_get(jax.jit(jax.vmap(lambda key: draw(ranges, faulty=True, key=key)))(keys))
    fault = drawn.fault
    assert np.all(fault.thrust_scale[:, 3:] == 1)
    axis = fault.thrust_scale[:, :3].argmin(axis=1)
    assert np.bincount(axis).min() > 500
    for values, name in (
        (fault.time, "fault_time"),
        (fault.thrust_scale.min(axis=1), "fault_scale"),
        (np.degrees(np.linalg.norm(fault.misalignment, axis=1)), "fault_misalignment_deg"),
    ):
        low, high = FAULTS[name]
        assert low <= values.min() < low + 0.05 * (high - low) and high - 0.05 * (high - low) < values.max() <= high
    assert np.sum(fault.thrust_scale[:, :3] != 1) == 2000, "one axis in each episode"


def test_an_episode_fails_as_one_configured_to_what_was_drawn(x64, docking):
    """Against the environment without randomisation, configured to the drawn fault."""
    base = {"time": 0.2, "misalignment": (0.0, 0.0, 0.1)}
    ranges = FAULTS | {"fault_time": (0.1, 0.1)}
    _, params, reset, step = docking(fidelity="iss", chaser={"fault": base}, randomization=ranges)
    state, _ = reset(params, key=jax.random.key(5))
    mine = episode_params(params, state.drawn).chaser.fault
    assert float(mine.time) == pytest.approx(0.3)
    told = {name: np.asarray(getattr(mine, name)).tolist() for name in ("time", "thrust_scale", "misalignment")}
    _, fixed, reset_plain, step_plain = docking(fidelity="iss", chaser={"fault": told})
    expected, _ = reset_plain(fixed, key=jax.random.key(5))
    _, plain, reset_sound, step_sound = docking(fidelity="iss")
    sound, _ = reset_sound(plain, key=jax.random.key(5))
    for _ in range(12):
        state, _ = step(params, state, PUSH)
        expected, _ = step_plain(fixed, expected, PUSH)
        sound, _ = step_sound(plain, sound, PUSH)
        np.testing.assert_allclose(state.view, expected.view, rtol=0, atol=1e-9)
    changed = View.of(state.view).velocity - View.of(sound.view).velocity
    assert np.abs(changed).max() > 1e-3
