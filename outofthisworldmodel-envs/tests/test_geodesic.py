import math

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.field import FieldConfig, clearance, cost_to_go, load_field, solve_field
from owm_envs.station import PORT_NAMES, PORTS, goal_poses, hull_boxes, port_index

COARSE = FieldConfig(fine_spacing=2.0, coarse_spacing=16.0)
NO_SHELL = FieldConfig(fine_spacing=2.0, coarse_spacing=8.0, side_speed=1.0)
WALL = np.array([[[-20.0, 0.0, -20.0], [20.0, 2.0, 20.0]]])
UP = np.array([[0.0, -1.0, 0.0]])
EMPTY = np.zeros((0, 2, 3))

look_up = jax.jit(jax.vmap(cost_to_go, (None, None, 0)))
look_up_clearance = jax.jit(jax.vmap(clearance, (None, 0)))


@pytest.fixture(scope="session")
def walled():
    """A wall of 40 m by 40 m across y, and a goal 12 m in front of it."""
    return solve_field(WALL, np.array([[0.0, -12.0, 0.0]]), UP, config=NO_SHELL)


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("fields")


@pytest.fixture(scope="session")
def station_field(cache, quick_fields):
    """The real field of two ports, solved once and kept in a directory of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OWM_ENVS_CACHE", str(cache))
        return load_field(("zvezda_aft", "harmony_zenith"), progress=lambda *_: None)


def shell(rng, count, low, high):
    direction = rng.normal(size=(count, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(low, high, (count, 1))


def distance_to(boxes, point):
    gaps = jnp.maximum(jnp.maximum(boxes[:, 0] - point, point - boxes[:, 1]), 0.0)
    return jnp.min(jnp.linalg.norm(gaps, axis=-1))


@jax.jit
def follow(field, port, starts, boxes):
    """Walk down the gradient in steps of 0.25 m: phi and distance to the hull at each of 1600 steps."""

    def walk(start):
        def step(position, _):
            phi, gradient = cost_to_go(field, port, position)
            way = gradient / jnp.maximum(jnp.linalg.norm(gradient), 1e-6)
            left = jnp.linalg.norm(position - field.goals[port])
            return position - way * jnp.minimum(0.25, left), (phi, distance_to(boxes, position))

        return jax.lax.scan(step, start, length=1600)

    return jax.vmap(walk)(starts)


def test_empty_space_gives_the_straight_distance():
    goal = np.array([5.0, -3.0, 2.0])
    field = solve_field(EMPTY, goal[None], UP, config=NO_SHELL)
    places = shell(np.random.default_rng(0), 500, 0.5, 600.0) + goal
    phi, gradient = look_up(field, 0, jnp.asarray(places, jnp.float32))
    distance = np.linalg.norm(places - goal, axis=1)
    inside = np.all(np.abs(places) < 250.0, axis=1)
    np.testing.assert_allclose(np.asarray(phi)[inside], distance[inside], rtol=0.02, atol=0.05)
    away = (places - goal) / distance[:, None]
    assert np.sum(np.asarray(gradient) * away, axis=1)[inside].min() > math.cos(math.radians(8.0))
    assert np.all(np.asarray(phi) >= 0.98 * distance)  # beyond the grid: never shorter


def test_side_shell_makes_one_come_in_by_the_cone():
    field = solve_field(EMPTY, np.zeros((1, 3)), UP)
    front, beside = look_up(field, 0, jnp.asarray([[0.0, -30.0, 0.0], [0.0, 30.0, 0.0]], dtype=jnp.float32))[0]
    np.testing.assert_allclose(front, 30.0, atol=0.1)
    # No dearer than straight through the shell, or around it to the rim of the cone; much dearer than 30 m.
    through = 18.0 + 9.0 / 0.3 + 3.0
    around = math.sqrt(30.0**2 - 12.0**2) + 12.0 * (math.radians(120.0) - math.acos(12.0 / 30.0)) + 12.0
    assert 40.0 < beside < 1.02 * min(through, around)


def test_behind_a_wall_the_way_is_around_it(walled):
    behind = jnp.asarray([[6.0, 15.0, 0.0], [6.0, 40.0, -3.0]], dtype=jnp.float32)
    phi, gradient = look_up(walled, 0, behind)
    straight = np.linalg.norm(np.asarray(behind) - (0.0, -12.0, 0.0), axis=1)
    # Any way around passes over an edge line of the wall grown by the sphere's radius.
    shortest = math.hypot(22.25 - 6.0, 15.0 - 2.0) + math.hypot(22.25, 12.0)
    assert np.all(np.asarray(phi) > 1.2 * straight)
    assert shortest < phi[0] < 1.5 * shortest
    assert -gradient[0, 0] > 0.4  # towards the near edge, at +x


def test_clearance_is_the_distance_of_the_sphere_to_the_hull(walled):
    places = np.array([[0.0, -8.0, 0.0], [25.0, 1.0, 0.0], [0.0, 1.0, 3.0], [0.0, 90.0, 0.0], [900.0, 0.0, 0.0]])
    found = np.asarray(look_up_clearance(walled, jnp.asarray(places, jnp.float32)))
    np.testing.assert_allclose(found[:2], (8.0 - 2.25, 5.0 - 2.25), atol=0.1)
    assert found[2] < -2.25
    np.testing.assert_allclose(found[3], 88.0 - 2.25, rtol=0.03)
    assert 200.0 < found[4] < 880.0


@hypothesis.settings(deadline=None, max_examples=80)
@hypothesis.given(st.tuples(*(st.floats(-1000.0, 1000.0, width=32),) * 3))
def test_everything_is_finite_everywhere(station_field, place):
    place = jnp.asarray([place], dtype=jnp.float32)
    phi, gradient = look_up(station_field, 1, place)
    assert np.isfinite(phi).all() and phi[0] >= 0.0
    assert np.isfinite(gradient).all() and np.linalg.norm(gradient) < 60.0
    assert np.isfinite(look_up_clearance(station_field, place)).all()


def test_inside_boxes_and_at_the_goal_everything_is_finite(station_field):
    inside = hull_boxes().mean(axis=1)
    places = jnp.asarray(np.concatenate([inside, goal_poses()[:, :3]]), jnp.float32)
    phi, gradient = look_up(station_field, 0, places)
    assert np.isfinite(phi).all() and np.isfinite(gradient).all()
    slope = jax.jit(jax.vmap(jax.grad(lambda p, field: cost_to_go(field, 0, p)[0]), (0, None)))
    derivative = slope(places, station_field)
    assert np.isfinite(derivative).all()
    np.testing.assert_allclose(phi[len(inside) + port_index("zvezda_aft")], 0.0, atol=1e-5)
    assert np.all(look_up_clearance(station_field, places)[: len(inside)] < 0.0)


def test_gradient_is_that_of_phi(walled):
    """In the open, where nothing bends sharply, the interpolated gradient is the slope of phi."""
    places = jnp.asarray(shell(np.random.default_rng(3), 300, 40.0, 240.0), jnp.float32)
    places = places[np.asarray(places[:, 1]) < -20.0]
    _, gradient = look_up(walled, 0, places)
    step = 4.0
    slope = [
        (look_up(walled, 0, places + step * e)[0] - look_up(walled, 0, places - step * e)[0]) / (2.0 * step)
        for e in np.eye(3, dtype=np.float32)
    ]
    error = np.linalg.norm(np.asarray(gradient) - np.stack(slope, axis=1), axis=1)
    assert np.median(error) < 0.02 and np.quantile(error, 0.97) < 0.1  # a few places lie on a crease
    assert np.median(np.abs(np.linalg.norm(gradient, axis=1) - 1.0)) < 0.02


def test_phi_is_continuous_across_the_seam_of_the_grids(station_field):
    """Just inside and just outside each face of the fine grid."""
    rng = np.random.default_rng(5)
    lower = np.asarray(station_field.fine_origin, np.float64)
    upper = lower + (np.array(station_field.phi_fine.shape[1:]) - 1)
    places = rng.uniform(lower, upper, (300, 3))
    axis = rng.integers(0, 3, 300)
    high = rng.random(300) < 0.5
    rows = np.arange(300)
    places[rows, axis] = np.where(high, upper[axis], lower[axis])
    outward = np.zeros((300, 3))
    outward[rows, axis] = np.where(high, 0.01, -0.01)
    inside, outside = (np.asarray(look_up(station_field, 0, jnp.asarray(p, jnp.float32))[0])
                       for p in (places - outward, places + outward))  # fmt: skip
    np.testing.assert_allclose(outside, inside, atol=0.05)


@pytest.mark.parametrize(("row", "name"), [(0, "zvezda_aft"), (1, "harmony_zenith")])
def test_following_the_field_docks_without_touching(station_field, row, name):
    starts = jnp.asarray(shell(np.random.default_rng(row), 64, 100.0, 225.0), jnp.float32)
    ends, (phi, gap) = follow(station_field, row, starts, jnp.asarray(hull_boxes(), jnp.float32))
    goal = goal_poses()[port_index(name), :3]
    np.testing.assert_allclose(ends, np.broadcast_to(goal, ends.shape), atol=0.01)
    # Between samples 0.25 m apart the centre comes at most 0.125 m nearer: swept clearance, not only sampled.
    assert gap.min() - 0.125 > 2.25
    assert np.diff(phi, axis=1).max() < 0.05


def test_eight_ports_fit_in_memory(station_field):
    nodes, *rest = station_field
    assert nodes.nbytes * len(PORTS) / nodes.shape[0] + sum(leaf.nbytes for leaf in rest) < 155e6


def test_all_eight_ports_at_a_coarse_spacing(quick_fields):
    """The geometry of every port is reachable; the standard spacing is flown for two of them above."""
    normals = np.array([port.normal for port in PORTS])
    field = solve_field(hull_boxes(), goal_poses()[:, :3], normals, config=COARSE)
    starts = jnp.asarray(shell(np.random.default_rng(9), 12, 100.0, 225.0), jnp.float32)
    boxes = jnp.asarray(hull_boxes(), jnp.float32)
    for row in range(len(PORTS)):
        ends, (_, gap) = follow(field, row, starts, boxes)
        # Cells of 2 m blur the last half metre.
        assert np.linalg.norm(ends - goal_poses()[row, :3], axis=1).max() < 0.5, PORT_NAMES[row]
        assert gap.min() > 2.25, PORT_NAMES[row]


def test_double_positions_give_doubles_and_the_same_numbers(station_field):
    place = np.array([[30.0, -60.0, 12.0]])
    single = look_up(station_field, 1, jnp.asarray(place, jnp.float32))
    with jax.enable_x64(True):
        double = look_up(station_field, 1, jnp.asarray(place, jnp.float64))
        gap = look_up_clearance(station_field, jnp.asarray(place, jnp.float64))
        assert double[0].dtype == double[1].dtype == gap.dtype == jnp.float64
    assert single[0].dtype == single[1].dtype == jnp.float32
    np.testing.assert_allclose(double[0], single[0], rtol=1e-6)
    np.testing.assert_allclose(double[1], single[1], atol=1e-6)


def test_cache_serves_every_selection_and_survives_damage(cache, station_field, monkeypatch):
    monkeypatch.setenv("OWM_ENVS_CACHE", str(cache))
    solved = []
    report = lambda message, done, total: solved.append((message, done, total))
    again = load_field(("harmony_zenith",), progress=report)
    assert not solved
    np.testing.assert_array_equal(again.nodes[0], station_field.nodes[1])
    (damaged,) = cache.glob("harmony_zenith-*.f32")
    damaged.write_bytes(damaged.read_bytes()[:100_000])
    again = load_field(("harmony_zenith",), progress=report)
    assert solved[0] == ("solving the geodesic field of harmony_zenith", 0, 1) and solved[-1][1:] == (1, 1)
    np.testing.assert_array_equal(again.nodes[0], station_field.nodes[1])
    assert not list(cache.glob(".*"))


def shifted(path, other):
    """Whole numbers, finite and in their places, but not those that were solved."""
    numbers = np.frombuffer(path.read_bytes(), "<f4").copy()
    numbers[-1000:] += 1.0
    path.write_bytes(numbers.tobytes())


def linked_in_a_circle(path, other):
    path.unlink()
    path.symlink_to(path.name)


FIELD_DAMAGE = {
    "wrong numbers": shifted,
    "another port's": lambda path, other: path.write_bytes(other.read_bytes()),
    "zeros": lambda path, other: path.write_bytes(bytes(path.stat().st_size)),
    "one bit": lambda path, other: path.write_bytes(path.read_bytes()[:-1] + bytes([path.read_bytes()[-1] ^ 1])),
    "empty": lambda path, other: path.write_bytes(b""),
    "longer": lambda path, other: path.write_bytes(path.read_bytes() + b"0"),
    "a folder": lambda path, other: (path.unlink(), path.mkdir()),
    "a circle of links": linked_in_a_circle,
}


@pytest.mark.parametrize("damage", FIELD_DAMAGE)
def test_a_cached_file_that_was_damaged_is_solved_anew_once(damage, tmp_path, monkeypatch, quick_fields):
    monkeypatch.setenv("OWM_ENVS_CACHE", str(tmp_path))
    ports, said = ("pirs_nadir", "poisk_zenith"), []

    def load():
        said.clear()
        return load_field(ports, boxes=WALL, progress=lambda *now: said.append(now), config=COARSE)

    first = load()
    assert len(said) == 3
    (path,), (other,), (clearances,) = (tmp_path.glob(f"{name}-*.f32") for name in (*ports, "clearance"))
    for file, solved in ((path, 2), (clearances, 0)):
        FIELD_DAMAGE[damage](file, other)
        for expected in (solved, 0):
            again = load()
            assert len(said) == expected
            for one, two in zip(first, again):
                np.testing.assert_array_equal(one, two)


def test_an_unwritable_cache_only_warns(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("OWM_ENVS_CACHE", str(blocked / "below"))
    with pytest.warns(UserWarning, match="could not be kept"):
        field = load_field(("pirs_nadir",), boxes=WALL, progress=lambda *_: None, config=COARSE)
    assert field.nodes.shape[0] == 1


def test_other_boxes_have_a_field_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setenv("OWM_ENVS_CACHE", str(tmp_path))
    for shift in (0.0, 1.0):
        load_field(("pirs_nadir",), boxes=WALL + shift, progress=lambda *_: None, config=COARSE)
    assert len(list(tmp_path.glob("pirs_nadir-*.f32"))) == 2


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: solve_field(np.zeros((3, 6)), UP, UP), r"boxes must have shape \(N, 2, 3\); got \(3, 6\)"),
        (lambda: solve_field(WALL[:, ::-1], UP, UP), "lower corner first"),
        (lambda: solve_field(WALL, UP, 2.0 * UP), "unit vectors"),
        (lambda: solve_field(WALL, UP[0], UP[0]), r"\(P, 3\)"),
        (lambda: solve_field(WALL, np.nan * UP, UP), "finite"),
        (lambda: load_field(()), "non-empty"),
        (lambda: load_field("zvezda_aft"), "sequence of port names"),
        (lambda: load_field(("zvezda_aff",)), "did you mean 'zvezda_aft'"),
        (lambda: FieldConfig(coarse_spacing=2.5), "whole multiple"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
