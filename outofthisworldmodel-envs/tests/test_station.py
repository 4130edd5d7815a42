import numpy as np
import pytest

from owm_envs.station import (
    HELD_OUT_PORTS,
    PARTS,
    PORT_NAMES,
    PORTS,
    TRAIN_PORTS,
    docked_attitude,
    goal_poses,
    hull_boxes,
    part_boxes,
    port_index,
)

RADIUS = 2.25


def rotate(q, vector):
    inner = np.cross(q[1:], vector)
    return np.asarray(vector) + 2.0 * (q[0] * inner + np.cross(q[1:], inner))


def distance_to(boxes, points):
    points = np.asarray(points)[..., None, :]
    gaps = np.maximum(np.maximum(boxes[:, 0] - points, points - boxes[:, 1]), 0.0)
    return np.linalg.norm(gaps, axis=-1).min(axis=-1)


def boxes_of(*names):
    found = [part_boxes(part) for part in PARTS if part.name.startswith(names)]
    assert found, names
    return np.concatenate(found)


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


def test_hull_is_a_moderate_number_of_proper_boxes_within_the_start_shell():
    boxes = hull_boxes()
    assert boxes.dtype == np.float64 and 150 <= len(boxes) <= 313
    assert np.all(boxes[:, 1] > boxes[:, 0])
    assert np.linalg.norm(np.abs(boxes).max(axis=1), axis=-1).max() + RADIUS < 100.0
    assert len({part.name for part in PARTS}) == len(PARTS)


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
def test_every_interface_lies_on_structure(port):
    assert distance_to(hull_boxes(), np.array(port.interface)) < 0.25


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
    boxes = boxes_of(*names)[..., axis]
    np.testing.assert_allclose((boxes.min(), boxes.max()), (low, high), atol=0.1)


@pytest.mark.parametrize(("name", "z"), [("harmony", -2.602), ("destiny", -2.602), ("zarya_body", -1.87)])
def test_centrelines(name, z):
    boxes = boxes_of(name)
    np.testing.assert_allclose(boxes.mean(axis=(0, 1))[[0, 2]], (0.233, z), atol=1e-9)


def test_poisk_and_pirs_are_coaxial():
    for name in ("poisk", "pirs"):
        np.testing.assert_allclose(boxes_of(name).mean(axis=(0, 1))[:2], (0.233, 20.129), atol=1e-9)


def test_boxes_cover_the_solids_they_stand_for():
    """Sampled surface points of cylinders, cones and panels lie in their boxes."""
    rng = np.random.default_rng(0)
    for part in PARTS:
        boxes, centre, axis = part_boxes(part), np.array(part.position), np.array(part.axis)
        along = rng.uniform(-0.5, 0.5, (400, 1))
        if part.primitive == "cylinder":
            length, start, end = part.dimensions
            turn = rng.uniform(0.0, 2.0 * np.pi, (400, 1))
            side = np.roll(axis, 1)
            ring = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
            surface = centre + along * length * axis + 0.5 * (start + (end - start) * (along + 0.5)) * ring
        else:
            size = np.array(part.dimensions)
            if part.primitive == "panel":
                length, width, thickness = size
                normal = np.cross((1.0, 0.0, 0.0), axis)
                across, thick = rng.uniform(-0.5, 0.5, (2, 400, 1))
                surface = centre + along * length * axis + thick * thickness * normal
                surface = surface + across * width * np.array((1.0, 0.0, 0.0))
            else:
                surface = centre + rng.uniform(-0.5, 0.5, (400, 3)) * size
        assert distance_to(boxes, surface).max() < 1e-9, part.name
