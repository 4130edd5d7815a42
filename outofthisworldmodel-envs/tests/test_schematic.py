import subprocess
import sys

import numpy as np
import pytest

from owm_envs.camera import overlay
from owm_envs.camera.lens import Pose
from owm_envs.camera.overlay import Sheet
from owm_envs.camera.schematic import COLOURS, Drawing, Vehicle, draw_station, schematics, seen
from owm_envs.camera.views import camera
from owm_envs.station import PORTS, goal_poses, hull_boxes, port_index

NOWHERE = np.full(13, np.nan)
SIZE, MAIN = (480, 270), 336  # the large view ends at this column


def state_at(position, q=(1.0, 0.0, 0.0, 0.0)):
    return np.concatenate([position, np.zeros(3), q, np.zeros(3)])


def draw(view=NOWHERE, path=None, port=0, force=(0.0, 0.0, 0.0), boxes=None, size=SIZE, rows=(), title="flight"):
    path = np.zeros((0, 3)) if path is None else path
    boxes = hull_boxes() if boxes is None else boxes
    return schematics([Drawing([Vehicle(view, path, port, np.asarray(force))], title, rows, boxes)], size)[0]


def changed(a, b):
    return np.any(np.abs(a.astype(int) - b.astype(int)) > 6, axis=-1)


def like(image, colour, tolerance=12):
    return np.all(np.abs(image.astype(int) - colour) < tolerance, axis=-1)


@pytest.fixture(scope="module")
def still():
    return draw()


def test_picture_has_the_asked_size_and_shows_the_station(still):
    assert still.shape == (270, 480, 3) and still.dtype == np.uint8 and still.flags.writeable
    red, green, blue = np.moveaxis(still[:, :MAIN].astype(int), -1, 0)
    gold = (red > 90) & (red > 1.25 * green) & (green > 1.3 * blue)
    white = (still[:, :MAIN].min(axis=-1) > 140) & (np.ptp(still[:, :MAIN].astype(int), axis=-1) < 30)
    assert gold.mean() > 0.05 and white.mean() > 0.003


def test_frames_repeat_and_do_not_leak_into_the_next(still):
    draw(state_at((30.0, -40.0, 20.0)), np.linspace((0, -90, 50), (30, -40, 20), 50))
    np.testing.assert_array_equal(draw(), still)


def middle(image, still):
    rows, columns = np.nonzero(changed(image, still)[:, :MAIN])
    return np.array([columns.mean(), rows.mean()])


def test_chaser_is_drawn_where_it_is():
    """The mark moves up by zenith and to the left by starboard in the main view."""
    start = np.array([[0.0, -40.0, 0.0]])
    still = draw(path=start)
    near, up, left = (
        middle(draw(state_at(start[0] + shift), start), still)
        for shift in ((0.0, 0.0, 0.0), (0.0, 0.0, 15.0), (-30.0, 0.0, 0.0))
    )
    assert up[1] < near[1] - 10 and abs(up[0] - near[0]) < 6
    assert left[0] < near[0] - 10


def test_the_force_is_an_arrow():
    """A push to zenith adds an orange arrow upwards."""
    view = state_at((0.0, -45.0, 0.0))
    idle, up, down = (draw(view, force=(0.0, 0.0, push)) for push in (0.0, 0.9, -0.9))
    (_, above), (_, below) = middle(up, idle), middle(down, idle)
    assert above < below - 5 and (like(up, (255, 140, 60), 40) & changed(up, idle))[:, :MAIN].sum() > 3


def test_path_behind_the_hull_is_faint(still):
    """A line in front of the port-side blankets is brighter than the same line behind them."""
    across = np.linspace((-57.0, 6.0, 20.0), (-27.0, 6.0, 20.0), 60)
    towards = np.array([-0.46, -0.72, 0.46]) / np.linalg.norm([-0.46, -0.72, 0.46])
    before, behind = (draw(path=across + side * towards)[:, :MAIN] for side in (15.0, -15.0))
    bright, faint = (like(image, COLOURS[0], 40).sum() for image in (before, behind))
    assert bright > 10 and bright > 3 * faint
    assert changed(behind, still[:, :MAIN]).sum() > 10


def gold(image):
    red, green, blue = np.moveaxis(image[:, :MAIN].astype(int), -1, 0)
    return ((red > 90) & (red > 1.25 * green) & (green > 1.3 * blue) & (blue < 60)).mean()


def test_chaser_path_and_port_stay_in_the_picture():
    """However far it starts: the view steps back, and the way that has been flown is seen whole."""
    start = np.array([[0.0, -400.0, 100.0], [10.0, -200.0, 60.0]])
    far = draw(state_at(start[-1]), start)
    assert 0.0 < gold(far) < 0.3 * gold(draw(state_at((0.0, -40.0, 0.0))))
    assert like(far[:, :MAIN], COLOURS[0], 40).sum() > 20


@pytest.mark.parametrize("port", range(len(PORTS)))
def test_the_corridor_is_seen_from_its_side(port, still):
    """At the hold pose the small view shows the goal, in the active colour, about its middle."""
    image = draw(state_at(*np.split(goal_poses()[port], [3])), port=port)[:100, MAIN:]
    rows, columns = np.nonzero(like(image, (96, 240, 160), 30))
    assert len(rows) > 15
    assert abs(rows.mean() - 48) < 30 and abs(columns.mean() - 72) < 40


def test_an_obstacle_is_red_and_rows_are_written(still):
    extra = np.concatenate([hull_boxes(), [[[-4.0, -40.0, -4.0], [4.0, -32.0, 4.0]]]])
    assert like(draw(boxes=extra), overlay.BOX, 40).sum() > 30 > like(still, overlay.BOX, 20).sum()
    assert changed(draw(port=port_index("zvezda_aft")), still).any()
    panel = changed(draw(rows=[("time", "12.3 s")]), still)
    assert panel[:170].sum() == 0 and panel[170:, MAIN:].sum() > 20
    filled, _ = np.nonzero(changed(draw(rows=[("time", "12.3 s")] * 5), still))
    assert 0.9 * 270 < filled.max() < 0.98 * 270


@pytest.mark.slow
def test_flights_are_drawn_alike_alone_and_together(still):
    away = state_at((0.0, -50.0, 10.0))
    drawings = [Drawing([Vehicle(v, np.zeros((0, 3)), 0, np.zeros(3))], "flight") for v in (NOWHERE, away)]
    for image, alone in zip(schematics(drawings, SIZE), (still, draw(away))):
        apart = np.abs(image.astype(int) - alone)
        assert apart.max() <= 1 and (apart > 0).mean() < 1e-5  # a program of another size may round another way


def test_a_camera_gives_what_it_sees_and_nothing_over_it():
    views = np.array([[state_at((0.0, -60.0, 0.0), (0.5, -0.5, -0.5, 0.5))], [NOWHERE]])
    images = seen(views, camera("chaser_fpv", height=30, width=40))
    assert images.shape == (2, 30, 40, 3) and images.dtype == np.uint8
    assert not images[1].any()  # where no chaser is, its camera sees nothing


def test_lines_are_cut_at_the_camera_and_hidden_by_depth():
    """A pinhole at the origin that looks along y, before a wall at 10 m."""
    lens = camera("station_top", height=40, width=40, projection="perspective", field=np.pi / 2)
    lens = type(lens)(**{**vars(lens), "field": np.float32(np.pi / 2)})
    pose = Pose(np.zeros(3), np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]))

    def sheet():
        return Sheet(np.zeros((40, 40, 3), np.uint8), np.full((40, 40), 10.0), lens, pose)

    page = sheet()
    overlay.lines(page, np.array([[[-2.0, -5.0, 0.5], [2.0, 5.0, 0.5]]]), (0, 0, 255))
    assert page.image[..., 2].max() > 150 and page.image[:, :20].sum() == 0  # it comes into sight right of the middle
    page = sheet()
    overlay.lines(
        page, np.array([[[-6.0, 8.0, 0.0], [-6.0, 8.0, 6.0]], [[6.0, 12.0, 0.0], [6.0, 12.0, 9.0]]]), (0, 0, 255)
    )
    assert page.image[:, :20].max() > 150 and 20 < page.image[:, 20:].max() < 100
    page = sheet()
    overlay.lines(page, np.array([[[-6.0, -8.0, 0.0], [-6.0, -1.0, 6.0]], [[np.nan, 1, 1], [0, 5, 0]]]), (0, 0, 255))
    assert page.image.sum() == 0
    with pytest.raises(ValueError, match="orthographic"):
        overlay.scale_bar(page)


def test_the_station_is_drawn_with_boxes_and_ports():
    shot = camera("station_isometric", width=400, height=250)
    plain, ports, both = (
        draw_station(shot, boxes=b, ports=p) for b, p in ((None, False), (None, True), (hull_boxes(), True))
    )
    marks = [like(image, overlay.SPLITS["train"], 30).sum() for image in (plain, ports)]
    assert marks[0] < 5 and marks[1] > 40
    red = [(image[..., 0].astype(int) - image[..., 1] > 90).sum() for image in (ports, both)]
    assert red[1] > red[0] + 500
    assert changed(draw_station(shot, chaser=3, ports=False), plain).sum() > 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"boxes": np.zeros((2, 6))}, r"boxes must have shape \(N, 2, 3\)"),
        ({"view": np.zeros(12)}, r"view must have shape \(13,\)"),
        ({"path": np.zeros((3, 2))}, r"path \(T, 3\)"),
        ({"port": 8}, "port must be from 0 to 7; got 8"),
        ({"size": (20, 20)}, r"at least \(160, 120\)"),
    ],
)
def test_bad_input_is_named(change, message):
    with pytest.raises(ValueError, match=message):
        draw(**change)


def test_strict_flags_of_the_caller_change_nothing(jax_flags, still):
    with jax_flags(strict=True, enable_x64=True):
        np.testing.assert_array_equal(draw(), still)


def test_no_camera_is_imported_before_it_is_needed():
    code = (
        "import sys, owm_envs, gymnasium; gymnasium.make('ISSHCW-v0').reset(seed=0);"
        "assert 'cv2' not in sys.modules and not [m for m in sys.modules if m.startswith('owm_envs.camera')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
