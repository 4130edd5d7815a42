import numpy as np
import pytest
from scipy.spatial import cKDTree

from owm_envs.station import (
    CHASER,
    HELD_OUT_PORTS,
    MATERIALS,
    PARTS,
    PORT_NAMES,
    PORTS,
    TRAIN_PORTS,
    bounds,
    build_hull,
    docked_attitude,
    goal_poses,
    hull_boxes,
    hull_quality,
    load_hull,
    nearest_part,
    part_boxes,
    port_index,
    sample_surface,
    save_hull,
    signed_distance,
)
from owm_envs.station.boxes import emptiness, grid_around, merge, occupancy_of, outer_samples
from owm_envs.station.primitives import ball, beam, rod, sheet

RADIUS = 2.25


def rotate(q, vector):
    inner = np.cross(q[1:], vector)
    return np.asarray(vector) + 2.0 * (q[0] * inner + np.cross(q[1:], inner))


def distance_to(boxes, points):
    points = np.asarray(points)[..., None, :]
    gaps = np.maximum(np.maximum(boxes[:, 0] - points, points - boxes[:, 1]), 0.0)
    return np.linalg.norm(gaps, axis=-1).min(axis=-1)


def extent_of(*names):
    """Exact bounds of the parts whose names start so."""
    found = [bounds(part) for part in PARTS if part.name.startswith(names)]
    assert found, names
    return np.stack(found)


def all_covered(boxes, part, points):
    """Whether every point of a part lies in some box."""
    lower, upper = bounds(part)
    near = boxes[np.all((boxes[:, 0] <= upper + 1e-6) & (boxes[:, 1] >= lower - 1e-6), axis=1)]
    inside = np.all((points[:, None] >= near[:, 0] - 1e-9) & (points[:, None] <= near[:, 1] + 1e-9), axis=-1)
    return inside.any(axis=1).all()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("harmony_forward", (0.70711, -0.70711, 0.0, 0.0)),
        ("harmony_nadir", (0.0, 0.0, 0.0, 1.0)),
        ("harmony_zenith", (0.0, 1.0, 0.0, 0.0)),
        ("zvezda_aft", (0.0, 0.0, 0.70711, -0.70711)),
    ],
)
def test_docked_attitude_is_the_published_one(name, expected):
    np.testing.assert_allclose(goal_poses()[port_index(name), 3:], expected, atol=1e-5)


@pytest.mark.parametrize("port", PORTS, ids=PORT_NAMES)
def test_goal_pose_faces_the_port(port):
    pose = goal_poses()[port_index(port.name)]
    np.testing.assert_allclose(pose[:3], np.array(port.interface) + port.standoff * np.array(port.normal))
    np.testing.assert_allclose(np.linalg.norm(pose[3:]), 1.0, atol=1e-12)
    np.testing.assert_allclose(rotate(pose[3:], (0, 0, 1)), -np.array(port.normal), atol=1e-12)
    up = (0, -1, 0) if abs(port.normal[2]) == 1.0 else (0, 0, -1)
    np.testing.assert_allclose(rotate(pose[3:], (0, 1, 0)), up, atol=1e-12)


def test_attitude_of_a_slanted_port_keeps_its_up_axis_as_near_to_nadir_as_it_can():
    normal = np.array([0.6, 0.0, 0.8])
    q = docked_attitude(tuple(normal))
    np.testing.assert_allclose(rotate(q, (0, 0, 1)), -normal, atol=1e-12)
    np.testing.assert_allclose(rotate(q, (0, 1, 0)), (0.8, 0.0, -0.6), atol=1e-12)


def test_ports_are_split_five_to_three_in_canonical_order():
    assert PORT_NAMES[0] == "harmony_forward" and PORT_NAMES[7] == "unity_nadir" and len(PORTS) == 8
    assert TRAIN_PORTS == ("harmony_forward", "harmony_nadir", "zvezda_aft", "pirs_nadir", "rassvet_nadir")
    assert HELD_OUT_PORTS == ("harmony_zenith", "poisk_zenith", "unity_nadir")
    assert [port_index(name) for name in PORT_NAMES] == list(range(8))


@pytest.mark.parametrize(("typed", "nearest"), [("zvezda_aff", "zvezda_aft"), ("Unity-nadir", "unity_nadir")])
def test_unknown_port_names_the_nearest(typed, nearest):
    with pytest.raises(ValueError, match=f"unknown port '{typed}'; did you mean '{nearest}'.*known: .*pirs_nadir"):
        port_index(typed)


def test_hopeless_port_lists_the_known_ones():
    with pytest.raises(ValueError, match="unknown port 7; known: harmony_forward"):
        port_index(7)


def test_hull_is_313_proper_boxes_within_the_start_shell():
    boxes = hull_boxes()
    assert boxes.dtype == np.float64 and boxes.shape == (313, 2, 3)
    assert np.all(boxes[:, 1] > boxes[:, 0])
    assert np.linalg.norm(np.abs(boxes).max(axis=1), axis=-1).max() < 97.0


@pytest.mark.slow
def test_hull_is_the_one_the_table_makes():
    """A changed table needs `save_hull(path, build_hull())`; this says so."""
    np.testing.assert_allclose(build_hull(), hull_boxes(), atol=1e-9)


@pytest.mark.parametrize("table", [PARTS, CHASER], ids=["station", "chaser"])
def test_table_is_sound(table):
    assert len({part.name for part in table}) == len(table)
    for part in table:
        assert part.material in MATERIALS and len(part.source) > 10, part.name
        assert min(part.dimensions) > 0.0, part.name
        axis, side = np.array(part.axis), np.array(part.side)
        np.testing.assert_allclose((axis @ axis, side @ side, axis @ side), (1.0, 1.0, 0.0), atol=1e-9)


def test_hull_is_a_fresh_array():
    hull_boxes()[:] = 0.0
    assert np.ptp(hull_boxes()) > 100.0


@pytest.mark.parametrize("port", PORTS, ids=PORT_NAMES)
def test_goal_and_corridor_are_clear(port):
    boxes, goal = hull_boxes(), goal_poses()[port_index(port.name), :3]
    assert distance_to(boxes, goal) >= RADIUS + 1.25
    way = goal + np.linspace(0.0, 60.0, 241)[:, None] * np.array(port.normal)
    assert distance_to(boxes, way).min() >= RADIUS + 1.25


@pytest.mark.parametrize("port", PORTS, ids=PORT_NAMES)
def test_every_mating_plane_ends_structure_to_the_millimetre(port):
    """At the interface a part ends, and ahead of it is nothing; across the plane the ring is centred on it."""
    mating, normal = np.array(port.interface), np.array(port.normal)
    steps = np.array([-0.1, 0.0, 0.001, 0.5, 3.0])
    distance, owner = nearest_part(PARTS, mating + steps[:, None] * normal)
    np.testing.assert_allclose(distance[:4], steps[:4], atol=1e-6)
    assert distance[4] > 1.0
    ring = PARTS[owner[1]]
    offset = np.array(ring.position) - mating
    np.testing.assert_allclose(offset - (offset @ normal) * normal, 0.0, atol=5e-4)
    assert distance_to(hull_boxes(), mating) == 0.0


@pytest.mark.parametrize(
    ("names", "axis", "low", "high"),
    [
        (("truss_",), 0, -51.3, 51.3),
        (("truss_",), 1, -7.0, -3.0),
        (("truss_",), 2, 1.0, 5.0),
        (("array_",), 1, -25.0, 16.0),
        (("array_",), 2, -31.0, 36.0),
        (("array_p4", "array_p6"), 0, 27.0, 57.0),
        (("array_s4", "array_s6"), 0, -57.0, -27.0),
        (("radiator_p1", "radiator_s1"), 1, -3.0, 21.0),
        (("radiator_p1", "radiator_s1"), 2, -4.0, 9.0),
        (("columbus", "kibo"), 0, -9.7, 23.0),
    ],
)
def test_extents_of_the_2015_station(names, axis, low, high):
    boxes = extent_of(*names)[..., axis]
    np.testing.assert_allclose((boxes.min(), boxes.max()), (low, high), atol=0.1)


@pytest.mark.parametrize(("name", "z"), [("harmony", -2.602), ("destiny", -2.602), ("zarya_body", -1.87)])
def test_centrelines(name, z):
    (part,) = (part for part in PARTS if part.name == name)
    np.testing.assert_allclose((part.position[0], part.position[2]), (0.233, z), atol=1e-9)


def test_poisk_and_pirs_are_coaxial():
    for part in PARTS:
        if part.name.startswith(("poisk", "pirs")):
            np.testing.assert_allclose(part.position[:2], (0.233, 20.129), atol=1e-9)


INVENTORY = """
    unity harmony tranquility destiny columbus kibo_pressurised kibo_logistics kibo_exposed kibo_arm leonardo
    cupola quest_equipment quest_crew pma_1 pma_2 pma_3 z1_truss zarya zvezda poisk pirs rassvet strela_1 strela_2
    truss_s0 truss_p1 truss_s1 truss_p3 truss_s3 truss_p4 truss_s4 truss_p5 truss_s5 truss_p6 truss_s6 alpha_joint
    ams_02 elc_1 elc_2 elc_3 elc_4 stowage_platform_1 stowage_platform_2 stowage_platform_3 canadarm2 dextre
    mobile_base trailing_thermal
"""


def test_the_inventory_is_complete():
    names = " ".join(part.name for part in PARTS)
    for word in INVENTORY.split():
        assert word in names, word
    panels = [part.name for part in PARTS if part.primitive == "panel"]
    assert sum("blanket" in name for name in panels) == 16  # two a wing
    assert sum(name.startswith(("radiator_p1", "radiator_s1")) for name in panels) == 6


def test_chaser_fits_its_bounding_sphere_but_for_trunk_and_arrays():
    rng = np.random.default_rng(0)
    beyond = {part.name for part in CHASER if np.linalg.norm(sample_surface(part, 4000, rng), axis=1).max() > RADIUS}
    assert beyond == {
        "trunk",
        "trunk_opening",
        "array_port",
        "array_starboard",
        "array_port_arm",
        "array_starboard_arm",
    }
    nose = max(bounds(part)[1, 2] for part in CHASER)
    assert 2.0 < nose < 3.66  # short of the plane of Harmony's forward port when it holds there


SHAPES = [
    rod("cylinder", (1.0, 2.0, -1.0), (2.0, 0.5, 1.5), 1.3, "metal", ""),
    rod("cone", (-1.0, 0.0, 0.3), (1.0, 0.8, 0.9), 2.0, "metal", "", 0.5),
    ball("sphere", (0.3, -0.2, 0.1), 1.7, "metal", ""),
    beam("box", (0.0, 0.0, 0.0), (0.0, 1.0, 2.0), 1.5, 0.7, "metal", ""),
    sheet("panel", (1.0, 0.0, 0.0), (1.0, 3.0, -1.0), 2.0, 0.05, "metal", ""),
]


@pytest.mark.parametrize("part", SHAPES, ids=lambda part: part.name)
def test_distances_and_bounds_agree_with_a_cloud_of_surface_points(part):
    rng = np.random.default_rng(1)
    cloud = sample_surface(part, 40_000, rng)
    np.testing.assert_allclose(signed_distance(part, cloud), 0.0, atol=1e-9)
    np.testing.assert_allclose((cloud.min(axis=0), cloud.max(axis=0)), bounds(part), atol=0.05)
    places = cloud.mean(axis=0) + rng.uniform(-3.0, 3.0, (500, 3))
    found = signed_distance(part, places)
    np.testing.assert_allclose(np.abs(found), cKDTree(cloud).query(places)[0], atol=0.05)
    # Convex: a point is inside if and only if no direction separates it from the surface.
    ways = rng.normal(size=(500, 3))
    outside = np.any(places @ ways.T > (cloud @ ways.T).max(axis=0) + 1e-9, axis=1)
    assert np.all(outside[found > 0.3]) and not np.any(outside[found < 0.0])
    assert np.any(found < 0.0) or part.name == "panel"


def test_no_point_of_any_part_is_outside_the_hull():
    rng = np.random.default_rng(2)
    hull = hull_boxes()
    for part in PARTS:
        points = sample_surface(part, 2000, rng)
        assert all_covered(hull, part, points), part.name
        assert all_covered(part_boxes(part), part, points), part.name
    for part in SHAPES:
        assert all_covered(part_boxes(part, 0.4), part, sample_surface(part, 5000, rng)), part.name


def test_hull_is_tight():
    quality = hull_quality(hull_boxes())
    print(quality)
    assert quality.covered == 1.0
    assert quality.excess_mean < 0.5 and quality.excess_p99 < 1.5  # measured 0.36 m and 1.31 m


def test_outer_samples_are_on_the_union_and_uniform():
    boxes = np.array([[[0.0, 0.0, 0.0], [2.0, 2.0, 2.0]], [[1.0, 0.5, 0.5], [3.0, 1.5, 1.5]]])
    points = outer_samples(boxes, 20_000, np.random.default_rng(0))
    inside = [np.all((points > b[0] + 1e-9) & (points < b[1] - 1e-9), axis=1) for b in boxes]
    assert not np.any(inside)
    # 24 m2 less the square metre where the small one comes out, and its 4 sides of 1 m and its end.
    np.testing.assert_allclose(np.mean(points[:, 0] > 2.0), 5.0 / 28.0, atol=0.01)


def random_boxes(rng, count):
    lower = rng.uniform(-8.0, 8.0, (count, 3))
    return np.stack([lower, lower + rng.uniform(0.2, 2.0, (count, 3))], axis=1)


def test_empty_volume_of_a_box_is_what_counting_gives():
    rng = np.random.default_rng(3)
    grid = grid_around(random_boxes(rng, 10), 0.5, 1.0)
    filled = rng.random(grid.shape)
    weight = rng.random(grid.shape)
    space = emptiness(filled, grid._replace(cells=0), weight)
    boxes = random_boxes(rng, 20)
    density = (1.0 - filled) * weight
    expected = [np.sum(density * occupancy_of(box[None], grid)) * 0.5**3 for box in boxes]
    np.testing.assert_allclose(space.of(boxes), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("count", [1, 7, 40, 60])
def test_merging_keeps_everything_and_returns_what_was_asked(count):
    rng = np.random.default_rng(4)
    atoms = random_boxes(rng, 60)
    grid = grid_around(atoms, 0.5, 1.0)
    boxes = merge(atoms, count, emptiness(occupancy_of(atoms, grid), grid))
    assert boxes.shape == (count, 2, 3)
    held = np.all((atoms[:, None, 0] >= boxes[:, 0]) & (atoms[:, None, 1] <= boxes[:, 1]), axis=-1)
    assert held.any(axis=1).all()


def test_merging_joins_what_belongs_together():
    """Two rows of four cubes 10 m apart become two bars."""
    lower = np.array([(x, y, 0.0) for x in range(4) for y in (0.0, 10.0)])
    atoms = np.stack([lower, lower + 1.0], axis=1)
    grid = grid_around(atoms, 0.5, 1.0)
    boxes = merge(atoms, 2, emptiness(occupancy_of(atoms, grid), grid))
    bars = [[[0.0, y, 0.0], [4.0, y + 1.0, 1.0]] for y in (0.0, 10.0)]
    np.testing.assert_allclose(boxes[np.argsort(boxes[:, 0, 1])], bars)
    with pytest.raises(ValueError, match="at least one box and a count of at least 1; got 8 boxes, count 0"):
        merge(atoms, 0, emptiness(occupancy_of(atoms, grid), grid))


def test_a_hull_is_written_and_read_back(tmp_path):
    path = tmp_path / "hull.csv"
    boxes = random_boxes(np.random.default_rng(5), 9)
    save_hull(path, boxes, "nine")
    again = load_hull(path)
    assert np.all(again[:, 0] <= boxes[:, 0]) and np.all(again[:, 1] >= boxes[:, 1])
    np.testing.assert_allclose(again, boxes, atol=1.001e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot read"),
        ("# nothing\n", "at least one box"),
        ("1,2,3\n", "six numbers|at least one"),
        ("a,b,c,d,e,f\n", "six numbers"),
        ("0,0,0,1,1,-1\n", "lower corner below"),
        ("0,0,0,1,1,nan\n", "finite"),
    ],
)
def test_a_bad_hull_file_is_named(tmp_path, text, message):
    path = tmp_path / "hull.csv"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        load_hull(path)
