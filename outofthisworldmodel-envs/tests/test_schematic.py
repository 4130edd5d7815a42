import subprocess
import sys

import numpy as np
import pytest

from owm_envs.render.schematic import draw_schematic
from owm_envs.station import goal_poses, hull_boxes, port_index

NO_PATH = np.zeros((0, 3))
SIZE = (480, 270)


def state_at(position, q=(1.0, 0.0, 0.0, 0.0)):
    return np.concatenate([position, np.zeros(3), q, np.zeros(3)])


def draw(state, path=NO_PATH, port=0, lines=(), boxes=None, size=SIZE):
    boxes = hull_boxes() if boxes is None else boxes
    return draw_schematic(boxes, goal_poses(), state, path, port, lines, size)


def changed(a, b):
    return np.any(a.astype(int) != b.astype(int), axis=-1)


def test_picture_has_the_asked_size_and_shows_the_station():
    image = draw(np.full(13, np.nan))
    assert image.shape == (270, 480, 3) and image.dtype == np.uint8
    assert not image.flags.writeable or image.base is None
    blue = (image[..., 2] > 120) & (image[..., 0] < 100)
    white = np.all(image > 150, axis=-1)
    assert blue.mean() > 0.05 and white.mean() > 0.003


def test_frames_repeat_and_do_not_leak_into_the_next():
    still = draw(np.full(13, np.nan))
    draw(state_at((30.0, -40.0, 20.0)), np.linspace((0, -90, 50), (30, -40, 20), 50))
    np.testing.assert_array_equal(draw(np.full(13, np.nan)), still)


def test_chaser_is_drawn_where_it_is():
    """The mark moves up by zenith and to the left by starboard in the main view."""
    still = draw(np.full(13, np.nan))
    centres = []
    for place in ((0.0, -40.0, 0.0), (0.0, -40.0, 15.0), (-30.0, -40.0, 0.0)):
        rows, columns = np.nonzero(changed(draw(state_at(place)), still)[:, :330])
        centres.append((columns.mean(), rows.mean()))
    assert centres[1][1] < centres[0][1] - 10 and abs(centres[1][0] - centres[0][0]) < 3
    assert centres[2][0] < centres[0][0] - 10


def test_nose_points_along_body_z():
    """Turning the nose from zenith to nadir moves the drawn arrow down."""
    still = draw(np.full(13, np.nan))
    rows = [
        np.nonzero(changed(draw(state_at((0.0, -45.0, 0.0), q)), still)[:, :330])[0].mean()
        for q in ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    ]
    assert rows[1] > rows[0] + 2


def test_path_behind_the_hull_is_faint():
    """A line in front of the port-side blankets is brighter than the same line behind them."""
    across = np.linspace((-57.0, 6.0, 20.0), (-27.0, 6.0, 20.0), 60)
    view = np.array([-0.46, -0.72, 0.46]) / np.linalg.norm([-0.46, -0.72, 0.46])
    still = draw(np.full(13, np.nan))
    strengths = []
    for side in (40.0, -40.0):
        image = draw(np.full(13, np.nan), across + side * view)
        mask = changed(image, still)[:, :330]
        assert mask.any()
        strengths.append(image[:, :330][mask][:, 0].mean())
    assert strengths[0] > strengths[1] + 50


def test_a_far_chaser_zooms_out():
    near, far = (draw(state_at((0.0, -r, 0.0))) for r in (40.0, 400.0))
    station = [((i[..., 2] > 120) & (i[..., 0] < 100)).mean() for i in (near, far)]
    assert 0.0 < station[1] < 0.2 * station[0]


def test_an_extra_obstacle_is_red_and_ports_and_numbers_show():
    still = draw(np.full(13, np.nan))
    extra = np.concatenate([hull_boxes(), [[[-4.0, -40.0, -4.0], [4.0, -32.0, 4.0]]]])
    image = draw(np.full(13, np.nan), boxes=extra)
    red = (image[..., 0] > 120) & (image[..., 1] < 100) & (image[..., 2] < 100)
    assert red.sum() > 100
    assert changed(draw(np.full(13, np.nan), port=port_index("zvezda_aft")), still).any()
    panel = changed(draw(np.full(13, np.nan), lines=["time  12.3 s"]), still)
    assert panel[:170].sum() == 0 and panel[170:, 330:].sum() > 20
    filled, _ = np.nonzero(changed(draw(np.full(13, np.nan), lines=["time  12.3 s"] * 5), still))
    assert 0.9 * 270 < filled.max() < 0.98 * 270


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"boxes": np.zeros((2, 6))}, r"boxes must have shape \(N, 2, 3\)"),
        ({"state": np.zeros(12)}, r"state must have shape \(13,\)"),
        ({"path": np.zeros((3, 2))}, r"path \(T, 3\)"),
        ({"port": 8}, "active_port must be from 0 to 7; got 8"),
        ({"size": (20, 20)}, r"at least \(160, 120\)"),
    ],
)
def test_bad_input_is_named(change, message):
    arguments = {"state": state_at((0.0, -40.0, 0.0)), **change}
    with pytest.raises(ValueError, match=message):
        draw(**arguments)


def test_importing_the_package_does_not_import_opencv():
    code = "import sys, owm_envs, owm_envs.render.schematic; assert 'cv2' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
