"""`iss-numerical` in float32: within a millimetre of float64 over an episode, in JAX's 64-bit mode or out of it."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_angle
from owm_envs.adapters import batch
from owm_envs.adapters.gymnasium import DockingVectorEnv
from owm_envs.adapters.seeds import seed_keys
from owm_envs.env import DockingEnv
from owm_envs.view import View

STARTS, STEPS = 12, 7200  # of 0.05 s: 360 s
CONFIG = {"fidelity": "iss-numerical", "noise": "cooperative"}
PLAIN = {**CONFIG, "forces": {"zonal_degree": 0, "sun": False, "moon": False, "drag": False}}  # compiles quicker
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


def episode(quick, precision, view, day, seconds, wrench):
    """Relative views at the end of 7200 steps, in one scan."""
    env = DockingEnv(precision=precision, **CONFIG)
    params, dtype = env.default_params(), np.dtype(precision)
    reference = np.asarray(params.chief.epoch, np.float64)
    epoch = np.stack([reference[0] + day, reference[1] + seconds.astype(np.float64)], axis=1).astype(dtype)

    def fly(epoch, view, wrench):
        def step(state, k):
            return env.dynamics.step(params, state, profile(wrench, k), params.dt), None

        state = env.dynamics.init(params, epoch, view)
        state, _ = jax.lax.scan(step, state, jnp.arange(STEPS, dtype=jnp.int32))
        return state, env.dynamics.relative_state(params, state)

    state, views = quick(jax.vmap(fly))(epoch, view.astype(dtype), wrench.astype(dtype))
    assert {leaf.dtype for leaf in jax.tree.leaves((state, views))} == {dtype}
    np.testing.assert_allclose(state.elapsed, STEPS * 0.05, rtol=1e-6)
    return np.asarray(views, np.float64)


@pytest.mark.slow
def test_within_a_millimetre_of_float64_over_an_episode(starts, quick):
    ours = episode(quick, "float32", *starts)
    with jax.enable_x64(True):
        expected = episode(quick, "float64", *starts)
        q, expected_q = (jnp.asarray(View.of(views).attitude) for views in (ours, expected))
        turned = np.asarray(jax.vmap(quat_angle)(q, expected_q))
    moved = np.linalg.norm(View.of(expected - starts[0]).position, axis=1)
    assert moved.min() > 5 and moved.max() > 300
    position, velocity, _, rate = View.of(ours - expected)
    errors = [np.linalg.norm(part, axis=1) for part in (position, velocity, rate)]
    # Measured: 0.2 mm, 3e-6 m/s, 1e-8 rad/s, 2e-6 rad.
    for error, bound in zip((*errors, turned), (1e-3, 1e-5, 1e-7, 1e-5), strict=True):
        assert error.max() < bound
    np.testing.assert_allclose(np.linalg.norm(View.of(ours).attitude, axis=1), 1, atol=1e-6)


def test_nothing_is_float64_outside_the_64_bit_mode():
    env = DockingEnv(precision="float32", **CONFIG)
    params = env.default_params()
    state, observation = jax.eval_shape(lambda key: env.reset(params, key=key), jax.random.key(0))
    stepped = jax.eval_shape(env.step, params, state, jnp.zeros(6, jnp.float32))
    info = jax.eval_shape(env.info, params, state)
    names = {leaf.dtype.name for leaf in jax.tree.leaves((params, state, observation, stepped, info))}
    assert names == {"float32", "int32", "bool", "key<fry>"}
    same = jax.tree.map(lambda a, b: (a.shape, a.dtype) == (b.shape, b.dtype), stepped[0], state)
    assert all(jax.tree.leaves(same))  # a scan carries it


def test_the_64_bit_mode_changes_no_operation():
    """Only literals and indices are wider there: the equations of motion are letter by letter the same."""
    env = DockingEnv(precision="float32", **CONFIG)
    numbers = jax.device_get(env.default_params())

    def programs():
        params, key, action = jax.tree.map(jnp.asarray, numbers), jax.random.key(0), jnp.zeros(6, jnp.float32)
        state, _ = jax.eval_shape(lambda key: env.reset(params, key=key), key)
        yield str(jax.make_jaxpr(env.dynamics.step)(params, state.physics, action, params.dt))
        yield str(jax.make_jaxpr(env.info)(params, state))
        yield str(jax.make_jaxpr(env.step)(params, state, action))
        yield str(jax.make_jaxpr(lambda key: env.reset(params, key=key))(key))

    outside = list(programs())
    with jax.enable_x64(True):
        within = list(programs())
    assert not any("f64" in program for program in outside)
    assert not any(re.search(r"f64\[\d", program) for program in within)
    for one, other in zip(outside[:2], within[:2]):
        assert re.sub(r"([fi])(nt|loat)?64", lambda found: found[0].replace("64", "32"), other) == one


@pytest.mark.slow
def test_the_gymnasium_adapter_gives_the_same(quick, monkeypatch):
    """It runs in the 64-bit mode, the functional interface here outside it."""
    env, options = DockingEnv(precision="float32", **PLAIN), quick.keywords["compiler_options"]
    params = env.default_params()
    monkeypatch.setattr(batch, "compiler_options", lambda **_: options)
    adapter = DockingVectorEnv(2, precision="float32", autoreset_mode="disabled", **PLAIN)
    first, info = adapter.reset(seed=40)
    assert info["true_state"].dtype == np.float32
    reset, step = quick(jax.vmap(lambda key: env.reset(params, key=key))), quick(jax.vmap(env.step, (None, 0, 0)))
    state, observation = reset(seed_keys([40, 41]))
    np.testing.assert_allclose(first, observation["state"], rtol=1e-6, atol=1e-6)
    wrench = np.array([[300, -200, 100, 50, -40, 30], [0, 0, 0, 0, 0, 0]], np.float32)
    for _ in range(20):
        last, reward, terminated, truncated, info = adapter.step(wrench)
        state, result = step(params, state, wrench)
    assert not (terminated | truncated).any()
    np.testing.assert_allclose(last, result.observation["state"], rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(reward, result.reward, rtol=1e-5, atol=1e-6)
    expected = jax.vmap(env.info, (None, 0))(params, state)
    for name in ("true_state", "measured_state", "epoch", "clearance", "closest_distance"):
        np.testing.assert_allclose(info[name], expected[name], rtol=1e-6, atol=1e-4)


def test_the_station_starts_within_a_kilometre_or_so_of_float64(optimised):
    """As docs/jax.md says: the time since the orbit's reference is rounded, and the station moves 7.7 km a second."""
    day, seconds = np.divmod(np.random.default_rng(0).uniform(0, WEEK, 4000), 86_400.0)
    since = np.stack([day, seconds.astype(np.float32).astype(np.float64)], axis=1)
    view = np.array([50.0, *[0] * 5, 1.0, *[0] * 6])

    def places(precision):
        env = DockingEnv(precision=precision, **PLAIN)
        params = env.default_params()
        epochs = (np.asarray(params.chief.epoch, np.float64) + since).astype(precision)
        begin = jax.vmap(lambda epoch: env.dynamics.init(params, epoch, jnp.asarray(view.astype(precision))).chief[:3])
        return np.asarray(optimised(begin)(epochs), np.float64)

    single = places("float32")
    with jax.enable_x64(True):
        apart = np.linalg.norm(single - places("float64"), axis=1)
    assert 300 < apart.max() < 1200, apart.max()
