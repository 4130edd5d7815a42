import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from owm_envs.station import hull_boxes
from owm_envs.task.collision import Clearance, advance_clearance, clearance_at, swept_clearance, swept_distance

RADIUS = 2.25
clearance = jax.jit(swept_clearance)
distance = jax.jit(swept_distance)
metres = st.floats(-60, 60)
points = st.tuples(metres, metres, metres)


def brute_force(start, end, boxes, samples=4001):
    """Least distance from sampled points of the segment to any box; too large by at most one sample's spacing."""
    track = start + np.linspace(0, 1, samples)[:, None] * (end - start)
    gaps = np.maximum(np.maximum(boxes[:, None, 0] - track, track - boxes[:, None, 1]), 0)
    return np.sqrt((gaps**2).sum(-1)).min()


@settings(max_examples=60, deadline=None)
@given(
    start=points, travel=st.tuples(*[st.floats(-30, 30)] * 3), corner=points, size=st.tuples(*[st.floats(0.01, 9)] * 3)
)
def test_one_box_against_a_sampled_segment(start, travel, corner, size):
    with jax.enable_x64(True):
        start, end = np.array(start), np.add(start, travel)
        box = np.array([corner, np.add(corner, size)])
        sampled = brute_force(start, end, box[None])
        exact = float(distance(start, end, box))
    assert sampled - np.linalg.norm(travel) / 8000 - 1e-9 <= exact <= sampled + 1e-9


@settings(max_examples=60, deadline=None)
@given(start=points, travel=st.tuples(*[st.floats(-29, 29)] * 3))
@example(start=(19.0, 0.0, 0.0), travel=(0.0, 4.0, 0.0))  # the first box examined is not the nearest
def test_hull_against_a_sampled_segment(start, travel):
    with jax.enable_x64(True):
        start, end = np.array(start), np.add(start, travel)
        boxes = hull_boxes()
        exact = float(clearance(start, end, RADIUS, boxes)) + RADIUS
        sampled = brute_force(start, end, boxes, 2001)
        half = np.linalg.norm(travel) / 2
    if sampled < RADIUS:
        assert exact == pytest.approx(sampled, abs=half / 1000 + 1e-9)
    assert sampled - half - 1e-9 <= exact <= sampled + 1e-9


@pytest.mark.parametrize("travel", [0.2, 5.0, 50.0])
def test_no_tunnelling_through_a_thin_panel(travel):
    panel = np.array([[[-5.0, -0.01, -5.0], [5.0, 0.01, 5.0]]])
    start, end = np.array([1.0, -travel / 2, 2.0]), np.array([1.0, travel / 2, 2.0])
    assert float(swept_clearance(start, end, 0.05, panel)) <= 0


@pytest.mark.parametrize(("offset", "touches"), [(2.24, True), (2.26, False)])
def test_edges_are_rounded(offset, touches):
    box = np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]])
    corner = 1 + offset / np.sqrt(2)
    start, end = np.array([corner, corner, -50.0]), np.array([corner, corner, 50.0])
    assert (float(swept_clearance(start, end, RADIUS, box)) <= 0) == touches


def test_batch_equals_single():
    with jax.enable_x64(True):
        boxes = hull_boxes()
        generator = np.random.default_rng(0)
        start = jnp.asarray(generator.uniform(-40, 40, (64, 3)))
        end = start + jnp.asarray(generator.uniform(-5, 5, (64, 3)))
        batched = jax.jit(jax.vmap(swept_clearance, (0, 0, None, None)))(start, end, RADIUS, boxes)
        single = [float(clearance(s, e, RADIUS, boxes)) for s, e in zip(start, end)]
    np.testing.assert_allclose(batched, single, atol=1e-12)


MOVES = 6
vectors = {size: st.tuples(*[st.floats(-size, size)] * 3) for size in (0.3, 4, 28)}
moves = st.one_of(st.just((0.0, 0.0, 0.0)), *vectors.values())  # at rest, and up to 48 m at once


def fly(points, radius, boxes):
    """The clearance, and whether a box was touched, after each move of a sphere along a polyline."""

    def move(carry, end):
        known, start = carry
        known, touched = advance_clearance(known, start, end, radius, boxes)
        return (known, end), (known, touched)

    start = clearance_at(points[0], radius, boxes)
    return jax.lax.scan(move, (start, points[0]), points[1:])[1]


flown = jax.jit(fly)
flown_together = jax.jit(jax.vmap(fly, (0, None, None)))


def least_distance(start, end, boxes):
    """Least distance of a segment to any box, by trisection: the distance to a convex body is convex along a line."""

    def gaps(t):
        point = start + t[:, None] * (end - start)
        return np.linalg.norm(np.maximum(np.maximum(boxes[:, 0] - point, point - boxes[:, 1]), 0), axis=-1)

    low, high = np.zeros(len(boxes)), np.ones(len(boxes))
    for _ in range(50):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        lower = gaps(left) < gaps(right)
        low, high = np.where(lower, low, left), np.where(lower, right, high)
    return min(gaps(t).min() for t in (low, high, np.zeros(len(boxes)), np.ones(len(boxes))))


def check_polyline(points, radius, boxes, found, touched, margin):
    """What `Clearance` promises, against distances found otherwise."""
    true_least = least_distance(points[0], points[0], boxes) - radius
    longest, contact = 0.0, true_least <= 0
    for k, (start, end) in enumerate(itertools.pairwise(points)):
        swept = least_distance(start, end, boxes) - radius
        assert touched[k] == (swept <= 0) or abs(swept) < margin
        contact |= bool(touched[k])
        true_least, longest = min(true_least, swept), max(longest, np.linalg.norm(end - start))
        assert found.now[k] <= least_distance(end, end, boxes) - radius + margin
        assert found.least[k] <= true_least + margin
        assert found.least[k] >= min(true_least, 0.95 * max(true_least - longest / 2, 0)) - margin
        assert (found.least[k] <= 0) == contact or abs(true_least) < margin


def grazing(box, axis, gap, radius):
    """Ends of a pass along a face of a box, `gap` m from contact."""
    middle, ahead, aside = box.mean(0), np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
    beside = middle + aside * ((box[1] - box[0])[(axis + 1) % 3] / 2 + radius + gap)
    return beside - 24 * ahead, beside + 24 * ahead


@pytest.mark.parametrize(
    ("kind", "dtype", "margin"), [("hull", np.float64, 3e-7), ("random", np.float64, 3e-7), ("hull", np.float32, 2e-4)]
)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_room_along_a_polyline(kind, dtype, margin, data):
    if kind == "hull":
        boxes, radius = hull_boxes(), RADIUS
    else:
        lower = np.array(data.draw(st.tuples(*[points] * 5)))
        boxes = np.stack([lower, lower + data.draw(st.tuples(*[st.tuples(*[st.floats(0.01, 20)] * 3)] * 5))], axis=1)
        radius = data.draw(st.floats(0.01, 5))
    track = [np.array(data.draw(points))]
    if data.draw(st.booleans()):
        box, gap = boxes[data.draw(st.integers(0, len(boxes) - 1))], data.draw(st.sampled_from([-0.01, 1e-6, 0.01]))
        track = list(grazing(box, data.draw(st.integers(0, 2)), gap, radius))
    while len(track) <= MOVES:
        track.append(track[-1] + data.draw(moves))
    track, boxes, radius = (np.asarray(x, dtype) for x in (track, boxes, radius))
    with jax.enable_x64(True):
        found, touched = jax.device_get(flown(track, radius, boxes))
    assert found.now.dtype == dtype
    check_polyline(*(x.astype(np.float64) for x in (track, radius, boxes)), found, touched, margin)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("travel", [0.2, 50.0])
def test_grazing_a_face_is_told_from_missing_it(axis, travel):
    box = np.array([[[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]])
    with jax.enable_x64(True):
        for gap in (-1e-9, 1e-9):
            start, end = grazing(box[0], axis, gap, RADIUS)
            halfway, ahead = (start + end) / 2, np.eye(3)[axis] * travel / 2
            stop = [halfway + ahead] * (MOVES - 1)
            _, touched = flown(np.array([halfway - ahead, halfway + ahead, *stop]), RADIUS, box)
            assert touched[0] == (gap < 0)


@pytest.mark.parametrize("travel", [0.2, 5.0, 50.0])
def test_a_move_does_not_tunnel(travel):
    panel = np.array([[[-5.0, -0.01, -5.0], [5.0, 0.01, 5.0]]])
    along = np.linspace(-travel / 2, travel * (MOVES - 0.5), MOVES + 1)
    _, touched = flown(np.stack([np.ones(MOVES + 1), along, np.full(MOVES + 1, 2.0)], axis=1), 0.05, panel)
    assert list(touched) == [True] + [False] * (MOVES - 1)


def test_the_least_does_not_creep_down_between_measurements():
    """A kilometre to and fro, a metre at a time, a hundred metres off."""
    box = np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]])
    to_and_fro = np.array([[102.0, k % 2, 0.0] for k in range(1000)])
    found, touched = flown(to_and_fro, 1.0, box)
    assert not touched.any()
    assert 0.95 * 99.5 <= found.least[-1] <= 100
    assert found.least[-1] == found.least.min()


@pytest.fixture(scope="module")
def crowd():
    """64 polylines about the hull, most of them in contact with it at some time, and their clearance as one batch."""
    generator = np.random.default_rng(3)
    inside = hull_boxes().mean(1)[generator.integers(0, 313, 64)]
    tracks = np.cumsum(generator.normal(size=(64, MOVES + 1, 3)) * generator.choice([0.1, 3, 15], (64, 1, 1)), axis=1)
    tracks += (inside - tracks[:, MOVES // 2])[:, None]  # half the way through a box
    tracks[::5] += [0, 0, 200.0]
    with jax.enable_x64(True):
        return tracks, jax.device_get(flown_together(tracks, RADIUS, hull_boxes()))


def test_a_crowd_in_contact_with_the_hull(crowd):
    tracks, (found, touched) = crowd
    assert touched.sum(axis=0).min() > 20  # of 64 at once, at every move
    assert not touched[::5].any()
    for i, track in enumerate(tracks[::4]):
        one = jax.tree.map(lambda x, i=i: x[4 * i], (found, touched))
        check_polyline(track, RADIUS, hull_boxes(), *one, 3e-7)


def test_a_batch_equals_its_singles_bit_for_bit(crowd):
    tracks, batch = crowd
    with jax.enable_x64(True):
        single = [flown(track, RADIUS, hull_boxes()) for track in tracks]
        nested = jax.jit(jax.vmap(jax.vmap(fly, (0, None, None)), (0, None, None)))
        rows = nested(tracks.reshape(4, 16, *tracks.shape[1:]), RADIUS, hull_boxes())
    single = jax.tree.map(lambda *leaves: np.stack(leaves), *single)
    rows = jax.tree.map(lambda x: np.reshape(x, (64, *x.shape[2:])), rows)
    jax.tree.map(np.testing.assert_array_equal, single, batch)
    jax.tree.map(np.testing.assert_array_equal, rows, batch)


def test_a_radius_and_boxes_of_each_episode(crowd):
    """One track, a batch of spheres and of boxes."""
    track = crowd[0][0]
    radii = np.linspace(0.1, 3, 8)
    boxes = track[3] + np.array([[[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]]) + np.linspace(0, 20, 8)[:, None, None, None]
    with jax.enable_x64(True):
        each = jax.jit(jax.vmap(fly, (None, 0, 0)))(track, radii, boxes)
        assert each[1].any() and not each[1].all(axis=1).all()
        for i in range(8):
            mine = jax.tree.map(lambda x, i=i: x[i], each)
            jax.tree.map(np.testing.assert_array_equal, mine, flown(track, radii[i], boxes[i]))


def test_many_histories_of_one_move():
    box = np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]])
    before = Clearance(np.array([9.0, 0.5]), np.array([5.0, 0.5]), np.array([5.0, 0.5]))
    move = np.array([11.0, 0.0, 0.0]), np.array([10.0, 0.0, 0.0])
    after, touched = jax.vmap(advance_clearance, (0, None, None, None, None))(before, *move, 1.0, box)
    np.testing.assert_allclose(after.now, [8, 8], rtol=1e-6)  # kept, and measured
    np.testing.assert_allclose(after.least, [5, 0.5])
    assert not touched.any()


def test_gradients_stop_here(quick):
    box = np.array([[[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]])

    def total(track):
        found, _ = fly(track, RADIUS, box)
        return jnp.sum(found.now + found.least) + jnp.sum(track)

    tracks = np.random.default_rng(0).normal(size=(3, MOVES + 1, 3)) * 4
    gradient = quick(jax.grad(lambda tracks: jnp.sum(jax.vmap(total)(tracks))))(tracks)
    np.testing.assert_array_equal(gradient, 1)
    np.testing.assert_array_equal(quick(jax.grad(total))(tracks[0]), 1)


def test_a_miss_is_bounded_from_below_and_exact_only_near_the_box():
    """What is promised past a unit box: contact, and a bound at most half the travel low."""
    box, start = np.array([[[0.0] * 3, [1.0] * 3]]), np.array([5.25, 0.5, 0.5])
    travel = 20 * np.array([0.5, 0.75**0.5, 0])
    value, exact = (
        float(clearance(start, start + travel, RADIUS, box)),
        brute_force(start, start + travel, box) - RADIUS,
    )
    assert exact == pytest.approx(2.0) and value == pytest.approx(0.085, abs=1e-3)
    assert exact - 10 <= value <= exact and value > 0
    assert float(clearance(start, start - travel, RADIUS, box)) == pytest.approx(
        brute_force(start, start - travel, box) - RADIUS, abs=0.01
    )
    assert float(clearance(start, start - [2.01, 0, 0], RADIUS, box)) <= 0
