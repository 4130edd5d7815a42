"""Lines and words on a picture of the camera, with OpenCV: a line that a part hides is fainter."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from owm_envs.camera.lens import Camera, Pose, project
from owm_envs.station.ports import PORTS

Colour = tuple[int, int, int]
TEXT, MUTED, BACKGROUND = (214, 222, 235), (138, 152, 178), (13, 17, 28)
SPLITS: Mapping[str, Colour] = {"train": (92, 170, 255), "held_out": (255, 176, 72)}
BOX: Colour = (255, 92, 80)
AXES: tuple[Colour, ...] = ((240, 90, 90), (110, 220, 110), (100, 150, 255))
COMPASS = {"forward": (0.0, -1.0, 0.0), "port": (1.0, 0.0, 0.0), "zenith": (0.0, 0.0, 1.0)}

_NEAR = 0.05  # what is closer to the camera is not drawn [m]
_SLACK = 0.3  # a line this far below a surface still lies on it [m]
_PIECE = 3.0  # so long is a piece of a line that is hidden or not [pixels]
_SHIFT = 4  # OpenCV's places are in sixteenths of a pixel


class Sheet(NamedTuple):
    """A picture to draw on, and where its pixels are; NumPy throughout."""

    image: UInt8[np.ndarray, "H W 3"]
    """Red first; drawn on in place."""
    depth: Float[np.ndarray, "H W"]
    """As the camera gives it: along the optical axis [m], infinite where nothing is."""
    camera: Camera
    pose: Pose

    @property
    def unit(self) -> float:
        """The size of words and marks: 1 in a picture of 960 by 540."""
        return max(min(self.camera.width / 960.0, self.camera.height / 540.0), 0.5)


def lines(
    sheet: Sheet,
    ends: Float[np.ndarray, "N 2 3"],
    colour: Colour,
    width: int = 1,
    strength: float = 1.0,
    hidden: float = 0.3,
) -> None:
    """Draw straight lines.

    Args:
        ends: m, station frame.
        width: pixels.
        strength: 0 to 1, how much of the picture behind the line it covers.
        hidden: of that strength, where a part stands before the line.
    """
    runs, behind = _runs(sheet, np.asarray(ends, np.float64))
    _strokes(sheet.image, runs[behind], colour, 1, hidden * strength)
    _strokes(sheet.image, runs[~behind], colour, width, strength)


def curve(sheet: Sheet, points: Float[np.ndarray, "T 3"], colour: Colour, width: int = 1, **how: float) -> None:
    """Draw a line through points [m], station frame; `how` is as for `lines`."""
    lines(sheet, np.stack([points[:-1], points[1:]], axis=1), colour, width, **how)


def arrow(
    sheet: Sheet, start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], colour: Colour, width: int = 1
) -> None:
    """Draw an arrow between two points [m], station frame."""
    across = np.cross(end - start, sheet.pose.axes[:, 2])
    size = np.linalg.norm(across)
    if size > 1e-9:
        across = across * (0.12 * np.linalg.norm(end - start) / size)
        neck = end - 0.25 * (end - start)
        lines(sheet, np.array([[start, end], [end, neck + across], [end, neck - across]]), colour, width)


def axes(sheet: Sheet, position: Float[np.ndarray, "3"], attitude: Float[np.ndarray, "4"], length: float) -> None:
    """Draw the axes of a body in `AXES`: x, y and the nose z.

    Args:
        position: m, station frame.
        attitude: unit quaternion, scalar first, body to station.
        length: of the arrows [m].
    """
    for axis, colour in zip(np.eye(3), AXES):
        arrow(sheet, position, position + length * turned(attitude, axis), colour)


def turned(attitude: Float[np.ndarray, "4"], vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Turn a body vector into the station frame."""
    inner = np.cross(attitude[1:], vector)
    return np.asarray(vector) + 2.0 * (attitude[0] * inner + np.cross(attitude[1:], inner))


def boxes(sheet: Sheet, corners: Float[np.ndarray, "N 2 3"], colour: Colour = BOX, **how: float) -> None:
    """Draw boxes as wires, without edges inside another box; `corners` are their lower and upper ones [m]."""
    signs = [(a, b) for a in (0, 1) for b in (0, 1)]
    edges = np.empty((3, 4, len(corners), 2, 3))
    for axis in range(3):
        first, second = (i for i in range(3) if i != axis)
        for number, (a, b) in enumerate(signs):
            edges[axis, number, :, :, axis] = corners[:, :, axis]
            edges[axis, number, :, :, first] = corners[:, a, first, None]
            edges[axis, number, :, :, second] = corners[:, b, second, None]
    edges = edges.reshape(-1, 2, 3)
    middle = edges.mean(axis=1)[:, None]
    inside = ((middle > corners[:, 0] + 1e-3) & (middle < corners[:, 1] - 1e-3)).all(axis=-1).any(axis=1)
    lines(sheet, edges[~inside], colour, **how)


def ports(sheet: Sheet, active: Mapping[int, Colour] | None = None, others: bool = True, names: bool = False) -> None:
    """Draw each port: where a chaser holds, and the corridor to it.

    Args:
        active: colours by index of the ports that chasers are bound for; a cone marks these.
        others: whether to draw the other ports.
        names: whether to write them.
    """
    active = active or {}
    length = dict.fromkeys((port.normal for port in PORTS), 8.0)
    for index, port in enumerate(PORTS):
        bound = index in active
        if not bound and not others:
            continue
        colour = active[index] if bound else SPLITS[port.split]
        mating, normal = np.asarray(port.interface), np.asarray(port.normal)
        if names:  # side by side, no two names may be at one height
            length[port.normal] += 6.0
        reach = 26.0 if bound else max(length[port.normal], 14.0)
        hold, far = mating + port.standoff * normal, mating + reach * normal
        hidden = 0.45 if bound else 0.3
        lines(sheet, np.array([[mating, far]]), colour, hidden=hidden)
        curve(sheet, _ring(hold, normal, 2.25), colour, 2 if bound else 1, hidden=hidden)
        curve(sheet, _ring(mating, normal, 0.65), colour, hidden=hidden)
        if bound:
            curve(sheet, _ring(far, normal, 7.0), colour, strength=0.7, hidden=hidden)
        if names:
            (start, place), depth = project(sheet.camera, sheet.pose, np.stack([mating, far]))
            inside = (place >= 0).all() and (place < sheet.image.shape[1::-1]).all()
            if depth.min() > _NEAR and inside and np.linalg.norm(place - start) > 12.0:
                write(sheet.image, port.name, place + (6 * sheet.unit, 0), 0.42 * sheet.unit, colour, plate=True)


def _ring(centre: np.ndarray, normal: np.ndarray, radius: float) -> Float[np.ndarray, "41 3"]:
    """A circle across one of the frame's axes."""
    turn = np.linspace(0.0, 2.0 * np.pi, 41)[:, None]
    first, second = np.eye(3)[np.argsort(np.abs(normal), kind="stable")[:2]]
    return centre + radius * (first * np.cos(turn) + second * np.sin(turn))


def mark(sheet: Sheet, position: Float[np.ndarray, "3"], colour: Colour, radius: float = 2.25) -> None:
    """Draw a ring around a sphere [m], at least 6 pixels wide so that it is found from afar."""
    import cv2

    place, depth = project(sheet.camera, sheet.pose, position)
    if depth <= _NEAR:
        return
    beside, _ = project(sheet.camera, sheet.pose, position + radius * sheet.pose.axes[:, 0])
    size = max(np.linalg.norm(beside - place), 6.0 * sheet.unit)
    hidden = bool(_hidden(sheet, place, depth - radius))
    layer = sheet.image.copy()
    cv2.circle(layer, _fixed(place).tolist(), round(size * 2**_SHIFT), colour, 1, cv2.LINE_AA, _SHIFT)
    _blend(sheet.image, layer, 0.5 if hidden else 1.0)


def compass(sheet: Sheet) -> None:
    """Draw in a corner where forward, port and zenith are."""
    import cv2

    unit, root = sheet.unit, np.array([52 * sheet.unit, sheet.image.shape[0] - 52 * sheet.unit])
    for label, axis in COMPASS.items():
        way = np.asarray(axis) @ sheet.pose.axes[:, :2] * (1, -1)
        tip = root + 30 * unit * way
        cv2.line(sheet.image, _fixed(root).tolist(), _fixed(tip).tolist(), MUTED, 1, cv2.LINE_AA, _SHIFT)
        if np.linalg.norm(way) > 0.2:
            write(sheet.image, label, tip + 8 * unit * way + (-12 * unit, 4 * unit), 0.34 * unit, MUTED)


def scale_bar(sheet: Sheet) -> None:
    """Draw a length in a corner; only parallel rays have one scale."""
    if sheet.camera.projection == "perspective":
        raise ValueError("a scale bar needs an orthographic camera: in perspective there is no one scale")
    import cv2

    unit, (height, width) = sheet.unit, sheet.image.shape[:2]
    scale = height / float(sheet.camera.field)
    metres = next((m for m in (1, 2, 5, 10, 20, 50, 100, 200, 500) if m * scale > 50 * unit), 1000)
    start = np.array([width - 44 * unit - metres * scale, height - 12 * unit])
    ends = [_fixed(start + (length, 0)).tolist() for length in (0.0, metres * scale)]
    cv2.line(sheet.image, *ends, TEXT, max(round(2 * unit), 1), cv2.LINE_AA, _SHIFT)
    write(sheet.image, f"{metres} m", start + (metres * scale + 5 * unit, 4 * unit), 0.34 * unit, TEXT)


def write(
    image: UInt8[np.ndarray, "H W 3"],
    text: str,
    at: Sequence[float],
    scale: float,
    colour: Colour = TEXT,
    plate: bool = False,
) -> None:
    """Write a line.

    Args:
        at: lower left corner [pixels].
        scale: OpenCV's: capitals are some 22 pixels high at 1.
        plate: whether to darken what is behind.
    """
    import cv2

    place = (round(float(at[0])), round(float(at[1])))
    if plate:
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        x, y, pad = *place, 3
        window = image[max(y - height - pad, 0) : max(y + pad, 0), max(x - pad, 0) : max(x + width + pad, 0)]
        window[:] = (0.35 * window + 0.65 * np.array(BACKGROUND)).astype(np.uint8)
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)


def _fixed(pixels: np.ndarray) -> np.ndarray:
    return np.round((pixels - 0.5) * 2**_SHIFT).astype(np.int32)


def _blend(image: np.ndarray, layer: np.ndarray, strength: float) -> None:
    import cv2

    image[:] = cv2.addWeighted(layer, strength, image, 1.0 - strength, 0.0)


def _strokes(image: np.ndarray, runs: np.ndarray, colour: Colour, width: int, strength: float) -> None:
    import cv2

    if len(runs):
        layer = image.copy()
        cv2.polylines(layer, list(_fixed(runs)), False, colour, width, cv2.LINE_AA, _SHIFT)
        _blend(image, layer, strength)


def _hidden(sheet: Sheet, pixels: np.ndarray, depth: np.ndarray) -> Bool[np.ndarray, "..."]:
    """Whether a part stands before points at these pixels and depths."""
    height, width = sheet.depth.shape
    column = np.clip(pixels[..., 0].astype(int), 0, width - 1)
    row = np.clip(pixels[..., 1].astype(int), 0, height - 1)
    return sheet.depth[row, column] < depth - _SLACK


def _runs(sheet: Sheet, ends: np.ndarray) -> tuple[Float[np.ndarray, "R 2 2"], Bool[np.ndarray, "R"]]:
    """Cut lines where they leave the picture and where they come to be hidden: ends in pixels, and whether hidden."""
    nothing = np.zeros((0, 2, 2)), np.zeros(0, bool)
    ends = ends[np.isfinite(ends).all(axis=(1, 2))]
    _, depth = project(sheet.camera, sheet.pose, ends)
    ends, depth = ends[(depth > _NEAR).any(axis=1)], depth[(depth > _NEAR).any(axis=1)]
    if not len(ends):
        return nothing
    # What lies behind the camera goes.
    steep = np.where(depth[:, 0] == depth[:, 1], 1.0, depth[:, 1] - depth[:, 0])
    cross = ends[:, 0] + np.clip((_NEAR - depth[:, 0]) / steep, 0.0, 1.0)[:, None] * (ends[:, 1] - ends[:, 0])
    ends = np.where((depth > _NEAR)[..., None], ends, cross[:, None])
    pixels, depth = project(sheet.camera, sheet.pose, ends)
    depth = np.maximum(depth, 0.5 * _NEAR)
    # What lies beside the picture goes.
    way = pixels[:, 1] - pixels[:, 0]
    slope = np.where(np.abs(way) < 1e-9, 1e-9, way)
    borders = np.array([[-2.0, -2.0], np.add(sheet.image.shape[1::-1], 2.0)])
    cuts = np.sort((borders[:, None] - pixels[:, 0]) / slope, axis=0)
    start, stop = np.maximum(cuts[0].max(axis=1), 0.0), np.minimum(cuts[1].min(axis=1), 1.0)
    seen = start < stop
    if not seen.any():
        return nothing
    pixels, depth, way, start, stop = (a[seen] for a in (pixels, depth, way, start, stop))
    # Along a line in the picture 1 / depth is linear in perspective, depth itself in parallel.
    longest = (np.linalg.norm(way, axis=1) * (stop - start)).max()
    count = int(np.clip(np.ceil(longest / _PIECE), 1, 400))
    at = start[:, None] + (stop - start)[:, None] * np.linspace(0.0, 1.0, count + 1)
    middle = 0.5 * (at[:, 1:] + at[:, :-1])
    between = lambda a: a[:, :1] + middle * (a[:, 1:] - a[:, :1])
    deep = 1.0 / between(1.0 / depth) if sheet.camera.projection == "perspective" else between(depth)
    behind = _hidden(sheet, pixels[:, None, 0] + middle[..., None] * way[:, None], deep)
    first = np.ones(behind.shape, bool)
    first[:, 1:] = behind[:, 1:] != behind[:, :-1]
    begins = np.flatnonzero(first)
    row = begins // count
    limits = np.stack([begins, np.append(begins[1:], behind.size)], axis=1) - row[:, None] * count
    along = np.take_along_axis(at[row], limits, axis=1)
    return pixels[row, None, 0] + along[..., None] * way[row, None], behind.ravel()[begins]
