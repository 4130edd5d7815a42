"""The pure functions under JAX's strictness flags: reset, step and derivatives of every fidelity, fleets, the field."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.env import DockingEnv, FleetEnv, restart_where
from owm_envs.field import FieldConfig, clearance, cost_to_go, solve_field

ALL = {
    "noise": {"position": 0.05, "velocity": 0.002, "bias": {"position": 0.02}},
    "chaser": {"actuation_delay": 2, "thruster_force": 5.0, "thruster_torque": 2.0},
    "randomization": {"mass_scale": (0.9, 1.1), "actuation_delay": (0, 2)},
    "obstacles": [[[30.0, 30.0, 30.0], [31.0, 31.0, 31.0]]],
    "normalize": True,
    "steps_per_action": 2,
}
"""Every option on."""
BATCH = 2


def batched(tree):
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((BATCH, *x.shape), x.dtype), tree)


@pytest.mark.parametrize(
    ("fidelity", "precision"),
    [("iss", "float32"), ("iss-hcw", "float64"), ("iss-numerical", "float32"), ("iss-numerical", "float64")],
)
def test_every_function_of_an_environment_traces(fidelity, precision, jax_flags):
    env, action = DockingEnv(fidelity=fidelity, precision=precision, **ALL), jax.ShapeDtypeStruct((6,), jnp.float32)

    def begin(params, key):
        return env.reset(params, key=key)

    def onward(params, key, action, due, batch):
        """Every pure function once, and a directional derivative."""
        state, observation = env.reset(params, key=key)
        state = env.relocate(params, state, state.view)
        moved, push = jax.jvp(lambda action: env.step(params, state, action), (action,), (action,))
        following = restart_where(env, params, due, *batch)
        return env.info(params, state), observation, moved, push, following

    with jax.enable_x64(precision == "float64"), jax_flags(strict=True):
        params, key = env.default_params(), jax.random.key(0)
        start = jax.eval_shape(begin, params, key)
        out = jax.eval_shape(onward, params, key, action, jax.ShapeDtypeStruct((BATCH,), bool), batched(start))
    info, observation, *_ = out
    assert observation["state"].dtype == jnp.float32
    assert info["true_state"].dtype == precision


def test_every_function_of_a_fleet_traces(jax_flags):
    fleet = FleetEnv(2, fidelity="iss-hcw", precision="float64", **ALL)

    def fly(params, key, actions):
        state, first = fleet.reset(params, key=key)
        state, result = fleet.step(params, state, actions)
        return first, result, fleet.info(params, state)

    with jax.enable_x64(True), jax_flags(strict=True):
        actions = jax.ShapeDtypeStruct((2, 6), jnp.float32)
        first, *_ = jax.eval_shape(fly, fleet.default_params(), jax.random.key(0), actions)
    assert first["state"].shape == (2, fleet.layout.size)


@pytest.mark.slow
def test_nothing_is_leaked_or_moved_and_every_number_is_finite(jax_flags, quick):
    """The flags that look at a program's run, and the search for tracers that outlive their function."""
    env = DockingEnv(fidelity="iss", precision="float32", **ALL)

    def fly(params, key, action):
        state, first = env.reset(params, key=key)
        state, result = env.step(params, state, action)
        numbers = [leaf for leaf in jax.tree.leaves(state) if jnp.issubdtype(leaf.dtype, jnp.floating)]
        return first, result, env.info(params, state), numbers

    given = env.default_params(), jax.random.key(0), jnp.ones(6, jnp.float32)
    expected = quick(fly)(*given)
    watched = {"enable_checks": True, "check_tracer_leaks": True, "debug_nans": True, "debug_infs": True}
    with jax_flags(strict=True, transfer_guard="disallow", **watched):
        flown = quick(lambda *given: fly(*given))(*given)
        jax.block_until_ready(flown)
    for ours, usual in zip(jax.tree.leaves(flown), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(ours, usual)


@pytest.mark.parametrize("x64", [False, True])
def test_the_field_is_solved_and_looked_up(x64, jax_flags):
    box = np.array([[[20.0, -8.0, -8.0], [28.0, 8.0, 8.0]]])
    config = FieldConfig(fine_spacing=4.0, coarse_spacing=8.0, extent=48.0, exact_radius=12.0)
    with jax.enable_x64(x64), jax_flags(strict=True):
        field = solve_field(box, np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]), config=config)
        for dtype in (jnp.float32, jnp.float64)[: 1 + x64]:
            position = jnp.asarray([3.0, 4.0, 0.0], dtype)
            (to_go, uphill), gap = cost_to_go(field, 0, position), clearance(field, position)
            assert (to_go.dtype, uphill.dtype, gap.dtype) == (dtype,) * 3
            assert float(to_go) == pytest.approx(5.0, abs=0.5)
