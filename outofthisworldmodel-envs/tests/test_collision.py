import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from owm_envs.station import hull_boxes
from owm_envs.task.collision import swept_clearance, swept_distance

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
