"""Patterns on surfaces: ports told apart by sight, no aliasing, looks in range, traced tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.camera.render import render
from owm_envs.camera.scene import default_scene
from owm_envs.camera.solids import solids
from owm_envs.camera.surface import MATERIAL_NAMES, PATTERNS, look, materials
from owm_envs.camera.vectors import dot
from owm_envs.camera.views import aimed, camera
from owm_envs.station import PARTS, PORT_NAMES, PORTS, docked_attitude
from owm_envs.station.details import DETAILS
from owm_envs.station.geometry import signed_distance
from owm_envs.station.primitives import MATERIALS, box
from owm_envs.view import View

_SCENE = default_scene()


def _frames(rng, count):
    """First-person frames 30 m out on every corridor, pose and Sun drawn: (count, 8, 64, 64, 3), and the Suns."""
    eye = camera("chaser_fpv", height=64, width=64)

    @jax.jit
    def drawn(position, attitude, sun):
        zero = jnp.zeros(3, jnp.float32)
        scene = _SCENE._replace(heavens=_SCENE.heavens._replace(sun=sun))
        return render(scene, View(position, zero, attitude, zero), eye)["rgb"]

    frames = []
    for _ in range(count):
        for port in PORTS:
            normal = np.array(port.normal)
            position = np.array(port.interface) + (30.0 + rng.uniform(-1, 1)) * normal + rng.uniform(-0.7, 0.7, 3)
            turn = np.append(1.0, rng.normal(0.0, 0.008, 3))
            w, x, y, z = docked_attitude(port.normal)
            product = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ turn
            # A pilot comes with the Sun in some quarter behind: the face of the port is lit.
            sun = rng.normal(size=3)
            sun /= np.linalg.norm(sun)
            sun = sun + normal * (rng.uniform(0.2, 1.0) - sun @ normal)
            numbers = (position, product / np.linalg.norm(product), sun / np.linalg.norm(sun))
            frames.append(drawn(*(jnp.asarray(part, jnp.float32) for part in numbers)))
    return np.stack(frames).reshape(count, len(PORTS), 64, 64, 3)


@pytest.fixture(scope="module")
def frames():
    rng = np.random.default_rng(0)
    return _frames(rng, 32), _frames(rng, 8)


def _accuracy(train, test, rows=slice(0, 64), columns=slice(0, 64), shifts=(0,)):
    """Share of frames, cut to a window, whose nearest neighbour, shifted by some pixels, shows the same port."""

    def features(images, down=0, right=0):
        window = images[:, :, rows.start + down : rows.stop + down, columns.start + right : columns.stop + right]
        flat = np.log(window.reshape(-1, np.prod(window.shape[2:])) + 8.0)
        flat = flat - flat.mean(axis=1, keepdims=True)
        return flat / np.linalg.norm(flat, axis=1, keepdims=True)

    likeness = np.max([features(test) @ features(train, i, j).T for i in shifts for j in shifts], axis=0)
    nearest, ports = np.argmax(likeness, axis=1), len(PORTS)
    return np.mean(nearest % ports == np.arange(len(nearest)) % ports)


@pytest.mark.slow
def test_ports_are_told_apart_by_sight_at_30_m(frames):
    assert _accuracy(*frames) >= 0.95, PORT_NAMES


@pytest.mark.slow
def test_ports_are_told_apart_by_what_lies_within_8_m(frames):
    # The port lies 1.75 m below a camera that is 28.45 m away: two pixels of 0.8 m under the middle.
    assert _accuracy(*frames, slice(24, 44), slice(22, 42), (-1, 0, 1)) >= 0.85, PORT_NAMES


_SAMPLE = box("sample", (-10.0, 10.0), (-10.0, 10.0), (-1.0, 1.0), MATERIAL_NAMES[0], "a slab to look at")


def _patch(name, size, draw):
    place = (5.0, -4.0, 12.0)
    attitude = aimed(place, (0.3, 0.2, 0.0), (0.0, 1.0, 0.0))
    eye = camera(
        "station_top", height=size, width=size, position=place, attitude=attitude, field=7.0, projection="orthographic"
    )
    station = solids([_SAMPLE], MATERIAL_NAMES)
    row = jnp.asarray([MATERIAL_NAMES.index(name)], jnp.int32)
    scene = _SCENE._replace(station=station._replace(material=row))
    far = jnp.asarray([0.0, 0.0, -500.0], jnp.float32)
    rest = jnp.asarray([1.0, 0.0, 0.0, 0.0], jnp.float32)
    return np.asarray(draw(scene, View(far, far, rest, far), eye)["rgb"]).astype(np.float64)


@pytest.mark.slow
def test_no_pattern_aliases():
    draw = jax.jit(render)
    mean = lambda image: image.reshape(8, image.shape[0] // 8, 8, image.shape[0] // 8, 3).mean(axis=(1, 3))
    for name in PATTERNS:
        coarse, fine = (mean(_patch(name, size, draw)) for size in (64, 512))
        np.testing.assert_allclose(coarse, fine, atol=8.0, err_msg=name)
        np.testing.assert_allclose(coarse.mean(), fine.mean(), rtol=0.04, atol=1.5, err_msg=name)


def _points(count):
    rng = np.random.default_rng(1)
    number = lambda values: jnp.asarray(values, jnp.float32)
    normal = rng.normal(size=(3, count))
    # Flat faces and axes, where angles and radii vanish, belong to it.
    normal[:, ::4] = np.eye(3)[rng.integers(0, 3, count)[::4]].T * rng.choice([-1.0, 1.0], count)[::4]
    normal /= np.linalg.norm(normal, axis=0)
    place = rng.normal(scale=5.0, size=(3, count))
    place[:, ::7] = 0.0
    half = rng.uniform(0.02, 20.0, (3, count))
    width = 10.0 ** rng.uniform(-5, 3, count)
    material = jnp.asarray(rng.integers(0, len(MATERIAL_NAMES), count), jnp.int32)
    return material, *(tuple(map(number, v)) for v in (place, normal, half)), number(width)


def test_looks_stay_in_range_and_have_finite_gradients():
    table = materials()
    material, place, normal, half, width = _points(5000)
    seen = jax.jit(look)(table, material, place, normal, half, width)
    for values in (*seen.colour, seen.metallic, seen.roughness):
        assert np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0
    # A bent normal never turns away from its surface by more than half a right angle.
    assert np.isfinite(np.stack(seen.bend)).all() and dot(seen.bend, seen.bend).max() < 0.5

    def total(table, place, normal, half, width):
        seen = look(table, material, place, normal, half, width)
        return sum(v.sum() for v in (*seen.colour, seen.metallic, seen.roughness, *seen.bend))

    gradient = jax.jit(jax.grad(total, argnums=(1, 2, 3, 4)))(table, place, normal, half, width)
    for leaf in jax.tree.leaves(gradient):
        assert np.isfinite(leaf).all()


def test_another_colour_or_spacing_recompiles_nothing():
    traces = []

    @jax.jit
    def drawn(scene, view, eye):
        traces.append(1)
        return render(scene, view, eye)["rgb"]

    eye, table = camera("station_isometric", height=32, width=32), _SCENE.materials
    far = jnp.asarray([0.0, 0.0, -500.0], jnp.float32)
    view = View(far, far, jnp.asarray([1.0, 0.0, 0.0, 0.0], jnp.float32), far)
    array = MATERIAL_NAMES.index("array")
    first = drawn(_SCENE, view, eye)
    for changed in (
        table._replace(colour=table.colour.at[array].set(jnp.asarray([0.0, 0.5, 0.0], jnp.float32))),
        table._replace(patches=table.patches.at[array].set(jnp.asarray([2.0, 1.0, 2.0, 1.0], jnp.float32))),
        table._replace(seams=table.seams.at[array].set(jnp.asarray([3.0, 1.5, 3.0, 1.5], jnp.float32))),
    ):
        assert (np.asarray(drawn(_SCENE._replace(materials=changed), view, eye)) != np.asarray(first)).any()
    assert len(traces) == 1


def test_details_are_few_sound_and_close_to_the_station():
    names = {part.name for part in (*PARTS, *DETAILS)}
    assert len(names) == len(PARTS) + len(DETAILS) and len(DETAILS) <= 120
    centres = np.array([part.position for part in DETAILS])
    assert all(part.material in MATERIALS for part in DETAILS)
    distance = np.min([signed_distance(part, centres) for part in PARTS], axis=0)
    assert distance.max() < 0.6 and distance.min() > -0.6
