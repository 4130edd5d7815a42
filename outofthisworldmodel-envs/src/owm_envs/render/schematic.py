"""A schematic of the docking scene: the hull boxes, the ports, the chaser and its path, drawn with OpenCV.

The hull is drawn once per view, with a depth buffer, and kept; a frame then costs a copy and some lines.
"""

import functools
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from owm_envs.station import PARTS, PORTS, hull_boxes, nearest_part
from owm_envs.view import VIEW_SIZE, View

_BACKGROUND = (13, 17, 28)
_PANEL = (19, 25, 40)
_FRAME = (52, 64, 92)
_TEXT = (214, 222, 235)
_MUTED = (128, 142, 168)
_TRAIN = (92, 156, 255)
_HELD_OUT = (255, 168, 76)
_ACTIVE = (96, 240, 160)
_PATH = (255, 214, 92)
_CHASER = (245, 247, 252)
_EXTRA = (226, 84, 84)

_LIGHT = np.array([-0.35, -0.62, 0.70])
_ZOOMS = (56.0, 84.0, 126.0, 190.0, 285.0, 430.0, 800.0)  # half of a view's height [m]
_CENTRE = np.array([0.0, 2.0, 1.0])
_SPHERE_RADIUS = 2.25
_INSET = (0.27, 0.345)  # width and height of a small view, of the picture's; five lines of text fit below two


class _View(NamedTuple):
    """An orthographic camera: unit vectors in the station frame, a rectangle in pixels, and its scale."""

    right: tuple[float, float, float]
    up: tuple[float, float, float]
    rectangle: tuple[int, int, int, int]  # x, y, width, height
    scale: float  # pixels per metre

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and depth (...), greater being nearer to the viewer."""
        right, up = np.array(self.right), np.array(self.up)
        offset = np.asarray(points, np.float64) - _CENTRE
        x, y, width, height = self.rectangle
        u = x + 0.5 * width + self.scale * (offset @ right)
        v = y + 0.5 * height - self.scale * (offset @ up)
        return np.stack([u, v], axis=-1), offset @ np.cross(right, up)


def _looking_from(direction: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Right and up of a viewer in this direction who holds zenith upwards."""
    back = np.array(direction) / np.linalg.norm(direction)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return tuple(right.tolist()), tuple(np.cross(back, right).tolist())


_ISOMETRIC = _looking_from((-0.46, -0.72, 0.46))
_SIDE = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0))  # from starboard: forward to the right, zenith up
_TOP = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0))  # from zenith: forward to the right, port up


_COLOURS = {
    "radiator": (232, 234, 238),
    "array": (58, 92, 176),
    "array_blue": (70, 78, 150),
    "truss": (150, 156, 166),
    "equipment": (150, 156, 166),
    "russian": (186, 190, 172),
    "metal": (120, 124, 134),
    "dark": (120, 124, 134),
}  # by material


@functools.cache
def _part_colours() -> dict[bytes, tuple[int, int, int]]:
    """A base colour for each of the station's boxes, found by its corners: that of the commonest material in it."""
    boxes = hull_boxes()
    signs = np.stack(np.meshgrid(*[(-0.7, 0.0, 0.7)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    places = boxes.mean(axis=1) + 0.5 * signs * (boxes[:, 1] - boxes[:, 0])
    _, owners = nearest_part(PARTS, places.reshape(-1, 3))
    colours = {}
    for box, near in zip(boxes, owners.reshape(len(signs), -1).T):
        material = max(names := [PARTS[i].material for i in near], key=names.count)
        colours[box.astype(np.float32).tobytes()] = _COLOURS.get(material, (206, 210, 216))
    return colours


def _draw_boxes(boxes: np.ndarray, view: _View) -> tuple[np.ndarray, np.ndarray]:
    """Cast one ray a pixel at every box: colours (H, W, 3) and depths (H, W), -inf where nothing is hit."""
    _, _, width, height = view.rectangle
    view = view._replace(rectangle=(0, 0, width, height))
    right, up = np.array(view.right), np.array(view.up)
    back = np.cross(right, up)
    depth = np.full((height, width), -np.inf, np.float32)
    image = np.zeros((height, width, 3), np.float32)
    owner = np.full((height, width), -1, np.int32)
    centre = np.array([0.5 * width, 0.5 * height])
    light = _LIGHT / np.linalg.norm(_LIGHT)
    for number, box in enumerate(boxes):
        corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(8, 3)
        pixels, _ = view.project(corners)
        u0, v0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
        u1, v1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, (width, height))
        if u0 >= u1 or v0 >= v1:
            continue
        u = (np.arange(u0, u1) + 0.5 - centre[0]) / view.scale
        v = -(np.arange(v0, v1) + 0.5 - centre[1]) / view.scale
        start = _CENTRE + u[None, :, None] * right + v[:, None, None] * up
        direction = np.where(np.abs(back) < 1e-9, 1e-9, back)
        first, second = (box[0] - start) / direction, (box[1] - start) / direction
        enter = np.maximum(first, second)  # towards the viewer the ray leaves the box through its seen face
        seen = enter.min(axis=-1)
        hit = (np.minimum(first, second).max(axis=-1) <= seen) & (seen > depth[v0:v1, u0:u1])
        if not hit.any():
            continue
        axis = enter.argmin(axis=-1)
        lambert = np.maximum(light * np.sign(back), 0.0)[axis]
        colour = np.array(_part_colours().get(box.astype(np.float32).tobytes(), _EXTRA), np.float32)
        shade = 0.42 + 0.72 * lambert
        extent = box[1] - box[0]
        if extent[0] > 13.0 and np.all(extent[1:] < 4.0) and colour[2] > 1.5 * colour[0]:  # a blanket pair
            across = (start[..., 0] + seen * back[0] - box[0, 0]) / extent[0] - 0.5
            shade = np.where(np.abs(across) < 0.045, 0.30, 0.86 + 0.12 * (axis == 2))
        depth[v0:v1, u0:u1][hit] = seen[hit]
        owner[v0:v1, u0:u1][hit] = number * 3 + axis[hit]
        image[v0:v1, u0:u1][hit] = np.minimum(colour * shade[..., None], 255.0)[hit]
    # Lines where the depth jumps, fainter ones where a face ends.
    for shift in (0, 1):
        jump = np.abs(np.diff(np.where(np.isfinite(depth), depth, -1e3), axis=shift)) > 2.5
        change = np.diff(owner, axis=shift) != 0
        target = image[1:] if shift == 0 else image[:, 1:]
        target[change] *= 0.86
        target[jump] *= 0.55
    return image, depth


class _Scene(NamedTuple):
    image: np.ndarray  # (H, W, 3) uint8, never written to
    depths: tuple[np.ndarray, ...]  # one (h, w) per view
    views: tuple[_View, ...]
    panel: tuple[int, int, int, int]  # where the text goes
    unit: float  # one text size unit


@functools.lru_cache(maxsize=8)
def _scene(hull: bytes, size: tuple[int, int], half_height: float, inset_half_height: float) -> _Scene:
    """The still part of a frame: hull in three views, frames, captions."""
    import cv2

    width, height = size
    boxes = np.frombuffer(hull, np.float64).reshape(-1, 2, 3)
    side, inset = (round(part * whole) for part, whole in zip(_INSET, size))
    gap = max(round(0.012 * width), 2)
    left = width - side - gap
    unit = min(width / 960.0, height / 540.0)
    inset_scale = 0.5 * inset / inset_half_height
    views = (
        _View(*_ISOMETRIC, (0, 0, left - gap, height), 0.5 * min(height, (left - gap) / 1.2) / half_height),
        _View(*_TOP, (left, gap, side, inset), inset_scale),
        _View(*_SIDE, (left, 2 * gap + inset, side, inset), inset_scale),
    )
    rows = np.linspace(1.25, 0.75, height)[:, None, None]
    image = np.broadcast_to(np.clip(np.array(_BACKGROUND) * rows, 0, 255), (height, width, 3)).astype(np.float32)
    for x, y, w, h in (view.rectangle for view in views[1:]):
        image[y : y + h, x : x + w] = _PANEL
    depths = []
    for view in views:
        x, y, w, h = view.rectangle
        fine = view._replace(rectangle=(0, 0, 2 * w, 2 * h), scale=2.0 * view.scale)
        colours, depth = _draw_boxes(boxes, fine)
        solid = np.isfinite(depth).astype(np.float32)
        colours = cv2.resize(colours * solid[..., None], (w, h), interpolation=cv2.INTER_AREA)
        cover = cv2.resize(solid, (w, h), interpolation=cv2.INTER_AREA)[..., None]
        image[y : y + h, x : x + w] = image[y : y + h, x : x + w] * (1.0 - cover) + colours
        depths.append(depth[::2, ::2])
    image = np.ascontiguousarray(image.clip(0, 255).astype(np.uint8))
    for view, caption in zip(views, ("", "from zenith", "from starboard")):
        x, y, w, h = view.rectangle
        if caption:
            cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), _FRAME, 1)
            _write(image, caption, (x + 6 * unit, y + 14 * unit), 0.36 * unit, _MUTED)
    top = 3 * gap + 2 * inset
    panel = (left, top, side, height - top - gap)
    cv2.rectangle(image, panel[:2], (panel[0] + panel[2] - 1, panel[1] + panel[3] - 1), _PANEL, -1)
    cv2.rectangle(image, panel[:2], (panel[0] + panel[2] - 1, panel[1] + panel[3] - 1), _FRAME, 1)
    _triad_and_scale(image, views[0], unit)
    return _Scene(image, tuple(depths), views, panel, unit)


def _write(image: np.ndarray, text: str, at: tuple[float, float], scale: float, colour: tuple) -> None:
    import cv2

    place = (round(at[0]), round(at[1]))
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)


def _line(image: np.ndarray, start: np.ndarray, end: np.ndarray, colour: tuple, thickness: int = 1) -> None:
    """An anti-aliased line between sub-pixel places."""
    import cv2

    ends = [tuple(np.clip(np.round(p * 16.0), -(2**20), 2**20).astype(int).tolist()) for p in (start, end)]
    cv2.line(image, *ends, colour, thickness, cv2.LINE_AA, 4)


def _triad_and_scale(image: np.ndarray, view: _View, unit: float) -> None:
    x, y, w, h = view.rectangle
    root = np.array([x + 52 * unit, y + h - 58 * unit])
    for label, axis in (("forward", (0, -1, 0)), ("port", (1, 0, 0)), ("zenith", (0, 0, 1))):
        tip = np.array([np.dot(axis, view.right), -np.dot(axis, view.up)])
        _line(image, root, root + 30 * unit * tip, _MUTED)
        _write(image, label, root + 36 * unit * tip + (-12 * unit, 4 * unit), 0.34 * unit, _MUTED)
    metres = next(m for m in (20, 50, 100, 200, 500) if m * view.scale > 60 * unit or m == 500)
    start = np.array([x + w - 60 * unit - metres * view.scale, y + h - 22 * unit])
    _line(image, start, start + (metres * view.scale, 0), _MUTED, 2)
    _write(image, f"{metres} m", start + (metres * view.scale + 6 * unit, 4 * unit), 0.36 * unit, _MUTED)


def _hidden(pixels: np.ndarray, depths: np.ndarray, buffer: np.ndarray) -> np.ndarray:
    """Whether points lie behind the hull."""
    height, width = buffer.shape
    u = np.clip(pixels[..., 0].astype(int), 0, width - 1)
    v = np.clip(pixels[..., 1].astype(int), 0, height - 1)
    return buffer[v, u] > depths + 0.3


def _faded(colour: tuple, part: float) -> tuple:
    return tuple(round(part * c + (1.0 - part) * b) for c, b in zip(colour, _BACKGROUND))


def _polyline(image, points: np.ndarray, view: _View, buffer: np.ndarray, colour: tuple, thickness: int) -> None:
    """A curve in the station frame: drawn faintly where the hull hides it."""
    import cv2

    if len(points) < 2:
        return
    pixels, depths = view.project(points)
    hidden = _hidden(pixels, depths, buffer)
    fixed = np.clip(np.round(pixels * 16.0), -(2**20), 2**20).astype(np.int32)
    breaks = np.flatnonzero(np.diff(hidden)) + 1
    for run in np.split(np.arange(len(points)), breaks):
        run = np.append(run, min(run[-1] + 1, len(points) - 1))
        tone, weight = (_faded(colour, 0.35), 1) if hidden[run[0]] else (colour, thickness)
        cv2.polylines(image, [fixed[run]], False, tone, weight, cv2.LINE_AA, 4)


def _rotate(q: np.ndarray, vector: tuple[float, float, float]) -> np.ndarray:
    """Turn a body vector into the station frame by q_bw."""
    w, axis = q[0], q[1:]
    inner = np.cross(axis, vector)
    return np.asarray(vector) + 2.0 * (w * inner + np.cross(axis, inner))


def _draw_port(image, goal: np.ndarray, view: _View, buffer, active: bool, colour: tuple, size: float) -> None:
    import cv2

    outward = -_rotate(goal[3:], (0.0, 0.0, 1.0))
    length = 26.0 if active else 9.0
    _polyline(image, goal[:3] + outward * np.linspace(0.0, length, 24)[:, None], view, buffer, colour, 1)
    if active:  # the approach cone
        across = np.cross(outward, view.right) if abs(outward @ view.right) < 0.9 else np.cross(outward, view.up)
        across /= np.linalg.norm(across)
        other = np.cross(outward, across)
        turn = np.linspace(0.0, 2.0 * np.pi, 41)[:, None]
        ring = goal[:3] + outward * length + 7.0 * (across * np.cos(turn) + other * np.sin(turn))
        _polyline(image, ring, view, buffer, _faded(colour, 0.6), 1)
        for corner in ring[[0, 10, 20, 30]]:
            steps = np.linspace(0.0, 1.0, 24)[:, None]
            _polyline(image, goal[:3] + steps * (corner - goal[:3]), view, buffer, _faded(colour, 0.6), 1)
    pixel, depth = view.project(goal[:3])
    tone = _faded(colour, 0.5) if _hidden(pixel, depth, buffer) else colour
    centre = tuple(np.round(pixel * 16.0).astype(int).tolist())
    cv2.circle(image, centre, round((4.5 if active else 2.8) * size * 16), tone, -1 if active else 1, cv2.LINE_AA, 4)


def _draw_chaser(image, state: np.ndarray, view: _View, buffer: np.ndarray, colour: tuple, unit: float) -> None:
    import cv2

    x, y, w, h = view.rectangle
    position, _, attitude, _ = View.of(state)
    pixel, depth = view.project(position)
    margin = 12.0 * unit
    inside = np.clip(pixel, (x + margin, y + margin), (x + w - margin, y + h - margin))
    if np.any(inside != pixel):  # beyond the view: a mark at its edge
        way = (pixel - inside) / np.linalg.norm(pixel - inside)
        side = np.array([-way[1], way[0]])
        tip = np.stack([inside + 9 * unit * way, inside + 5 * unit * side, inside - 5 * unit * side])
        cv2.fillPoly(image, [np.round(tip * 16.0).astype(np.int32)], _CHASER, cv2.LINE_AA, 4)
        return
    hidden = bool(_hidden(pixel, depth, buffer))
    radius = max(_SPHERE_RADIUS * view.scale, 3.6 * unit)
    nose = _rotate(attitude, (0.0, 0.0, 1.0))
    tip, _ = view.project(position + nose * 2.6 * radius / view.scale)
    at = lambda p: tuple(np.round(p * 16.0).astype(int).tolist())
    body = _faded(_CHASER, 0.35) if hidden else _CHASER
    cv2.circle(image, at(pixel), round(radius * 16), _faded(body, 0.75), -1, cv2.LINE_AA, 4)
    if not hidden:
        highlight = pixel + radius * np.array([-0.28, -0.3])
        cv2.circle(image, at(highlight), round(0.5 * radius * 16), body, -1, cv2.LINE_AA, 4)
    cv2.circle(image, at(pixel), round(radius * 16), colour, 1, cv2.LINE_AA, 4)
    cv2.arrowedLine(image, at(pixel), at(tip), colour, 2, cv2.LINE_AA, 4, 0.32)


def _zoom(position: np.ndarray, axes: Sequence, aspect: float, least: float) -> float:
    """The least zoom at which every view shows a position."""
    offset = position - _CENTRE
    sides = (abs(offset @ np.array(side)) / part for view in axes for side, part in zip(view, (aspect, 1.0)))
    reach = max(least, 1.1 * max(sides))
    return next((zoom for zoom in _ZOOMS if zoom >= reach), _ZOOMS[-1])


class Vehicle(NamedTuple):
    """A chaser to be drawn: (13,) true state, (T, 3) positions so far, its port, and the colours of port and path."""

    state: np.ndarray
    path: np.ndarray
    port: int
    port_colour: tuple[int, int, int] = _ACTIVE
    path_colour: tuple[int, int, int] = _PATH


def _compose(boxes, goals, vehicles: Sequence[Vehicle], size: tuple[int, int]) -> tuple[np.ndarray, _Scene]:
    """A frame but for its words, and the scene behind it. Raises ValueError as `draw_schematic` does."""
    boxes, goals = np.asarray(boxes, np.float64), np.asarray(goals, np.float64)
    vehicles = [v._replace(state=np.asarray(v.state, float), path=np.asarray(v.path, float)) for v in vehicles]
    if boxes.ndim != 3 or boxes.shape[1:] != (2, 3) or goals.shape[1:] != (7,):
        raise ValueError(f"boxes must have shape (N, 2, 3) and goals (P, 7); got {boxes.shape} and {goals.shape}")
    for state, path, port, *_ in vehicles:
        if state.shape != (VIEW_SIZE,) or path.reshape(-1, 3).shape != (len(path), 3):
            raise ValueError(f"state must have shape ({VIEW_SIZE},), path (T, 3); got {state.shape} and {path.shape}")
        if not 0 <= port < len(goals):
            raise ValueError(f"active_port must be from 0 to {len(goals) - 1}; got {port}")
    if size[0] < 160 or size[1] < 120:
        raise ValueError(f"size must be at least (160, 120) pixels; got {tuple(size)}")

    hull, size = np.ascontiguousarray(boxes).tobytes(), (int(size[0]), int(size[1]))
    main_zoom, inset_zoom = _ZOOMS[0], _ZOOMS[1]
    aspect = max(0.7 * size[0] / size[1], 1.2)
    drawn = [vehicle for vehicle in vehicles if np.isfinite(vehicle.state).all()]
    for vehicle in drawn:
        position = View.of(vehicle.state).position
        main_zoom = _zoom(position, (_ISOMETRIC,), aspect, main_zoom)
        inset_zoom = _zoom(position, (_TOP, _SIDE), _INSET[0] * size[0] / (_INSET[1] * size[1]), inset_zoom)
    scene = _scene(hull, size, main_zoom, inset_zoom)
    image = scene.image.copy()
    known = len(goals) == len(PORTS)
    held_out = [known and port.split == "held_out" for port in PORTS] + [False] * len(goals)
    active = {vehicle.port: vehicle.port_colour for vehicle in vehicles}
    for view, buffer in zip(scene.views, scene.depths):
        x, y, w, h = view.rectangle
        window = image[y : y + h, x : x + w]  # drawing stays inside the view
        local = view._replace(rectangle=(0, 0, w, h))
        main = view is scene.views[0]
        for number, goal in enumerate(goals):
            colour = active.get(number, _HELD_OUT if held_out[number] else _TRAIN)
            if number in active or main:
                _draw_port(window, goal, local, buffer, number in active, colour, scene.unit * (1.0 if main else 0.6))
        for vehicle in vehicles:
            path = vehicle.path.reshape(-1, 3)
            path = path[np.isfinite(path).all(axis=1)]
            path = path[np.unique(np.linspace(0, max(len(path) - 1, 0), 500).astype(int))] if len(path) > 500 else path
            _polyline(window, path, local, buffer, vehicle.path_colour, 2 if main else 1)
        for vehicle in drawn:
            _draw_chaser(window, vehicle.state, local, buffer, vehicle.path_colour, scene.unit)
    _legend(image, scene.unit)
    return image, scene


def _legend(image: np.ndarray, unit: float) -> None:
    import cv2

    for column, (label, colour) in enumerate((("train port", _TRAIN), ("held-out port", _HELD_OUT))):
        at = np.array([22 + 110 * column, 48]) * unit
        cv2.circle(image, tuple(np.round(at).astype(int).tolist()), max(round(3 * unit), 1), colour, 1, cv2.LINE_AA)
        _write(image, label, at + (9 * unit, 4 * unit), 0.38 * unit, _MUTED)


def draw_schematic(
    boxes: Float[np.ndarray, "N 2 3"],
    goals: Float[np.ndarray, "P 7"],
    state: Float[np.ndarray, "13"],
    path: Float[np.ndarray, "T 3"],
    active_port: int,
    text_lines: Sequence[str],
    size: tuple[int, int] = (960, 540),
) -> UInt8[np.ndarray, "H W 3"]:
    """Draw one frame: the station in three views, its ports, the chaser, its path and some numbers.

    Args:
        boxes: (N, 2, 3) lower and upper corners [m], station frame; boxes that aren't the station's are red.
        goals: (P, 7) goal positions [m] and attitudes q_bw (scalar first), station frame;
            eight of them are taken for `PORTS`.
        state: (13,) true position [m], velocity [m/s], q_bw, body rate [rad/s]; not drawn unless finite.
        path: (T, 3) positions so far [m], station frame; T may be 0.
        active_port: index of the assigned port in `goals`.
        text_lines: short lines for the panel at the right; two spaces or a number end a label.
        size: width and height of the picture in pixels.

    Returns:
        (H, W, 3) uint8, red first.

    Raises:
        ValueError: arrays of the wrong shape, a port out of range, or a picture under 160 by 120 pixels.
    """
    image, scene = _compose(boxes, goals, [Vehicle(state, path, active_port)], size)
    name = PORTS[active_port].name if len(goals) == len(PORTS) else f"port {active_port}"
    unit = scene.unit
    _write(image, name, (16 * unit, 28 * unit), 0.62 * unit, _ACTIVE)
    x, y, _, h = scene.panel
    for row, text in enumerate(text_lines):
        at = (x + 10 * unit, y + (20 + 17 * row) * unit)
        if at[1] < y + h - 4:
            label, *value = re.split(r"\s{2,}|\s(?=-?\d)", text, maxsplit=1)
            _write(image, label, at, 0.41 * unit, _MUTED if value else _TEXT)
            _write(image, "".join(value).strip(), (at[0] + 92 * unit, at[1]), 0.41 * unit, _TEXT)
    return image
