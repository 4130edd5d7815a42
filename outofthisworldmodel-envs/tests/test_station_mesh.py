import json
import re

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import trimesh

from owm_envs.cli import main
from owm_envs.station import CHASER, MATERIALS, PARTS, bounds, load_hull
from owm_envs.station.boxes import distance_to
from owm_envs.station.mesh import boxes_from_mesh, export, load_triangles, part_mesh, scene, voxelise


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "station.glb"
    export(path, PARTS)
    return path


def inside_any(boxes, points):
    return distance_to(boxes, points) < 1e-6


def points_on(triangles, count, rng):
    chosen = triangles[rng.integers(len(triangles), size=count)]
    weights = rng.dirichlet((1.0, 1.0, 1.0), count)
    return np.einsum("nk,nkd->nd", weights, chosen)


def test_every_part_is_a_watertight_solid_of_its_volume():
    for part in PARTS + CHASER:
        mesh = part_mesh(part)
        assert mesh.is_watertight and mesh.is_winding_consistent, part.name
        a, b, length = part.dimensions
        volume = {
            "sphere": np.pi / 6.0 * a**3,
            "box": a * b * length,
            "panel": a * b * length,
        }.get(part.primitive, np.pi / 12.0 * length * (a * a + a * b + b * b))
        np.testing.assert_allclose(mesh.volume, volume, rtol=0.045, err_msg=part.name)
        np.testing.assert_allclose(mesh.bounds, bounds(part), atol=0.06, err_msg=part.name)


def test_file_has_a_node_a_part_with_its_name_and_material(station):
    loaded = trimesh.load_scene(station)
    assert set(loaded.graph.nodes_geometry) == {part.name for part in PARTS}
    for part in PARTS[::17]:
        _, name = loaded.graph[part.name]
        material = loaded.geometry[name].visual.material
        expected = MATERIALS[part.material]
        assert material.name == part.material
        np.testing.assert_allclose(np.array(material.baseColorFactor[:3]) / 255.0, expected.colour, atol=0.003)
        metallic = material.metallicFactor or 0.0
        np.testing.assert_allclose((metallic, material.roughnessFactor), (expected.metallic, expected.roughness))


def test_file_is_y_up_and_reads_back_in_the_station_frame(station):
    corners = trimesh.load_scene(station).bounds  # x port, y zenith, z forward
    exact = np.stack([bounds(part) for part in PARTS])
    lower, upper = exact[:, 0].min(axis=0), exact[:, 1].max(axis=0)
    np.testing.assert_allclose(corners, [(lower[0], lower[2], -upper[1]), (upper[0], upper[2], -lower[1])], atol=0.01)
    back = load_triangles(station).reshape(-1, 3)
    np.testing.assert_allclose((back.min(axis=0), back.max(axis=0)), (lower, upper), atol=0.01)
    assert len(back) == 3 * sum(len(part_mesh(part).faces) for part in PARTS)


def test_scene_of_the_chaser_is_small():
    assert len(scene(CHASER).geometry) == len(CHASER)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_axes_and_scale_of_a_file(tmp_path, up):
    """A tall box, tall along the file's `up`, stands up in the station frame."""
    extents = [1000.0, 2000.0, 3000.0]
    extents["xyz".index(up)] = 9000.0
    path = tmp_path / "tower.stl"
    trimesh.creation.box(extents=extents).export(path)
    size = np.ptp(load_triangles(path, 0.001, up).reshape(-1, 3), axis=0)
    np.testing.assert_allclose(size[2], 9.0)


@hypothesis.settings(deadline=None, max_examples=40)
@hypothesis.given(st.integers(0, 2**32 - 1), st.floats(0.3, 2.0))
def test_no_point_of_a_surface_is_missed(seed, spacing):
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-4.0, 4.0, (6, 3, 3))
    triangles[3:] = np.round(triangles[3:] / spacing) * spacing  # corners on the faces of cells
    origin = np.full(3, -5.0 * spacing) - 4.0
    voxels = voxelise(triangles, origin, spacing)
    assert inside_any(voxels.bounds, points_on(triangles, 400, rng)).all()
    corner = origin + voxels.index * spacing
    assert np.all(voxels.bounds[:, 0] >= corner - 1e-9) and np.all(voxels.bounds[:, 1] <= corner + spacing + 1e-9)


def test_boxes_of_a_hollow_hull_with_a_wing():
    """A tank and a slanted sheet: everything covered, the count met, the tank's inside free of charge."""
    tank = trimesh.creation.cylinder(radius=2.0, height=8.0)
    wing = trimesh.creation.box(extents=(12.0, 3.0, 0.05))
    wing.apply_transform(trimesh.transformations.rotation_matrix(0.6, (0.0, 1.0, 0.0)))
    wing.apply_translation((9.0, 0.0, 0.0))
    triangles = np.concatenate([tank.triangles, wing.triangles])
    reports = [boxes_from_mesh(triangles, count, 0.4) for count in (8, 40)]
    points = points_on(triangles, 20_000, np.random.default_rng(0))
    for report, count in zip(reports, (8, 40)):
        assert report.boxes.shape == (count, 2, 3) and report.covered == 1.0
        assert inside_any(report.boxes, points).all()
        assert report.reach < 18.0
    assert reports[1].excess_mean < 0.5 * reports[0].excess_mean < 0.5
    assert reports[1].excess_p99 < 0.8


def test_import_command_writes_boxes_that_are_read_back(tmp_path, capsys):
    mesh, out = tmp_path / "box.obj", tmp_path / "hull.csv"
    trimesh.creation.icosphere(subdivisions=3, radius=4.0).export(mesh)
    main(["station", "import", str(mesh), "--boxes", "20", "--out", str(out)])
    printed = capsys.readouterr().out
    assert "coverage of the surface" in printed and "100.00 %" in printed and "99th percentile" in printed
    boxes = load_hull(out)
    assert boxes.shape == (20, 2, 3)
    assert inside_any(boxes, load_triangles(mesh).reshape(-1, 3)).all()


@pytest.mark.parametrize(
    ("content", "arguments", "message"),
    [
        (None, [], "no such mesh"),
        (b"this is no mesh", [], "cannot be read|no triangles"),
        (b"solid x\nendsolid x\n", [], "cannot be read|no triangles"),
        (109_000.0, [], "109,000 m across.*metres per unit"),
        (5.0, ["--up", "w"], "up must be one of x, y, z"),
        (5.0, ["--scale", "0"], "scale must be a positive"),
        (5.0, ["--boxes", "0"], "boxes must be at least 1"),
        (5.0, ["--voxel", "0"], "voxel must be a positive"),
        (5.0, ["--voxel", "0.001"], "cells; at least"),
    ],
)
def test_bad_input_ends_with_code_2_and_says_why(tmp_path, capsys, content, arguments, message):
    path = tmp_path / "mesh.stl"
    if isinstance(content, float):
        trimesh.creation.box(extents=(content, 3.0, 2.0)).export(path)
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(SystemExit) as stop:
        main(["station", "import", str(path), *arguments])
    assert stop.value.code == 2
    error = " ".join(capsys.readouterr().err.split())
    assert re.search(message, error), error


def test_a_damaged_glb_is_named(tmp_path):
    path = tmp_path / "damaged.glb"
    path.write_bytes(b"glTF" + bytes(40))
    with pytest.raises(ValueError, match=r"damaged\.glb cannot be read as a mesh"):
        load_triangles(path)


def test_export_and_show_commands(tmp_path, capsys):
    main(["station", "export", str(tmp_path / "chaser.glb"), "--chaser"])
    assert f"{len(CHASER)} parts" in capsys.readouterr().out
    assert trimesh.load_scene(tmp_path / "chaser.glb").extents[0] > 16.0
    with pytest.raises(SystemExit):
        main(["station", "export", str(tmp_path / "chaser.obj")])
    picture = tmp_path / "station.png"
    main(["station", "show", str(picture), "--size", "400", "250"])
    assert "313 boxes covering 100.00 %" in capsys.readouterr().out

    import cv2

    image = cv2.imread(str(picture))[..., ::-1].astype(int)
    assert image.shape == (250, 400, 3)
    red, green, blue = np.moveaxis(image, -1, 0)
    gold = (red > 110) & (red > 1.25 * green) & (green > 1.3 * blue)
    white = (image.min(axis=-1) > 170) & (np.ptp(image, axis=-1) < 30)
    marks = (blue > 200) & (red < 140)
    # Blankets, then radiators and truss, then the marks of the train ports.
    assert gold.mean() > 0.08 and white.mean() > 0.001 and marks.mean() > 0.0005


def two_boxes(path, change):
    """A glTF file of two boxes 9 m apart, its JSON changed by `change`."""
    pair = trimesh.Scene()
    for name, x in (("left", 0.0), ("right", 9.0)):
        box = trimesh.creation.box(extents=(3.0, 3.0, 3.0))
        box.apply_translation((x, 0.0, 0.0))
        pair.add_geometry(box, node_name=name, geom_name=name)
    files = pair.export(file_type="gltf")
    for name, data in files.items():
        (path / name).write_bytes(data)
    tree = json.loads(files["model.gltf"])
    change(tree)
    (path / "model.gltf").write_text(json.dumps(tree), encoding="utf-8")
    return path / "model.gltf"


@pytest.mark.parametrize("mode", [0, 1, 2, 3, 5, 6])
def test_a_part_that_is_not_triangles_is_refused_by_name(tmp_path, mode):
    path = two_boxes(tmp_path, lambda tree: tree["meshes"][1]["primitives"][0].update(mode=mode))
    with pytest.raises(ValueError, match=r"node 'right', primitive 0, is .*, not triangles"):
        load_triangles(path)


def test_a_mesh_shown_twice_arrives_twice(tmp_path):
    def again(tree):
        right = next(i for i, node in enumerate(tree["nodes"]) if node.get("name") == "right")
        tree["nodes"].append({"name": "third", "mesh": tree["nodes"][right]["mesh"], "translation": [9, 0, 0]})
        tree["nodes"][tree["scenes"][0]["nodes"][0]].setdefault("children", []).append(len(tree["nodes"]) - 1)

    assert len(load_triangles(two_boxes(tmp_path, again))) == 36


def obj(path, shift=0.0, first="0"):
    corners = [
        f"v {first} 0 0",
        *(f"v {shift + x} {y} {z}" for x, y, z in ((9, 0, 0), (0, 9, 0), (0, 0, 9), (4, 0, 0))),
    ]
    path.write_text("\n".join([*corners, "f 2 3 4", "f 1 2 3", "f 2 2 3"]) + "\n", encoding="utf-8")
    return path


def test_triangles_without_an_area_are_dropped_and_counted(tmp_path):
    with pytest.warns(UserWarning, match="left out 1 of 3 triangles, which have no area"):
        assert len(load_triangles(obj(tmp_path / "mesh.obj"))) == 2


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj", "glb"])
def test_a_file_that_loses_triangles_is_refused_in_every_format(tmp_path, monkeypatch, kind):
    path = tmp_path / f"mesh.{kind.removesuffix('_ascii')}"
    data = trimesh.creation.box((9, 9, 9)).export(file_type=kind)
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    assert len(load_triangles(path)) == 12
    read = trimesh.load_scene

    def losing(*args, **kwargs):
        """A reader that drops the last triangle of each part without a word."""
        scene = read(*args, **kwargs)
        for part in scene.geometry.values():
            part.faces = part.faces[:-1]
        return scene

    monkeypatch.setattr(trimesh, "load_scene", losing)
    with pytest.raises(ValueError, match="declares 12 triangles, of which 11 were read"):
        load_triangles(path)


def test_a_truncated_stl_is_refused(tmp_path):
    path = tmp_path / "mesh.stl"
    path.write_bytes(trimesh.creation.box((9, 9, 9)).export(file_type="stl")[:-60])
    with pytest.raises(ValueError, match=r"declares 12 triangles, of which 0 were read|cannot be read as a mesh"):
        load_triangles(path)


@pytest.mark.parametrize("first", ["nan", "inf"])
def test_a_vertex_that_is_not_finite_is_refused(tmp_path, first):
    with pytest.raises(ValueError, match="not finite"):
        load_triangles(obj(tmp_path / "mesh.obj", first=first))


def test_a_mesh_far_from_the_station_is_refused_with_its_bounds(tmp_path):
    with pytest.warns(UserWarning), pytest.raises(ValueError, match=r"lies from \[5000.0, 0.0, 0.0\] to .*origin"):
        load_triangles(obj(tmp_path / "mesh.obj", 5000.0, "5000"))


def test_an_imported_hull_is_drawn(tmp_path, capsys):
    mesh, hull = tmp_path / "ball.obj", tmp_path / "hull.csv"
    trimesh.creation.icosphere(subdivisions=2, radius=40.0).export(mesh)
    main(["station", "import", str(mesh), "--boxes", "7", "--voxel", "4", "--out", str(hull)])
    small = ["--size", "400", "250"]
    main(["station", "show", str(tmp_path / "own.png"), "--hull", str(hull), *small])
    assert "7 boxes covering" in capsys.readouterr().out
    main(["station", "show", str(tmp_path / "iss.png"), *small])
    assert (tmp_path / "own.png").read_bytes() != (tmp_path / "iss.png").read_bytes()
