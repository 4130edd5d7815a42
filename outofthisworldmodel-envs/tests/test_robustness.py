"""No NaN or infinity ever leaves the environment, whatever it is told to fly and from wherever."""

import importlib.util
import json
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import owm_envs  # noqa: F401 - registers the ids
from owm_envs.adapters.gymnasium import DockingGymEnv
from owm_envs.config import FIDELITIES
from owm_envs.env import DockingEnv
from owm_envs.station import PORT_NAMES, goal_poses, hull_boxes
from owm_envs.task.events import Outcome
from owm_envs.task.navigation import measure
from owm_envs.view import VIEW_SLICES, View

TINY = np.finfo(np.float64).smallest_subnormal
EXTREMES = [0.0, -0.0, TINY, -TINY, 1e-300, 1600.0, -1600.0, 2000.0, 3e38, -4e38, 1e300, -1e300, 1.7976931348623157e308]
UNUSABLE = [np.nan, np.inf, -np.inf]
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def vector(elements, size=3):
    return st.tuples(*[elements] * size)


def toward(longest):
    """A vector of length up to `longest` in any direction."""
    units = vector(st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 1e-3)
    return st.builds(lambda v, size: tuple(np.multiply(v, size / np.linalg.norm(v))), units, st.floats(0, longest))


CORNERS = hull_boxes()[:, [0, 0, 0, 0, 1, 1, 1, 1], :].copy()
for axis, ends in enumerate(([0, 0, 0, 0, 1, 1, 1, 1], [0, 0, 1, 1, 0, 0, 1, 1], [0, 1, 0, 1, 0, 1, 0, 1])):
    CORNERS[:, :, axis] = hull_boxes()[:, ends, axis]
corner = st.sampled_from([tuple(c) for c in CORNERS.reshape(-1, 3)])
positions = st.one_of(
    corner,
    st.builds(lambda c, off: tuple(np.add(c, off)), corner, toward(2.5)),  # at the hull, and just off it
    st.sampled_from([tuple(box.mean(0)) for box in hull_boxes()]),  # inside it
    st.sampled_from([tuple(goal[:3]) for goal in goal_poses()]),
    st.just((0.0, 0.0, 0.0)),
    st.sampled_from([(749.99, 0.0, 0.0), (0.0, 0.0, -749.99), (433.0, -433.0, 433.0)]),  # about to escape
    toward(750.0),
)
velocities = st.one_of(st.just((0.0, 0.0, 0.0)), toward(1.0), toward(1000.0), toward(1e30))
rates = st.one_of(st.just((0.0, 0.0, 0.0)), toward(0.01), toward(50.0), toward(1e30))
attitudes = st.one_of(
    st.sampled_from([IDENTITY, (0.0, 1.0, 0.0, 0.0), (-1.0, 0.0, 0.0, 0.0), *(tuple(g[3:]) for g in goal_poses())]),
    # A length that is lost when it is squared is none, and no attitude.
    vector(st.floats(-1, 1), 4).filter(lambda q: np.linalg.norm(q) > 0.1).map(lambda q: tuple(q / np.linalg.norm(q))),
)
components = st.one_of(
    st.sampled_from(EXTREMES), st.floats(-2000, 2000), st.floats(allow_nan=False, allow_infinity=False)
)
wild = st.one_of(components, st.sampled_from(UNUSABLE))
actions = st.one_of(vector(components, 6), vector(wild, 6))


@pytest.fixture(scope="session")
def fly():
    """Three steps from a view, compiled once a fidelity: the results and infos of each, stacked."""
    compiled = {}

    def build(fidelity):
        env = DockingEnv(fidelity=fidelity, noise="noncooperative", collision_terminates=False, reward="rl")
        params = env.default_params()

        def run(port, view, action):
            state, _ = env.reset(params, key=jax.random.key(0), port=port)
            view = view.at[VIEW_SLICES.attitude].divide(jnp.linalg.norm(View.of(view).attitude))
            state = env.relocate(params, state, view)

            def step(state, _):
                state, result = env.step(params, state, action)
                return state, (result, env.info(params, state))

            return jax.lax.scan(step, state, length=3)[1]

        return jax.jit(run)

    def flown(fidelity, port, view, action):
        with jax.enable_x64(True):
            if fidelity not in compiled:
                compiled[fidelity] = build(fidelity)
            return jax.device_get(compiled[fidelity](port, np.asarray(view, float), np.asarray(action, float)))

    return flown


def assert_finite(tree, where=""):
    for path, leaf in jax.tree.leaves_with_path(tree):
        assert np.isfinite(leaf).all(), f"{where}{jax.tree_util.keystr(path)} is not finite: {leaf}"


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", FIDELITIES)
@settings(max_examples=150, deadline=None)
@given(st.sampled_from(range(len(PORT_NAMES))), positions, velocities, attitudes, rates, actions)
@example(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), IDENTITY, (1e30, -1e30, 1e30), (0.0,) * 6)
@example(3, (749.99, 0.0, 0.0), (1e30, 0.0, 0.0), IDENTITY, (0.0, 0.0, 0.0), (1e300,) * 6)
@example(3, tuple(goal_poses()[3, :3]), (0.0, 0.0, 0.0), tuple(goal_poses()[3, 3:]), (0.0, 0.0, 0.0), (np.nan,) * 6)
def test_nothing_but_numbers_comes_out(fly, fidelity, port, position, velocity, attitude, rate, action):
    result, info = fly(fidelity, port, (*position, *velocity, *attitude, *rate), action)
    assert_finite((result, info))
    for name in ("true_state", "measured_state"):
        np.testing.assert_allclose(np.linalg.norm(View.of(info[name]).attitude, axis=1), 1, atol=1e-9)
    outcomes = [Outcome(int(o)) for o in info["outcome"]]
    if not np.isfinite(action).all():
        assert outcomes == [Outcome.INVALID_ACTION] * 3
        assert result.truncated.all() and not result.terminated.any()
    assert (result.terminated | result.truncated).tolist() == [o != Outcome.RUNNING for o in outcomes]


@pytest.mark.parametrize("fidelity", FIDELITIES)
@settings(max_examples=50, deadline=None)
@given(vector(components, 6))
def test_an_action_outside_the_box_is_clipped(fly, fidelity, action):
    view = (30.0, 60.0, 80.0, *(0.0,) * 3, *IDENTITY, *(0.0,) * 3)
    limit = np.array([1600.0] * 3 + [2000.0] * 3)
    jax.tree.map(
        np.testing.assert_array_equal,
        fly(fidelity, 0, view, action),
        fly(fidelity, 0, view, np.clip(action, -limit, limit)),
    )


def test_the_adapters_clip_what_float32_cannot_hold():
    limit = np.ones(6)
    views = []
    for action in (limit, limit * 1e300):
        env = DockingGymEnv(fidelity="iss", precision="float32", normalize=True)
        env.reset(seed=0)
        views.append(env.step(-action)[4]["true_state"])
    np.testing.assert_array_equal(*views)


def test_a_refused_action_leaves_the_flight_as_it_was():
    env, twin = (gymnasium.make("ISSHCW-v0", noise="cooperative", horizon=0.2) for _ in range(2))
    for each in (env, twin):
        each.reset(seed=0)
    for value in UNUSABLE:
        with pytest.raises(ValueError, match="action must be finite"):
            env.step(np.full(6, value))
    np.testing.assert_array_equal(env.step(np.zeros(6))[0], twin.step(np.zeros(6))[0])


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_a_batch_reports_the_slots_it_was_told_nonsense_and_goes_on(mode):
    env = gymnasium.make_vec("ISSHCW-v0", num_envs=2, autoreset_mode=mode, noise="cooperative", horizon=0.2)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match=r"the actions of slots \[1\] are not finite: their episodes end"):
        observation, reward, _, truncated, info = env.step([[1e300] * 6, [np.inf] * 6])
    end = info["final_info"] if mode == "same_step" else info
    assert end["outcome"][1] == Outcome.INVALID_ACTION and truncated.tolist() == [False, True]
    assert_finite((observation, reward, {name: v for name, v in end.items() if v.dtype.kind == "f"}))
    if mode == "disabled":
        env.reset(options={"reset_mask": truncated})
    for _ in range(2):
        _, _, _, truncated, info = env.step(np.zeros((2, 6)))
    assert info["outcome"].tolist() == [Outcome.RUNNING] * 2 and not truncated.any()


def test_a_spin_beyond_the_integrator_is_a_status(fly, fidelity):
    tumbling = (50.0, 60.0, 70.0, *(0.0,) * 3, *IDENTITY, 1e30, -1e30, 1e30)
    result, info = fly(fidelity, 0, tumbling, (0.0,) * 6)
    assert info["outcome"].tolist() == [Outcome.DIVERGED] * 3
    assert result.truncated.all() and not result.terminated.any()
    np.testing.assert_array_equal(View.of(info["true_state"][0]).position, tumbling[:3])
    assert result.reward[1:].tolist() == [0, 0]


def test_a_measurement_in_the_origin_has_a_gradient(x64):
    noise = DockingEnv(fidelity="iss", noise="noncooperative").default_params().noise
    view = jnp.asarray([0.0] * 6 + [1.0] + [0.0] * 6)
    slope = jax.jit(jax.grad(lambda view: jnp.sum(measure(noise, View.of(view), key=jax.random.key(0)))))(view)
    assert np.isfinite(slope).all()


@pytest.fixture(scope="module")
def soak():
    """The benchmark's own code."""
    file = Path(__file__).parents[1] / "benchmarks" / "soak.py"
    spec = importlib.util.spec_from_file_location("soak", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_short_soak_is_clean(soak, tmp_path):
    report = tmp_path / "soak.json"
    size = ["--fidelities", "iss-hcw", "--batch", "256", "--steps", "60000"]
    assert soak.main([*size, "--json", str(report)]) == 0
    (row,) = json.loads(report.read_text(encoding="utf-8"))
    assert row["steps"] >= 60_000 and row["violations"] == []
    for outcome in ("docked", "collided", "escaped", "invalid_action"):
        assert row["outcomes"][outcome] > 0, outcome


def test_a_soak_tells_what_it_found(soak, x64):
    clean = soak.zero()
    assert soak.violations(clean) == []
    found = clean._replace(not_finite=clean.steps + 3, late=clean.steps + 1, quaternion=jnp.asarray(1e-3))
    assert soak.violations(found) == ["3 not finite", "1 beyond the horizon", "a quaternion off by 1.0e-03"]
