"""Gravity of polyhedra against the closed form of a box, a sphere, and Laplace's equation."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import forces

CUBE = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in SQUARES for t in ((a, b, c), (a, c, d))])
HALF = np.array([900.0, 500.0, 300.0])
DENSITY = 2400.0


@pytest.fixture(scope="module")
def box():
    return forces.polyhedron(CUBE * HALF, TRIANGLES)


def box_attraction(r):
    """Closed form of a right rectangular prism (Nagy 1966), by axis."""
    out = []
    for axis in range(3):
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        total = 0.0
        for signs in itertools.product((-1, 1), repeat=3):
            x, y, z = (s * HALF[k] - r[k] for s, k in zip(signs, order))
            d = np.sqrt(x * x + y * y + z * z)
            total -= np.prod(signs) * (x * np.log(y + d) + y * np.log(x + d) - z * np.arctan(x * y / (z * d)))
        out.append(total)
    return forces.polyhedral.GRAVITATIONAL_CONSTANT * DENSITY * np.array(out)


OUTSIDE = [[1500.0, 700.0, 400.0], [-950.0, 20.0, 30.0], [100.0, -200.0, 3000.0], [1.0, 600.0, -301.0]]
INSIDE = [[10.0, 20.0, 30.0], [-850.0, 480.0, 290.0]]


def test_attraction_of_a_box(box, quick, x64):
    """1e-12 of the closed form, outside and inside."""
    accel = quick(lambda r: forces.accel_polyhedron(r, box, DENSITY))
    for r in OUTSIDE + INSIDE:
        expected = box_attraction(np.array(r))
        assert np.linalg.norm(accel(jnp.asarray(r)) - expected) < 1e-12 * np.linalg.norm(expected)


def test_slopes(box, quick, x64):
    """The acceleration is the potential's gradient, in and outside; its divergence is Poisson's."""
    slope = quick(jax.grad(lambda r: forces.potential_polyhedron(r, box, DENSITY)))
    accel = quick(lambda r: forces.accel_polyhedron(r, box, DENSITY))
    tensor = quick(jax.jacrev(lambda r: forces.accel_polyhedron(r, box, DENSITY)))
    angle = quick(lambda r: forces.solid_angle_polyhedron(r, box))
    scale = forces.polyhedral.GRAVITATIONAL_CONSTANT * DENSITY
    for r in map(jnp.asarray, OUTSIDE + INSIDE):
        np.testing.assert_allclose(slope(r), accel(r), rtol=0, atol=1e-12 * np.linalg.norm(accel(r)) + 1e-17)
        gradient = tensor(r)
        np.testing.assert_allclose(gradient, gradient.T, rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(np.trace(gradient), -scale * angle(r), rtol=0, atol=1e-10 * scale)
        step = np.stack([accel(r + h) - accel(r - h) for h in 1e-2 * np.eye(3)]).T / 2e-2
        np.testing.assert_allclose(gradient, step, rtol=0, atol=1e-6 * scale)


def test_inside_and_outside(box, rng, quick, x64):
    angle = quick(jax.vmap(lambda r: forces.solid_angle_polyhedron(r, box)))
    points = rng.uniform(-2, 2, (500, 3)) * HALF
    inside = (np.abs(points) < HALF).all(axis=1)
    np.testing.assert_allclose(angle(jnp.asarray(points)), np.where(inside, 4 * np.pi, 0.0), rtol=0, atol=1e-9)
    narrow = angle(jnp.asarray(points, jnp.float32))
    assert narrow.dtype == jnp.float32
    np.testing.assert_allclose(narrow, np.where(inside, 4 * np.pi, 0.0), rtol=0, atol=1e-4)
    slopes = quick(jax.vmap(jax.grad(lambda r: forces.solid_angle_polyhedron(r, box))))(jnp.asarray(points))
    np.testing.assert_allclose(slopes, 0.0, rtol=0, atol=1e-12)


def test_a_fine_sphere_attracts_as_a_point(quick, x64):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=1000.0)
    body = forces.polyhedron(mesh.vertices, mesh.faces)
    gm = forces.polyhedral.GRAVITATIONAL_CONSTANT * DENSITY * float(body.volume)
    for r in ([1500.0, -800.0, 600.0], [0.0, 0.0, 5000.0]):
        r = jnp.asarray(r)
        accel = quick(lambda r: forces.accel_polyhedron(r, body, DENSITY))(r)
        np.testing.assert_allclose(accel, forces.accel_two_body(r, gm), rtol=0, atol=3e-6 * np.linalg.norm(accel))


def test_as_a_force_in_a_turning_body(box, x64):
    rotation = forces.earth_rotation(61253, 777.0)
    world = forces.Environment(rotation=rotation)
    model = forces.ForceModel((forces.PolyhedralGravity(box, DENSITY),))
    r = rotation.T @ jnp.asarray(OUTSIDE[0])
    accel = model.accel(0.0, r, 0 * r, forces.Spacecraft(), world)
    np.testing.assert_allclose(rotation @ accel, box_attraction(np.array(OUTSIDE[0])), rtol=1e-12)
    narrow = forces.accel_polyhedron(jnp.asarray(OUTSIDE[0], jnp.float32), box, DENSITY)
    assert narrow.dtype == jnp.float32
    np.testing.assert_allclose(narrow, rotation @ accel, rtol=0, atol=1e-5 * np.linalg.norm(accel))


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (CUBE[:, :2], TRIANGLES, r"vertices: expected finite numbers of shape \(V, 3\)"),
        (CUBE, TRIANGLES * 1.0, r"faces: expected integers of shape \(F, 3\)"),
        (CUBE, TRIANGLES + 1, "faces: expected indices from 0 to 7"),
        (CUBE, TRIANGLES[:-1], "faces: expected a closed mesh"),
        (CUBE, TRIANGLES[:, ::-1], "a mesh inside out"),
        (CUBE * [1, 1, 0], TRIANGLES, "faces: number .* has no area"),
    ],
)
def test_meshes_are_checked(vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        forces.polyhedron(vertices, faces)
