"""What the camera sees is where it is: pinhole models, exact distances to the parts, what holds of any picture."""

import dataclasses
import tempfile
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.camera.lens import placed, project
from owm_envs.camera.render import render
from owm_envs.camera.scene import default_scene
from owm_envs.camera.solids import solids
from owm_envs.camera.surface import MATERIAL_NAMES
from owm_envs.camera.views import CAMERA_NAMES, ZENITH, aimed, camera
from owm_envs.station import PORTS, docked_attitude
from owm_envs.station.details import DETAILS
from owm_envs.station.geometry import bounds, signed_distance
from owm_envs.station.mesh import export, load_triangles
from owm_envs.station.parts import PARTS
from owm_envs.station.primitives import ball
from owm_envs.view import View

TABLE = (*PARTS, *DETAILS)
AWAY = View.of(np.array([0.0, 0.0, 1e5, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], np.float32))
SMALL, ALL = 16, ("rgb", "depth", "part", "port", "normal")
traces = []


@lru_cache(maxsize=1)
def scene():
    return default_scene()


def _counted(scene, view, camera):
    traces.append(camera)
    return render(scene, view, camera)


draw = jax.jit(_counted)
draw_views = jax.jit(jax.vmap(render, in_axes=(None, 0, None)))


def small(**changes):
    """The nose camera in few pixels, with every output."""
    return camera("chaser_fpv", **{"height": SMALL, "width": SMALL, "outputs": ALL, **changes})


def random_views(rng, count, spread=60.0):
    q = rng.normal(size=(count, 4))
    numbers = np.zeros((count, 13), np.float32)
    numbers[:, :3] = rng.uniform(-spread, spread, (count, 3))
    numbers[:, 6:10] = q / np.linalg.norm(q, axis=1, keepdims=True)
    return View.of(numbers)


def onlooker(rng, projection, size, outputs=("depth",)):
    """A camera that stands somewhere and looks at a random place of the station."""
    target = rng.uniform(-1.0, 1.0, 3) * (20.0, 20.0, 5.0)
    way = rng.normal(size=3)
    place = target + way / np.linalg.norm(way) * rng.uniform(25.0, 80.0)
    field = np.radians(45.0) if projection == "perspective" else 40.0
    how = {"mount": "station", "position": place, "attitude": aimed(place, target), "projection": projection}
    return camera("chaser_fpv", height=size, width=size, field=field, outputs=outputs, **how)


def turn(q):
    """Rotation matrix of a quaternion, scalar first, written out."""
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def pixel_rays(lens):
    """Origins and unit directions (H W, 3) of the pixels' middles, and the optical axis, of a camera on the station.

    A pinhole model of its own, in float64.
    """
    matrix = turn(np.asarray(lens.attitude, np.float64))
    right, up, forward = -matrix[:, 0], matrix[:, 1], matrix[:, 2]
    half = 0.5 * float(lens.field)
    half = np.tan(half) if lens.projection == "perspective" else half
    step = 2.0 * half / lens.height
    x = step * (np.arange(lens.width) + 0.5 - 0.5 * lens.width)
    y = -step * (np.arange(lens.height) + 0.5 - 0.5 * lens.height)
    offset = (y[:, None, None] * up + x[None, :, None] * right).reshape(-1, 3)
    place = np.asarray(lens.position, np.float64)
    if lens.projection == "perspective":
        way = offset + forward
        return np.broadcast_to(place, way.shape), way / np.linalg.norm(way, axis=1, keepdims=True), forward
    return place + offset, np.broadcast_to(forward, offset.shape), forward


def exact_depth(lens):
    """Depth (H, W) [m] from exact distances to the parts: go as far as nothing can be, and again.

    Part by part, along the rays that pass the part's box: far fewer than all parts along all rays.
    """
    origin, way, forward = pixel_rays(lens)
    nearest = np.full(len(way), np.inf)
    for part in TABLE:
        ends = (bounds(part)[:, None] - origin) / way
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        alive = np.flatnonzero((enter <= leave + 1e-3) & (leave >= 0.0) & (enter < nearest))
        gone = np.maximum(enter[alive] - 1e-3, 0.0)
        for _ in range(400):
            distance = signed_distance(part, origin[alive] + gone[:, None] * way[alive])
            gone = gone + np.maximum(distance, 0.0)
            there = distance <= 1e-5
            nearest[alive[there]] = np.minimum(nearest[alive[there]], gone[there])
            on = ~there & (gone < 300.0)
            alive, gone = alive[on], gone[on]
            if not len(alive):
                break
        assert not len(alive)
    return np.where(nearest < 300.0, nearest * (way @ forward), np.inf).reshape(lens.height, lens.width)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_depth_and_silhouettes_are_exact(projection):
    """Few pixels may differ from the exact reference, and those within one of an edge."""
    rng = np.random.default_rng(3)
    different = total = 0
    for _ in range(3):
        lens = onlooker(rng, projection, 24)
        found, exact = np.asarray(draw(scene(), AWAY, lens)["depth"]), exact_depth(lens)
        assert np.isfinite(exact).mean() > 0.1
        near = [
            np.roll(np.roll(np.pad(exact, 2, mode="edge"), i, 0), j, 1)[2:-2, 2:-2]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        with np.errstate(invalid="ignore"):
            spread = np.max(near, axis=0) - np.min(near, axis=0)
            wrong = (np.isfinite(found) != np.isfinite(exact)) | (np.abs(found - exact) > 0.01)
        edge = ~(spread < 0.5) & np.isfinite(near).any(axis=0)
        assert not (wrong & ~edge).any()
        different, total = different + wrong.sum(), total + wrong.size
    assert different / total < 0.01


@lru_cache(maxsize=1)
def embree():
    """The exported mesh of the station in a ray tracer of others."""
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    from embreex.mesh_construction import TriangleMesh

    world = rtcore_scene.EmbreeScene()
    with tempfile.TemporaryDirectory() as folder:
        export(f"{folder}/station.glb", PARTS)
        TriangleMesh(world, load_triangles(f"{folder}/station.glb").astype(np.float32))
    return world


def mesh_depth(lens):
    """Depth (H, W) [m] of the exported mesh."""
    origin, way, forward = pixel_rays(lens)
    origin, way = (np.ascontiguousarray(a, np.float32) for a in (origin, way))
    found = embree().run(origin, way, query="INTERSECT", output=1)
    depth = np.where(found["geomID"] >= 0, found["tfar"].astype(np.float64) * (way @ forward), np.inf)
    return depth.reshape(lens.height, lens.width)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_silhouettes_and_depth_are_those_of_the_exported_mesh(projection):
    """Where the mesh covers all or nothing of a pixel both agree; flat facets are centimetres inside round parts."""
    rng = np.random.default_rng(8)
    bare = scene()._replace(station=solids(PARTS, MATERIAL_NAMES))
    all_errors = []
    for _ in range(8):
        lens = onlooker(rng, projection, 64)
        if projection == "orthographic":  # no ray may start inside a part, whose far side a mesh would show
            lens = dataclasses.replace(lens, position=lens.position - 100.0 * placed(lens, AWAY).axes[:, 2])
        found = np.asarray(draw(bare, AWAY, lens)["depth"])
        fine = mesh_depth(dataclasses.replace(lens, height=64 * 5, width=64 * 5)).reshape(64, 5, 64, 5)
        near, far = fine.min(axis=(1, 3)), fine.max(axis=(1, 3))
        covered, empty = np.isfinite(far), ~np.isfinite(near)
        assert covered.mean() > 0.05 and empty.mean() > 0.05
        assert np.isfinite(found[covered]).all() and not np.isfinite(found[empty]).any()
        # Within a pixel the surface rises and falls, or a part ends: ours must lie between.
        assert (found[covered] > near[covered] - 0.05).all() and (found[covered] < far[covered] + 0.05).all()
        smooth = covered & (far < near + 0.5)
        all_errors.append(np.abs(found[smooth] - fine[:, 2, :, 2][smooth]))
    errors = np.concatenate(all_errors)
    assert len(errors) > 1000 and np.median(errors) < 0.005 and errors.max() < 0.05


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_points_are_projected_as_by_a_pinhole(projection):
    rng = np.random.default_rng(0)
    for _ in range(20):
        lens = onlooker(rng, projection, 64)
        points = rng.uniform(-30.0, 30.0, (50, 3)).astype(np.float32)
        matrix, place = turn(np.asarray(lens.attitude, np.float64)), np.asarray(lens.position, np.float64)
        left, up, depth = ((points - place) @ matrix).T
        scale = 64 / (2 * np.tan(0.5 * float(lens.field)) * depth) if projection == "perspective" else 64 / 40.0
        expected = np.stack([32 - left * scale, 32 - up * scale], axis=1)
        seen = depth > 1.0
        pose = placed(lens, AWAY)
        for points_ in (points, jnp.asarray(points)):
            pixels, found = project(lens, pose, points_)
            assert isinstance(pixels, type(points_))
            np.testing.assert_allclose(found, depth, atol=1e-3)
            np.testing.assert_allclose(np.asarray(pixels)[seen], expected[seen], atol=0.02)


def test_directions_are_points_far_away():
    lens = onlooker(np.random.default_rng(1), "perspective", 64)
    pose = placed(lens, AWAY)
    way = np.asarray(pose.axes[:, 2]) + 0.1 * np.asarray(pose.axes[:, 0])
    pixels, _ = project(lens, pose._replace(position=np.zeros(3)), way)
    far, _ = project(lens, pose, np.asarray(pose.position) + 1e6 * way)
    np.testing.assert_allclose(pixels, far, atol=0.05)


def test_every_port_is_in_the_middle_when_the_pose_says_so():
    """Before each port, nose towards it and the camera on the axis."""
    numbers = np.zeros((len(PORTS), 13), np.float32)
    for row, port in zip(numbers, PORTS):
        row[:3] = np.array(port.interface) + (port.standoff + 5.0) * np.array(port.normal)
        row[6:10] = docked_attitude(port.normal)
    lens = small(position=(0.0, 0.0, 2.2), field=np.radians(30.0))
    seen = draw_views(scene(), View.of(numbers), lens)["port"]
    for index, port in enumerate(PORTS):
        assert (np.asarray(seen[index])[7:9, 7:9] == index).all(), port.name
        view = jax.tree.map(lambda part: part[index], View.of(numbers))  # noqa: B023
        pixels, _ = project(lens, placed(lens, view), np.asarray(port.interface))
        np.testing.assert_allclose(pixels, (8.0, 8.0), atol=1e-3)


@pytest.mark.slow
def test_no_pixel_is_ever_nan(monkeypatch, optimised):
    """10,000 poses, of which every third is inside a part of the station."""
    monkeypatch.setattr("owm_envs.camera.render.encoded", lambda light: light)
    rng = np.random.default_rng(7)
    views = random_views(rng, 10_000)
    views.position[::3] = np.array([p.position for p in PARTS])[rng.integers(len(PARTS), size=len(views.position[::3]))]
    lens = camera("chaser_fpv", height=8, width=8, position=(0.0, 0.0, 0.0), outputs=("rgb", "depth", "normal"))
    seen = scene()
    finite = lambda view: {name: _finite(name, image) for name, image in render(seen, view, lens).items()}
    good = optimised(lambda views: jax.lax.map(finite, views, batch_size=100))(views)
    for name, fine in good.items():
        assert np.asarray(fine).all(), name


def _finite(name, image):
    """Light is finite from 0 to 1, normals are of length 1 or 0, and no depth is NaN."""
    if name == "rgb":
        return (jnp.isfinite(image) & (image >= 0) & (image <= 1)).all()
    if name == "normal":
        square = (image * image).sum(axis=-1)
        return ((jnp.abs(square - 1) < 1e-4) | (square == 0)).all()
    return (image >= 0).all()


@pytest.mark.slow
def test_a_batch_is_its_pictures_one_by_one():
    views = random_views(np.random.default_rng(5), 6, 40.0)
    each = [draw(scene(), jax.tree.map(lambda part, i=i: part[i], views), small()) for i in range(6)]
    for count in (2, 6):
        batch = draw_views(scene(), jax.tree.map(lambda part: part[:count], views), small())  # noqa: B023
        for name in ALL:
            alone = np.stack([one[name] for one in each[:count]])
            if name in ("depth", "normal"):  # the order of roundings is the compiler's
                np.testing.assert_allclose(batch[name], alone, rtol=1e-5, atol=1e-5, err_msg=name)
            else:
                np.testing.assert_array_equal(batch[name], alone, err_msg=name)


@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (72, 40)])
def test_any_size_is_a_crop_of_a_larger_one(shape):
    """The same rays give the same pixels, wherever tiles end."""
    rng = np.random.default_rng(11)
    large = 80 + shape[0] % 2
    lens = onlooker(rng, "perspective", large, ("depth", "part"))
    step = 2.0 * np.tan(0.5 * lens.field) / large
    field = 2.0 * np.arctan(0.5 * step * shape[0])
    cut = dataclasses.replace(lens, height=shape[0], width=shape[1], field=jnp.asarray(field, jnp.float32))
    whole, part = (draw(scene(), AWAY, one) for one in (lens, cut))
    top, left = ((large - side) // 2 for side in shape)
    whole = {name: np.asarray(image)[top : top + shape[0], left : left + shape[1]] for name, image in whole.items()}
    same = np.asarray(part["part"]) == whole["part"]
    assert same.mean() > 0.995  # rounding may move a ray across an edge
    np.testing.assert_allclose(np.asarray(part["depth"])[same], whole["depth"][same], rtol=1e-4)


def test_another_presence_pose_or_colour_recompiles_nothing():
    rng = np.random.default_rng(2)
    views = random_views(rng, 3)
    first = jax.tree.map(lambda part: part[0], views)
    draw(scene(), first, small())
    count = len(traces)
    station, look = scene().station, scene().materials
    fewer = station._replace(present=station.present.at[::2].set(False))
    moved = station._replace(centre=station.centre + jnp.ones((1, 3), jnp.float32))
    painted = look._replace(colour=0.5 * look.colour)
    for changed in ({"station": fewer}, {"station": moved}, {"materials": painted}):
        draw(scene()._replace(**changed), first, small())
    draw(scene(), jax.tree.map(lambda part: part[1], views), small(field=1.0, exposure=1.0, position=(0, 0, 3)))
    assert len(traces) == count


def test_what_is_absent_is_not_seen():
    lens = onlooker(np.random.default_rng(4), "perspective", SMALL, ALL)
    station = scene().station
    bare = scene()._replace(station=station._replace(present=jnp.zeros_like(station.present)))
    seen = draw(bare, AWAY, lens)
    assert not np.isfinite(seen["depth"]).any() and (np.asarray(seen["part"]) == -1).all()


def lit(shown, monkeypatch):
    """The mean of a picture's light, as a function that can be differentiated."""
    monkeypatch.setattr("owm_envs.camera.render.encoded", lambda light: light)
    return jax.jit(jax.value_and_grad(lambda view, lens: render(shown, view, lens)["rgb"].mean(), argnums=(0, 1)))


@pytest.mark.slow
def test_gradients_of_a_lit_sphere_match_differences(monkeypatch):
    """A sphere fills the picture, so that no edge moves through it."""
    lone = solids((ball("ball", (0.0, 0.0, 0.0), 20.0, "dark", "a test"),), MATERIAL_NAMES)
    shown = scene()._replace(station=lone)
    sun = np.asarray(shown.heavens.sun)
    place = 14.0 * sun + np.array([0.0, 0.0, 1.0])
    lens = camera(
        "chaser_fpv", height=8, width=8, position=(0.0, 0.0, 0.0), attitude=aimed(place, (0, 0, 0)), field=0.5
    )
    lens = dataclasses.replace(lens, mount="chaser")
    view = View.of(jnp.asarray([*place, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], jnp.float32))
    # The vehicle itself stands around its camera, and is no part of this.
    shown = shown._replace(chaser=shown.chaser._replace(present=jnp.zeros_like(shown.chaser.present)))
    slope = lit(shown, monkeypatch)
    _, (by_view, by_lens) = slope(view, lens)
    for axis in range(3):
        step = 0.05 * np.eye(3, dtype=np.float32)[axis]
        ahead, behind = (slope(view._replace(position=view.position + s * step), lens)[0] for s in (1, -1))
        np.testing.assert_allclose(by_view.position[axis], (ahead - behind) / 0.1, rtol=0.03, atol=3e-5)
    ahead, behind = (
        slope(view, dataclasses.replace(lens, exposure=jnp.asarray(s * 0.05, jnp.float32)))[0] for s in (1, -1)
    )
    np.testing.assert_allclose(by_lens.exposure, (ahead - behind) / 0.1, rtol=0.02)


@pytest.mark.slow
def test_gradients_are_finite_everywhere(monkeypatch):
    views = random_views(np.random.default_rng(9), 8, 40.0)
    lens = camera("chaser_fpv", height=8, width=8)
    slope = lit(scene(), monkeypatch)
    for row in range(8):
        _, found = slope(jax.tree.map(lambda part: jnp.asarray(part[row]), views), lens)  # noqa: B023
        for path, leaf in jax.tree.leaves_with_path(found):
            assert np.isfinite(leaf).all(), jax.tree_util.keystr(path)


@pytest.mark.parametrize("name", CAMERA_NAMES)
def test_named_cameras_hold_under_strict_flags(jax_flags, name):
    with jax_flags(strict=True):
        view = View.of(np.array([0.0, -40.0, 0.0, 0, 0, 0, 0.5, -0.5, -0.5, 0.5, 0, 0, 0], np.float32))
        seen = jax.eval_shape(render, scene(), view, camera(name, height=9, width=11, outputs=ALL))
    assert {key: (leaf.shape, str(leaf.dtype)) for key, leaf in seen.items()} == {
        "rgb": ((9, 11, 3), "uint8"), "depth": ((9, 11), "float32"), "part": ((9, 11), "int32"),
        "port": ((9, 11), "int32"), "normal": ((9, 11, 3), "float32"),
    }  # fmt: skip


def test_a_camera_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="did you mean 'chaser_fpv'"):
        camera("chaser_fvp")
    with pytest.raises(ValueError, match="at least 1 pixel"):
        camera(height=0)
    with pytest.raises(ValueError, match="below pi rad"):
        camera(field=3.2)
    with pytest.raises(ValueError, match="did you mean 'depth'"):
        camera(outputs=("depht",))
    with pytest.raises(ValueError, match="cannot look at"):
        aimed((0, 0, 1), (0, 0, 5), ZENITH)
