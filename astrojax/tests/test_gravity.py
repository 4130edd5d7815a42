"""Spherical harmonics against 40-digit arithmetic and brahe, and the fields they are read from."""

import gzip
import pathlib
import runpy

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import forces, orbits
from astrojax.forces import ForceModel, GravityField, PointMass, SphericalHarmonics, gravity_field, load_gfc

HERE = pathlib.Path(__file__).parent
MADE = runpy.run_path(str(HERE.parent / "tools/make_gravity_reference.py"))
PEERS = {"EGM2008": "EGM2008_120", "GGM05S": "GGM05S", "JGM3": "JGM3"}
POLE = np.array([0.0, 0.0, 6.8e6])


@pytest.fixture
def positions(rng):
    directions = rng.normal(size=(40, 3))
    directions[:3] = [[0, 0, 1], [0, 0, -1], [1e-9, 1e-9, 1]]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(6.5e6, 4.2e7, (40, 1))


def made_field(degree):
    return GravityField(MADE["GM"], MADE["RADIUS"], *MADE["coefficients"](degree))


@pytest.mark.parametrize("degree", [120, 200])
def test_against_sixty_digits(degree, quick, x64):
    """3e-14 of the acceleration without its central term (7e-15 measured), poles included; float32 3e-5 (1e-5)."""
    reference = np.load(HERE / "data/gravity_reference.npz")
    points, expected = reference["points"], reference[f"accel_{degree}"]
    field = made_field(degree)
    accel = quick(jax.vmap(lambda r: forces.accel_spherical_harmonics(r, field, degree)))
    size = np.linalg.norm(expected, axis=1)
    error = np.linalg.norm(accel(jnp.asarray(points)) - expected, axis=1) / size
    assert error.max() < 3e-14
    narrow = accel(jnp.asarray(points, jnp.float32))
    assert narrow.dtype == jnp.float32
    assert (np.linalg.norm(narrow - expected, axis=1) / size).max() < 3e-5


@pytest.mark.parametrize(("name", "degree", "order"), [("EGM2008", 120, 120), ("GGM05S", 50, 20), ("JGM3", 70, 0)])
def test_bundled_fields_against_brahe(name, degree, order, positions, quick, x64):
    """2e-14 m/s2, of 9, at every latitude."""
    field = gravity_field(name)
    model = brahe.GravityModel.from_model_type(getattr(brahe.GravityModelType, PEERS[name]))
    assert (field.gm, field.radius) == (model.gm, model.radius)
    ours = quick(
        jax.vmap(
            lambda r: forces.accel_two_body(r, field.gm) + forces.accel_spherical_harmonics(r, field, degree, order)
        )
    )
    theirs = [brahe.accel_gravity_spherical_harmonics(r, np.eye(3), model, degree, order) for r in positions]
    np.testing.assert_allclose(ours(jnp.asarray(positions)), theirs, rtol=0, atol=2e-14)


def test_zonal_terms_are_those_of_the_zonal_force(positions, quick, x64):
    field = gravity_field("EGM2008", 6)
    zonal = quick(jax.vmap(lambda r: forces.accel_zonal(r, 6)))(jnp.asarray(positions))
    ours = quick(jax.vmap(lambda r: forces.accel_spherical_harmonics(r, field, 6, 0)))(jnp.asarray(positions))
    np.testing.assert_allclose(ours, zonal, rtol=0, atol=1e-16)


def test_acceleration_is_the_gradient_of_the_potential(quick, x64):
    """At the pole too, and the gradient of gravity is symmetric and of no trace (Laplace)."""
    field = gravity_field("EGM2008", 12)

    def potential(r):
        return forces.potential_spherical_harmonics(r, field, 12)

    def accel(r):
        return forces.accel_spherical_harmonics(r, field, 12)

    slope, tensor = quick(jax.grad(potential)), quick(jax.jacrev(accel))
    forward = quick(jax.jacfwd(accel))
    for r in (POLE, -POLE, np.array([-3.9e6, 4.4e6, 3.4e6])):
        r = jnp.asarray(r)
        np.testing.assert_allclose(slope(r), accel(r), rtol=0, atol=1e-16)
        gradient = np.asarray(tensor(r))
        np.testing.assert_allclose(forward(r), gradient, rtol=0, atol=1e-21)
        assert np.isfinite(gradient).all() and abs(np.trace(gradient)) < 1e-20
        np.testing.assert_allclose(gradient, gradient.T, rtol=0, atol=1e-21)
        step = np.stack([accel(r + h) - accel(r - h) for h in 10.0 * np.eye(3)]).T / 20.0
        np.testing.assert_allclose(gradient, step, rtol=0, atol=1e-15)


def test_coefficients_are_traced(quick, x64):
    """By the chain rule, dU/dC_nm is the solid harmonic itself; one trace for all fields of a size."""
    field, r = gravity_field("JGM3", 8), jnp.asarray([5e6, -3e6, 4e6])
    traces = []

    def potential(c):
        traces.append(1)
        return forces.potential_spherical_harmonics(r, GravityField(field.gm, field.radius, c, field.s), 8)

    slope = quick(jax.grad(potential))(jnp.asarray(field.c))
    alone = np.zeros_like(field.c)
    alone[5, 3] = 1.0
    compiled = quick(potential)
    np.testing.assert_allclose(compiled(jnp.asarray(alone)) - compiled(jnp.zeros((9, 9))), slope[5, 3], rtol=1e-9)
    compiled(jnp.asarray(field.c))
    assert len(traces) == 2  # one for the gradient
    batch = quick(jax.vmap(potential))(jnp.asarray(np.stack([field.c, alone])))
    np.testing.assert_allclose(batch[0], compiled(jnp.asarray(field.c)), rtol=1e-14)


def test_degree_360_is_finite_and_compiles(quick, x64):
    field = made_field(360)
    both = quick(lambda r: jax.jvp(lambda r: forces.accel_spherical_harmonics(r, field, 360), (r,), (r,)))
    for dtype in (jnp.float64, jnp.float32):
        for r in (POLE, np.array([6.5e6, 1.0, -2.0]), np.array([1.0, 2.0, -6.5e6])):
            assert all(np.isfinite(x).all() for x in both(jnp.asarray(r, dtype)))
    a, b = (both(jnp.asarray([4e6, -4e6, 4e6], d))[0] for d in (jnp.float64, jnp.float32))
    np.testing.assert_allclose(b, a, rtol=0, atol=2e-5 * np.linalg.norm(a))


def test_a_batch_under_strict_flags(jax_flags):
    field = gravity_field("JGM3", 4)
    accel = jax.vmap(lambda r: forces.accel_spherical_harmonics(r, field, 4))
    points = jnp.asarray(np.eye(3) * 7e6, jnp.float32)
    with jax_flags(strict=True):
        shapes = jax.eval_shape(lambda r: jax.jvp(accel, (r,), (r,)), points)
    assert {leaf.dtype for leaf in shapes} == {jnp.dtype("float32")}


def test_a_batch_of_batches(quick, x64):
    field = gravity_field("EGM2008", 12)

    def accel(r):
        return forces.accel_spherical_harmonics(r, field, 12)

    points = jnp.asarray(np.random.default_rng(0).normal(size=(2, 3, 3)) * 1e6 + 5e6)
    nested = quick(jax.vmap(jax.vmap(accel)))(points)
    flat = quick(jax.vmap(accel))(points.reshape(6, 3))
    np.testing.assert_allclose(nested.reshape(6, 3), flat, rtol=1e-13)
    np.testing.assert_allclose(flat[4], quick(accel)(points[1, 1]), rtol=1e-13)
    slopes = quick(jax.vmap(jax.jacrev(accel)))(points.reshape(6, 3))
    np.testing.assert_allclose(slopes[4], quick(jax.jacrev(accel))(points[1, 1]), rtol=1e-12)


def test_as_a_force(quick, x64):
    """The Earth turns under the orbit; in float32 the relative acceleration keeps the separation's digits."""
    field = gravity_field("EGM2008", 20)
    model = ForceModel((PointMass(field.gm), SphericalHarmonics(field, 20)))
    world = model.environment(61253, 43210.0)
    state = orbits.keplerian_to_cartesian(jnp.asarray([6795e3, 0.001, 0.9, 0.7, 0.3, 1.9]))
    r, v, rotation = state[:3], state[3:], np.asarray(world.rotation)
    peer = brahe.GravityModel.from_model_type(brahe.GravityModelType.EGM2008_120)
    expected = brahe.accel_gravity_spherical_harmonics(np.asarray(r), rotation, peer, 20, 20)
    craft = forces.Spacecraft()
    np.testing.assert_allclose(model.accel(0.0, r, v, craft, world), expected, rtol=0, atol=1e-14)
    rho = jnp.asarray([300.0, -500.0, 800.0])
    relative = quick(lambda r, v, rho, world: model.relative(0.0, r, v, rho, 0 * rho, craft, craft, world))
    wide = relative(r, v, rho, world)
    directly = model.accel(0.0, r + rho, v, craft, world) - model.accel(0.0, r, v, craft, world)
    np.testing.assert_allclose(wide, directly, rtol=0, atol=1e-14)
    narrow = relative(*jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (r, v, rho, world)))
    np.testing.assert_allclose(narrow, wide, rtol=0, atol=3e-9)


GFC = """product_type                gravity_field
modelname                   small
earth_gravity_constant      3.986004415E+14
radius                      6378136.3
max_degree                  2
errors                      formal
norm                        fully_normalized
tide_system                 tide_free
key    L    M    C    S    sigma C    sigma S
end_of_head =====================
gfc    0    0    1.0D+00    0.0    0    0
gfc    2    0   -4.84165143790815D-04  0.0D+00  0 0
gfct   2    1   -2.1E-10  1.4e-9  0 0 20000101
trnd   2    1   -1e-12 1e-12 0 0
gfc    2    2    2.4393836e-06 -1.4002737e-06 0 0
"""


def test_icgem_files(tmp_path):
    path = tmp_path / "small.gfc"
    path.write_text(GFC)
    field = load_gfc(path)
    assert (field.degree, field.gm, field.radius) == (2, 3.986004415e14, 6378136.3)
    assert (field.tide_system, field.name) == ("tide_free", "small")
    assert field.c[2].tolist() == [-4.84165143790815e-4, -2.1e-10, 2.4393836e-6]
    assert field.s[2].tolist() == [0.0, 1.4e-9, -1.4002737e-6]
    packed = tmp_path / "small.gfc.gz"
    packed.write_bytes(gzip.compress(GFC.encode()))
    np.testing.assert_array_equal(load_gfc(packed).c, field.c)
    assert load_gfc(path, degree=0).degree == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("-4.84165143790815D-04  0.0D+00", "-4.8416x 0", "line 12: expected 'gfc degree order C S ...', got 'gfc"),
        ("gfc    2    2", "gfc    2    3", "line 15: expected 0 <= order <= degree <= 2"),
        ("gfc    2    2", "gfc    2    0", "line 15: a second coefficient of degree 2 and order 0"),
        ("2.4393836e-06", "nan", "line 15: .* finite numbers"),
        ("max_degree                  2", "max_degree  3", "max_degree is 3, but no coefficient of degree 3"),
        ("max_degree                  2", "", "the header has no max_degree"),
        ("6378136.3", "-1", "radius: expected a positive number"),
        ("fully_normalized", "unnormalized", "norm: expected fully_normalized coefficients, got 'unnormalized'"),
        ("end_of_head", "end", "line 11: coefficients before end_of_head"),
    ],
)
def test_malformed_files_are_named(tmp_path, old, new, message):
    path = tmp_path / "wrong.gfc"
    path.write_text(GFC.replace(old, new))
    with pytest.raises(ValueError, match=rf"wrong.gfc.*{message}"):
        load_gfc(path)


def test_mistakes_are_named(tmp_path):
    path = tmp_path / "small.gfc"
    path.write_text(GFC)
    for wrong, message in (
        (lambda: load_gfc(path, 3), "degree: expected 0 to 2, the max_degree of small.gfc, got 3"),
        (lambda: gravity_field("WGS84"), "name: expected one of .* got 'WGS84'"),
        (lambda: gravity_field("JGM3", 71), "degree: expected 0 to 70, which JGM3 has, got 71"),
        (lambda: SphericalHarmonics(gravity_field("JGM3"), 71), "degree: expected a static integer from 0 to 70"),
        (lambda: SphericalHarmonics(gravity_field("JGM3"), 5, 6), "order: expected a static integer from 0 to 5"),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()
