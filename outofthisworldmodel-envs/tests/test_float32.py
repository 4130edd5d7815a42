"""`iss-numerical` in float32: within a millimetre of float64 over an episode, in JAX's 64-bit mode or out of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_angle
from owm_envs.adapters import batch
from owm_envs.adapters.gymnasium import DockingVectorEnv
from owm_envs.env import DockingEnv
from owm_envs.task.events import Outcome

STARTS, STEPS = 12, 7200  # of 0.05 s: 360 s
CONFIG = {
    "fidelity": "iss-numerical",
    "noise": "cooperative",
    "collision_terminates": False,
    "escape_radius": 3000.0,
    "horizon": 400.0,
}
WEEK = 7 * 86_400.0


def directions(generator, size):
    vectors = generator.normal(size=(STARTS, size))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def starts():
    """Views out to 225 m and epochs of the week in float32, and wrenches of which a third are zero."""
    generator = np.random.default_rng(0)
    radii = np.linspace(5, 225, STARTS)[:, None]
    parts = radii * directions(generator, 3), 0.2 * directions(generator, 3), directions(generator, 4)
    view = np.concatenate([*parts, 0.005 * directions(generator, 3)], axis=1).astype(np.float32)
    since = np.linspace(0, WEEK - 400, STARTS) + 0.37
    day, seconds = divmod(since, 86_400.0)
    wrench = generator.normal(size=(STARTS, 6)) * ([300] * 3 + [50] * 3)
    wrench[::3] = 0
    return view, day, seconds.astype(np.float32), wrench.astype(np.float32)


def profile(wrench, k):
    """A wrench that turns round every 36 s, its torque every 18 s."""
    signs = jnp.stack([1 - 2 * (k // 720 % 2), 1 - 2 * (k // 360 % 2)]).astype(wrench.dtype)
    return wrench * jnp.repeat(signs, 3)


@pytest.fixture(scope="module")
def narrow(quick):
    """The whole environment in float32, outside the 64-bit mode: (env, params, reset, fly), of a batch."""
    env = DockingEnv(precision="float32", **CONFIG)
    params = env.default_params()

    def fly(params, state, wrench, steps):
        """So many decisions, each piece of the profile held; the last result and info."""

        def one(state, wrench):
            zero = jax.tree.map(
                lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(env.step, params, state, wrench)[1]
            )
            step = lambda k, carry: env.step(params, carry[0], profile(wrench, k))
            state, result = jax.lax.fori_loop(0, steps, step, (state, zero))
            return state, result, env.info(params, state)

        return jax.vmap(one)(state, wrench)

    return env, params, quick(jax.vmap(lambda key: env.reset(params, key=key))), quick(fly)


@pytest.fixture(scope="module")
def keys():
    return batch.seed_keys(list(range(40, 40 + STARTS)))


def epochs(params, day, seconds, dtype):
    reference = np.asarray(params.chief.epoch, np.float64)
    return np.stack([reference[0] + day, reference[1] + seconds.astype(np.float64)], axis=1).astype(dtype)


def test_within_a_millimetre_of_float64_over_an_episode(narrow, starts, keys, quick):
    view, day, seconds, wrench = starts
    env, params, reset, fly = narrow
    state, _ = reset(keys)
    place = jax.vmap(env.dynamics.init, (None, 0, 0))
    physics = place(params, epochs(params, day, seconds, np.float32), view)
    state = state._replace(physics=physics, view=jnp.asarray(view))
    state, _, info = fly(params, state, wrench, STEPS)
    assert (state.outcome == Outcome.RUNNING).all() and (state.count == STEPS).all()
    ours = np.asarray(info["true_state"], np.float64)

    with jax.enable_x64(True):
        wide = DockingEnv(precision="float64", **CONFIG)
        params64 = wide.default_params()

        def drift(epoch, view, wrench):
            def step(state, k):
                return wide.dynamics.step(params64, state, profile(wrench, k), params64.dt), None

            state = wide.dynamics.init(params64, epoch, view)
            state, _ = jax.lax.scan(step, state, jnp.arange(STEPS, dtype=jnp.int32))
            return wide.dynamics.relative_state(params64, state)

        start = epochs(params64, day, seconds, np.float64), view.astype(np.float64), wrench.astype(np.float64)
        expected = np.asarray(quick(jax.vmap(drift))(*start))
        turned = jax.vmap(quat_angle)(jnp.asarray(ours[:, 6:10]), jnp.asarray(expected[:, 6:10]))

    errors = [np.linalg.norm((ours - expected)[:, part], axis=1) for part in (slice(3), slice(3, 6), slice(10, 13))]
    moved = np.linalg.norm(expected[:, :3] - view[:, :3], axis=1)
    assert moved.min() > 5 and moved.max() > 300
    # Measured: 0.2 mm, 3e-6 m/s, 2e-6 rad, 1e-8 rad/s.
    for error, bound in zip([*errors, np.asarray(turned)], (1e-3, 1e-5, 1e-7, 1e-5)):
        assert error.max() < bound
    assert np.abs(np.asarray(state.physics.elapsed) - 360).max() < 1e-4
    np.testing.assert_allclose(np.linalg.norm(ours[:, 6:10], axis=1), 1, atol=1e-6)


def test_nothing_is_float64_outside_the_64_bit_mode(narrow, keys):
    env, params, reset, _ = narrow
    state, observation = jax.eval_shape(reset, keys)
    stepped = jax.eval_shape(jax.vmap(env.step, (None, 0, None)), params, state, jnp.zeros(6, jnp.float32))
    info = jax.eval_shape(jax.vmap(env.info, (None, 0)), params, state)
    names = {leaf.dtype.name for leaf in jax.tree.leaves((params, state, observation, stepped, info))}
    assert names == {"float32", "int32", "bool", "key<fry>"}
    same = jax.tree.map(lambda a, b: (a.shape, a.dtype) == (b.shape, b.dtype), stepped[0], state)
    assert all(jax.tree.leaves(same))  # a scan carries it


def test_the_64_bit_mode_changes_no_operation(narrow):
    """The programs are letter by letter the same: so are their numbers."""
    env, params, *_ = narrow
    numbers = jax.device_get(params)

    def programs():
        params, key = jax.tree.map(jnp.asarray, numbers), jax.random.key(0)
        state, _ = jax.eval_shape(lambda key: env.reset(params, key=key), key)
        yield str(jax.make_jaxpr(lambda params, key: env.reset(params, key=key))(params, key))
        yield str(jax.make_jaxpr(env.step)(params, state, jnp.zeros(6, jnp.float32)))
        yield str(jax.make_jaxpr(env.info)(params, state))

    outside = list(programs())
    with jax.enable_x64(True):
        within = list(programs())
    for one, other in zip(outside, within):
        assert "f64" not in other and "i64" not in other
        assert one == other


def test_the_gymnasium_adapter_gives_the_same(narrow, keys, starts, quick, monkeypatch):
    """It runs in the 64-bit mode, the functional interface here outside it."""
    _, params, reset, fly = narrow
    state, observation = reset(keys)
    options = quick.keywords["compiler_options"]
    monkeypatch.setattr(batch, "compiler_options", lambda: options)
    adapter = DockingVectorEnv(STARTS, precision="float32", autoreset_mode="disabled", **CONFIG)
    first, info = adapter.reset(seed=40)
    np.testing.assert_allclose(first, observation, rtol=1e-6, atol=1e-6)
    assert info["true_state"].dtype == np.float32
    *_, wrench = starts
    for _ in range(20):
        last, reward, terminated, truncated, info = adapter.step(wrench)
    assert not (terminated | truncated).any()
    _, result, expected = fly(params, state, wrench, 20)
    np.testing.assert_allclose(last, result.observation, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(reward, result.reward, rtol=1e-5, atol=1e-6)
    for name in ("true_state", "measured_state", "epoch", "clearance", "closest_distance"):
        np.testing.assert_allclose(info[name], expected[name], rtol=1e-6, atol=1e-4)
