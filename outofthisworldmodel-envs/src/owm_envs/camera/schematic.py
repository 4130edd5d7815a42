"""Pictures for people: the camera's, with what a flight is about drawn over them.

A schematic shows the whole flight, the port's corridor from its side, and what the chaser sees; by the light of `noon`.
"""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from owm_envs.camera import overlay
from owm_envs.camera.lens import Camera, Pose, placed, project
from owm_envs.camera.overlay import Colour, Sheet
from owm_envs.camera.render import render
from owm_envs.camera.scene import Scene, Visitors, default_scene
from owm_envs.camera.views import ZENITH, aimed, camera
from owm_envs.flags import own_flags
from owm_envs.station import PORTS, goal_poses, hull_boxes
from owm_envs.view import VIEW_SIZE, View

COLOURS: tuple[Colour, ...] = (
    (255, 214, 92),
    (96, 240, 160),
    (255, 122, 112),
    (110, 196, 255),
    (222, 140, 255),
    (255, 170, 60),
    (170, 240, 240),
    (240, 170, 200),
)
"""RGB of each chaser's path, port and words; they repeat beyond eight."""
LEAST_SIZE = (160, 120)
"""Pixels of a schematic, width and height."""

_ACTIVE: Colour = (96, 240, 160)
_THRUST: Colour = (255, 140, 60)
_FRAME: Colour = (52, 64, 92)
_FROM = np.array([-0.46, -0.72, 0.46])  # the viewer, on that side of the station where the port is
_FIELD = np.radians(30.0)
_DISTANCES = 60.0 * 1.12 ** np.arange(40)  # of that viewer [m]
_INSET = (0.27, 0.345)  # width and height of a small view, of the picture's; five lines of text fit below two
_LEAST_PATH = 400  # a longer path is thinned to so many points
_ABSENT = np.array([0.0, 0.0, 1e6, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], np.float32)
_AT_ONCE = 2**16  # so many pixels are drawn side by side, else one picture after the other


class Vehicle(NamedTuple):
    """A chaser to be drawn."""

    view: Float[np.ndarray, "13"]
    """True relative view; one that is not finite is not drawn."""
    path: Float[np.ndarray, "T 3"]
    """Positions so far [m], station frame."""
    port: int
    """Index into `PORTS`."""
    force: Float[np.ndarray, "3"]
    """Body axes, of the largest."""
    note: str = ""
    """A few words for the panel, if there are several chasers."""


class Drawing(NamedTuple):
    """What a schematic tells."""

    vehicles: Sequence[Vehicle]
    title: str
    rows: Sequence[tuple[str, str]] = ()
    """Labels and values for the panel."""
    boxes: Float[np.ndarray, "N 2 3"] = np.zeros((0, 2, 3))
    """Hull and obstacles [m]; those that are not the station's own are drawn."""


def photographs(
    views: Float[np.ndarray, "N V 13"], cameras: Sequence[Camera], scene: Scene | None = None
) -> tuple[tuple[dict[str, np.ndarray], Pose], ...]:
    """Take pictures of several scenes in one compiled call.

    Args:
        views: of each scene's chasers; cameras go with the first, who is not there if it is not finite.
        cameras: their leaves have a leading axis N.
        scene: the station's and the light; those of `default_scene` if not given.

    Returns:
        for each camera, what `render` gives and the camera's poses, with a leading axis N.
    """
    views = np.asarray(views, np.float32)
    views = np.where(np.isfinite(views).all(axis=-1, keepdims=True), views, _ABSENT)
    with own_flags(x64=False):
        return jax.device_get(_photographs(_scene() if scene is None else scene, views, tuple(cameras)))


@jax.jit
def _photographs(scene, views, cameras):
    def one(slot):
        vehicles, cameras = View.of(slot[0]), slot[1]
        others = vehicles.position[1:], vehicles.attitude[1:], jnp.ones(views.shape[1] - 1, bool)
        own = jax.tree.map(lambda a: a[0], vehicles)
        drawn = scene._replace(visitors=Visitors(*others))
        return tuple((render(drawn, own, camera), placed(camera, own)) for camera in cameras)

    at_once = _AT_ONCE // sum(camera.height * camera.width for camera in cameras)
    return jax.lax.map(one, (views, cameras), batch_size=at_once if at_once > 1 and len(views) > 1 else None)


@lru_cache(maxsize=1)
def _scene() -> Scene:
    return default_scene()


def seen(views: Float[np.ndarray, "N V 13"], camera: Camera) -> UInt8[np.ndarray, "N H W 3"]:
    """Give what one camera of each scene sees, red first; `views` are as for `photographs`."""
    ((outputs, _),) = photographs(views, [_stacked([camera] * len(views))])
    return outputs["rgb"]


def schematics(drawings: Sequence[Drawing], size: tuple[int, int] = (960, 540)) -> list[UInt8[np.ndarray, "H W 3"]]:
    """Draw a frame of each of several flights; all have as many chasers.

    Args:
        drawings: what to draw.
        size: width and height of a picture in pixels.

    Returns:
        (H, W, 3) uint8 each, red first.

    Raises:
        ValueError: arrays of the wrong shape, a port out of range, or a picture that is too small.
    """
    for drawing in drawings:
        _check(drawing)
    if size[0] < LEAST_SIZE[0] or size[1] < LEAST_SIZE[1]:
        raise ValueError(f"width and height must be at least {LEAST_SIZE} pixels for a schematic; got {tuple(size)}")
    layout = _Layout.of(size)
    cameras = [
        [_overview(drawing, layout.main) for drawing in drawings],
        [_abeam(drawing, layout.insets[0]) for drawing in drawings],
        [_base("chaser_fpv", *layout.insets[1][2:])] * len(drawings),
    ]
    views = np.array([[vehicle.view for vehicle in drawing.vehicles] for drawing in drawings])
    taken = photographs(views, [_stacked(row) for row in cameras])
    return [
        _composed(drawing, layout, [_sheet(got, row[slot], slot) for row, got in zip(cameras, taken)])
        for slot, drawing in enumerate(drawings)
    ]


def draw_station(
    camera: Camera,
    chaser: int | None = None,
    boxes: Float[np.ndarray, "N 2 3"] | None = None,
    ports: bool = True,
) -> UInt8[np.ndarray, "H W 3"]:
    """Draw the station, with its ports and corridors.

    Args:
        camera: where from.
        chaser: index of the port at whose hold pose a chaser is; None for no chaser.
        boxes: to draw as wires [m], station frame.
        ports: whether to draw them.

    Returns:
        (H, W, 3) uint8, red first.
    """
    view = np.full(VIEW_SIZE, np.nan)
    if chaser is not None:
        goal = goal_poses()[chaser]
        view = np.concatenate([goal[:3], np.zeros(3), goal[3:], np.zeros(3)])
    camera = dataclasses.replace(camera, outputs=("rgb", "depth"))
    (taken,) = photographs(view[None, None], [_stacked([camera])])
    sheet = _sheet(taken, camera, 0)
    if boxes is not None:
        overlay.boxes(sheet, boxes, strength=0.55, hidden=0.1)
    if ports:
        overlay.ports(sheet, names=True)
        _legend(sheet.image, sheet.unit, 20 * sheet.unit)
    if boxes is not None or ports:
        overlay.compass(sheet)
        if camera.projection == "orthographic":
            overlay.scale_bar(sheet)
    return sheet.image


class _Layout(NamedTuple):
    """Rectangles in pixels: x, y, width, height."""

    size: tuple[int, int]
    main: tuple[int, int, int, int]
    insets: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]
    panel: tuple[int, int, int, int]
    unit: float

    @classmethod
    def of(cls, size: tuple[int, int]) -> "_Layout":
        width, height = size
        gap = max(round(0.012 * width), 2)
        side, inset = (round(part * whole) for part, whole in zip(_INSET, size))
        left = width - side - gap
        insets = tuple((left, gap + number * (gap + inset), side, inset) for number in (0, 1))
        top = 3 * gap + 2 * inset
        main, panel = (0, 0, left - gap, height), (left, top, side, height - top - gap)
        return cls(size, main, insets, panel, min(width / 960.0, height / 540.0))


def _check(drawing: Drawing) -> None:
    for vehicle in drawing.vehicles:
        view, path = np.shape(vehicle.view), np.shape(vehicle.path)
        if view != (VIEW_SIZE,) or path[1:] != (3,):
            raise ValueError(f"a view must have shape ({VIEW_SIZE},), a path (T, 3); got {view} and {path}")
        if not 0 <= vehicle.port < len(PORTS):
            raise ValueError(f"port must be from 0 to {len(PORTS) - 1}; got {vehicle.port}")
    if np.ndim(drawing.boxes) != 3 or drawing.boxes.shape[1:] != (2, 3):
        raise ValueError(f"boxes must have shape (N, 2, 3); got {np.shape(drawing.boxes)}")


@lru_cache(maxsize=32)
def _base(name: str, width: int, height: int) -> Camera:
    return jax.tree.map(np.asarray, camera(name, height=height, width=width, outputs=("rgb", "depth")))


@lru_cache(maxsize=32)
def _towards(way: tuple[float, ...], up: tuple[float, ...]) -> Float[np.ndarray, "4"]:
    return np.asarray(aimed((0.0, 0.0, 0.0), way, up), np.float32)


def _stacked(cameras: Sequence[Camera]) -> Camera:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *cameras)


def _sheet(taken: tuple[dict[str, np.ndarray], Pose], camera: Camera, slot: int) -> Sheet:
    """One of the pictures that a camera took, to draw on."""
    outputs, poses = taken
    pose = jax.tree.map(lambda leaf: leaf[slot], poses)
    return Sheet(outputs["rgb"][slot].copy(), outputs["depth"][slot], jax.tree.map(np.asarray, camera), pose)


def _overview(drawing: Drawing, rectangle: tuple[int, int, int, int]) -> Camera:
    """A camera that stands still while it sees station, starts, paths and chasers, else steps back."""
    boxes = _station_corners()
    paths = [_finite(np.concatenate([v.path, v.view[None, :3]])) for v in drawing.vehicles]
    starts = [path[:1] for path in paths]
    around = np.concatenate([boxes, *starts])
    middle = 0.5 * (around.min(axis=0) + around.max(axis=0))
    normal = sum(np.asarray(PORTS[v.port].normal) for v in drawing.vehicles)
    back = np.where(np.abs(normal) > 0.5, np.sign(normal) * np.abs(_FROM), _FROM)
    back = back / np.linalg.norm(back)
    attitude = _towards(tuple((-back).tolist()), ZENITH)
    points = np.concatenate([boxes, *paths])
    _, _, width, height = rectangle
    base = dataclasses.replace(
        _base("station_isometric", width, height), attitude=attitude, field=np.asarray(_FIELD, np.float32)
    )
    axes = np.stack([overlay.turned(attitude, axis) for axis in np.diag([-1.0, 1.0, 1.0])], axis=1)
    for distance in _DISTANCES:
        place = middle + distance * back
        pixels, depth = project(base, Pose(place, axes), points)
        if (depth > 1.0).all() and (np.abs(pixels / (width, height) - 0.5) < 0.46).all():
            break
    return dataclasses.replace(base, position=place.astype(np.float32))


def _abeam(drawing: Drawing, rectangle: tuple[int, int, int, int]) -> Camera:
    """A camera that sees chasers and ports from zenith, or from starboard if the first port looks up or down."""
    vertical = abs(PORTS[drawing.vehicles[0].port].normal[2]) > 0.5
    way, up = ((1.0, 0.0, 0.0), ZENITH) if vertical else ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
    points = [np.asarray(PORTS[v.port].interface) for v in drawing.vehicles]
    points = np.stack(points + [v.view[:3] for v in drawing.vehicles if np.isfinite(v.view).all()])
    low, high = points.min(axis=0), points.max(axis=0)
    _, _, width, height = rectangle
    across, along = np.abs(np.cross(way, up)) @ (high - low), np.abs(up) @ (high - low)
    field = max(1.2 * along, 1.2 * across * height / width) + 14.0
    return dataclasses.replace(
        _base("station_top", width, height),
        position=(0.5 * (low + high) - 500.0 * np.asarray(way)).astype(np.float32),
        attitude=_towards(way, up),
        field=np.asarray(field, np.float32),
    )


@lru_cache(maxsize=1)
def _station_corners() -> Float[np.ndarray, "M 3"]:
    """Both corners of each of the station's boxes."""
    return hull_boxes().reshape(-1, 3)


@lru_cache(maxsize=1)
def _own_boxes() -> frozenset[bytes]:
    return frozenset(box.astype(np.float32).tobytes() for box in hull_boxes())


def _foreign(boxes: np.ndarray) -> np.ndarray:
    """Boxes that are not the station's own."""
    return boxes[[box.astype(np.float32).tobytes() not in _own_boxes() for box in boxes]]


def _finite(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) > _LEAST_PATH:
        points = points[np.linspace(0, len(points) - 1, _LEAST_PATH).astype(int)]
    return points


def _composed(drawing: Drawing, layout: _Layout, sheets: list[Sheet]) -> np.ndarray:
    """Draw over the three pictures, and put them together with the words."""
    import cv2

    several = len(drawing.vehicles) > 1
    colours = [COLOURS[index % len(COLOURS)] for index in range(len(drawing.vehicles))]
    active = {v.port: colour if several else _ACTIVE for v, colour in zip(drawing.vehicles, colours)}
    foreign = _foreign(drawing.boxes)
    for sheet in sheets[:2]:
        rows = np.linspace(1.3, 0.7, len(sheet.image))[:, None, None]
        sky = np.broadcast_to(rows * np.array(overlay.BACKGROUND), sheet.image.shape).astype(np.uint8)
        np.copyto(sheet.image, sky, where=~np.isfinite(sheet.depth)[..., None])
        for vehicle, colour in zip(drawing.vehicles, colours):
            overlay.curve(sheet, _finite(vehicle.path), colour, 2 if sheet is sheets[0] else 1)
    for sheet in sheets:
        overlay.boxes(sheet, foreign)
        overlay.ports(sheet, active, others=sheet is not sheets[2])
        for vehicle, colour in zip(drawing.vehicles, colours):
            _draw_vehicle(sheet, vehicle, colour, sheet is sheets[2])
    overlay.compass(sheets[0])
    overlay.scale_bar(sheets[1])

    image = np.empty((layout.size[1], layout.size[0], 3), np.uint8)
    image[:] = overlay.BACKGROUND
    for sheet, (x, y, w, h) in zip(sheets, (layout.main, *layout.insets)):
        image[y : y + h, x : x + w] = sheet.image
    unit = layout.unit
    vertical = abs(PORTS[drawing.vehicles[0].port].normal[2]) > 0.5
    for (x, y, w, h), caption in zip(
        (*layout.insets, layout.panel),
        (f"from {'starboard' if vertical else 'zenith'}", "chaser's camera" + (" (0)" if several else ""), ""),
    ):
        cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), _FRAME, 1)
        overlay.write(image, caption, (x + 6 * unit, y + 14 * unit), 0.36 * unit, overlay.MUTED, bool(caption))
    overlay.write(image, drawing.title, (16 * unit, 28 * unit), 0.58 * unit, overlay.TEXT if several else _ACTIVE)
    _legend(image, unit, 48 * unit)
    rows = [(label, value, overlay.MUTED) for label, value in drawing.rows] + [
        (f"{index}  {PORTS[v.port].name}", v.note, colour)
        for index, (v, colour) in enumerate(zip(drawing.vehicles, colours))
        if several
    ]
    x, y, w, h = layout.panel
    step = min(17.0 if not several else 30.0, (h / unit - 10) / max(len(rows), 1))
    for row, (label, value, colour) in enumerate(rows):
        at = np.array([x + 10 * unit, y + (20 + step * row) * unit])
        overlay.write(image, label, at, 0.41 * unit, colour)
        overlay.write(image, value, at + ((168 if several else 84) * unit, 0), 0.41 * unit)
    return image


def _draw_vehicle(sheet: Sheet, vehicle: Vehicle, colour: Colour, own: bool) -> None:
    if not np.isfinite(vehicle.view).all():
        return
    position, _, attitude, _ = View.of(np.asarray(vehicle.view, np.float64))
    goal = goal_poses()[vehicle.port]
    overlay.axes(sheet, goal[:3], goal[3:], 2.5)
    if own:  # what this camera sees is not hidden by its own marks
        return
    overlay.axes(sheet, position, attitude, 4.0)
    push = overlay.turned(attitude, np.nan_to_num(vehicle.force))
    if np.linalg.norm(push) > 0.02:
        overlay.arrow(sheet, position, position + 9.0 * push, _THRUST, 2)
    overlay.mark(sheet, position, colour)


def _legend(image: np.ndarray, unit: float, height: float) -> None:
    import cv2

    for column, split in enumerate(overlay.SPLITS):
        at = np.array([22 * unit + 110 * unit * column, height])
        cv2.circle(
            image, np.round(at).astype(int).tolist(), max(round(3 * unit), 1), overlay.SPLITS[split], 1, cv2.LINE_AA
        )
        overlay.write(image, f"{split.replace('_', '-')} port", at + (9 * unit, 4 * unit), 0.38 * unit, overlay.MUTED)
