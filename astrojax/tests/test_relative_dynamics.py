"""Relative acceleration without cancellation, sums without rounding, and hints that change no number."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import compilation
from astrojax.compilation import CPU_OPTIONS, compiler_options, stored
from astrojax.forces import Drag, Environment, ForceModel, PointMass, Spacecraft, ThirdBody, Zonal
from astrojax.propagate import compensated_add, rk4_increment, rk4_step

WORLD = Environment(np.array([-9.4e10, 1.09e11, 4.7e10]), np.array([3.58e8, -1.49e8, -6.0e7]))
CHIEF = np.array([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])
STATION, OWN = Spacecraft(4.2e5, 1500.0, 2.2), Spacecraft(1.2e4, 50.0, 2.3)
FORCES = {"zonal": Zonal(4), "sun": ThirdBody("sun"), "moon": ThirdBody("moon"), "drag": Drag()}


def model(off=()):
    return ForceModel((PointMass(), *(force for name, force in FORCES.items() if name not in off)))


def accel_relative(model, world, chief, separation, station, own):
    return model.relative(0.0, chief[:3], chief[3:], separation[:3], separation[3:], station, own, world)


def accel_directly(model, world, chief, separation, station, own):
    both = chief + separation
    own = model.accel(0.0, both[:3], both[3:], own, world)
    return own - model.accel(0.0, chief[:3], chief[3:], station, world)


def cast(tree, dtype):
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


@pytest.fixture(scope="module")
def separations():
    """Unit directions of position and of velocity, 24 of them."""
    vectors = np.random.default_rng(0).normal(size=(24, 2, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def relative_acceleration(quick):
    """The function under test and the difference of two accelerations, of a batch of separations."""

    return tuple(
        quick(jax.vmap(functools.partial(fn, model()), (None, None, 0, None, None)))
        for fn in (accel_relative, accel_directly)
    )


# Rounding of the difference is 4e-15 m/s^2, the zonal terms' third order 2e-11 at 5 km.
@pytest.mark.parametrize(
    ("distance", "atol", "atol32"), [(1.0, 1e-14, 3e-11), (200.0, 1e-14, 4e-10), (5e3, 3e-11, 1e-8)]
)
def test_relative_acceleration_is_the_difference_of_two(
    relative_acceleration, separations, distance, atol, atol32, x64
):
    ours, directly = relative_acceleration
    separation = np.concatenate([distance * separations[:, 0], distance * 1e-3 * separations[:, 1]], axis=1)
    arguments = (WORLD, CHIEF, separation, STATION, OWN)
    wide = ours(*cast(arguments, jnp.float64))
    np.testing.assert_allclose(wide, directly(*cast(arguments, jnp.float64)), rtol=0, atol=atol)
    narrow = ours(*cast(arguments, jnp.float32))
    assert narrow.dtype == jnp.float32
    np.testing.assert_allclose(narrow, wide, rtol=0, atol=atol32)


@pytest.mark.parametrize("off", FORCES)
def test_each_force_has_its_part(off, x64):
    world, chief, station, own = cast((WORLD, CHIEF, STATION, OWN), jnp.float64)
    separation = jnp.asarray([100.0, -150.0, 90.0, 0.1, -0.1, 0.2])
    accel = accel_relative(model({off}), world, chief, separation, station, own)
    directly = accel_directly(model({off}), world, chief, separation, station, own)
    np.testing.assert_allclose(accel, directly, rtol=0, atol=1e-14)
    assert np.abs(accel - accel_relative(model(), world, chief, separation, station, own)).max() > 1e-12


def test_a_coincident_vehicle_of_the_same_make_feels_nothing():
    """The gradient there is the tidal tensor: finite, and of no trace but for what drag adds."""
    world, chief, station = cast((WORLD, CHIEF, STATION), jnp.float32)
    accel = jax.jit(lambda separation: accel_relative(model({"drag"}), world, chief, separation, station, station))
    np.testing.assert_array_equal(accel(jnp.zeros(6)), 0)
    tensor = jax.jit(jax.jacrev(accel))(jnp.zeros(6))
    assert np.isfinite(tensor).all()
    assert abs(np.trace(tensor[:, :3])) < 1e-11  # Laplace's equation
    assert np.abs(tensor[:, :3]).max() > 1e-6


@pytest.mark.parametrize("options", [None, CPU_OPTIONS], ids=["default", "cpu_options"])
def test_compensated_sum_of_many_small_increments(options):
    increments = np.random.default_rng(0).uniform(0.5, 1.5, (100_000, 2)).astype(np.float32) * np.float32(1e-3)
    start = np.array([6.8e6, -1.0], np.float32)

    def run(increments):
        def add(carry, increment):
            (y, lost), plain = carry
            return (compensated_add(y, lost, increment), plain + increment), None

        carry = ((jnp.asarray(start), jnp.zeros(2, jnp.float32)), jnp.asarray(start))
        return jax.lax.scan(add, carry, increments)[0]

    (total, lost), plain = jax.jit(run, compiler_options=options)(increments)
    exact = start.astype(np.float64) + increments.astype(np.float64).sum(axis=0)
    assert total.dtype == lost.dtype == jnp.float32
    np.testing.assert_array_less(np.abs(total - exact), np.spacing(np.abs(exact).astype(np.float32)) * 1.0001)
    np.testing.assert_allclose(np.float64(total) - np.float64(lost), exact, rtol=1e-10)
    assert abs(float(plain[0]) - exact[0]) > 50  # of 100 m, none of which a plain sum sees


def test_increment_and_step_are_one_method():
    def f(t, y, rate):
        return {"x": y["v"] + t, "v": -rate * y["x"]}

    y = {"x": jnp.asarray([1.0, 2.0]), "v": jnp.asarray([0.5, -0.5])}
    increment = rk4_increment(f, 0.3, y, 0.1, 2.0)
    stepped = rk4_step(f, 0.3, y, 0.1, 2.0)
    jax.tree.map(lambda a, d, b: np.testing.assert_array_equal(a + d, b), y, increment, stepped)


def test_increments_are_of_fourth_order(x64):
    rate = jnp.asarray(1.0)
    errors = [
        abs(float(rk4_increment(lambda t, y: -y * rate, 0.0, jnp.asarray(1.0), h)) - np.expm1(-h)) for h in (0.2, 0.1)
    ]
    assert 28 < errors[0] / errors[1] < 36  # 2^5 a step


@pytest.mark.parametrize("options", [None, CPU_OPTIONS], ids=["default", "cpu_options"])
def test_stored_changes_no_number(options):
    tree = {"a": jnp.linspace(-1, 1, 7, dtype=jnp.float32), "b": (jnp.arange(3, dtype=jnp.int32), jax.random.key(1))}
    for kept in (stored(tree), jax.jit(stored, compiler_options=options)(tree)):
        assert jax.tree.structure(kept) == jax.tree.structure(tree)
        np.testing.assert_array_equal(kept["a"], tree["a"])
        np.testing.assert_array_equal(kept["b"][0], tree["b"][0])
        assert kept["b"][1] == tree["b"][1]

    def f(x, hint):
        y = hint(x * x)
        return jnp.sum(y * jnp.flip(y))

    x = tree["a"]
    with_hint, without = (
        jax.jit(jax.value_and_grad(lambda x, hint=hint: f(x, hint)), compiler_options=options)(x)
        for hint in (stored, lambda y: y)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6), with_hint, without)


def test_compiler_options_are_for_the_cpu_alone(monkeypatch):
    assert compiler_options() == (CPU_OPTIONS if jax.default_backend() == "cpu" else None)
    for backend, expected in (("cpu", CPU_OPTIONS), ("gpu", None), ("tpu", None)):
        monkeypatch.setattr(compilation.jax, "default_backend", lambda backend=backend: backend)
        assert compiler_options() == expected
