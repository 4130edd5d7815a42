"""The station as a picture: its parts shaded, the collision boxes, the ports and their corridors.

One orthographic ray a pixel is cast at every part, exactly; the same cast from the Sun gives the shadows.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from owm_envs.station.geometry import ROUND, bounds, rotation
from owm_envs.station.hull import hull_boxes
from owm_envs.station.parts import PARTS
from owm_envs.station.ports import PORTS, goal_poses
from owm_envs.station.primitives import MATERIALS, Part

_SUN = np.array([-0.66, -0.56, 0.50])
_FROM = np.array([-0.50, -0.70, 0.42])  # the viewer
_CENTRE = np.array([0.0, 0.0, 1.0])
_BACKGROUND = np.array([[20.0, 26.0, 44.0], [7.0, 9.0, 17.0]])  # top and bottom
_BOX = (255, 92, 80)
_SPLIT = {"train": (92, 170, 255), "held_out": (255, 176, 72)}
_TEXT = (222, 228, 240)
_FINE = 2  # rays a pixel along each side


class _Camera(NamedTuple):
    right: np.ndarray
    up: np.ndarray
    back: np.ndarray
    scale: float  # pixels a metre
    size: tuple[int, int]  # width, height

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and depth (...) [m], greater being nearer to the viewer."""
        offset = np.asarray(points, np.float64) - _CENTRE
        u = 0.5 * self.size[0] + self.scale * (offset @ self.right)
        v = 0.5 * self.size[1] - self.scale * (offset @ self.up)
        return np.stack([u, v], axis=-1), offset @ self.back


def _camera(towards_viewer: np.ndarray, scale: float, size: tuple[int, int]) -> _Camera:
    back = towards_viewer / np.linalg.norm(towards_viewer)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    return _Camera(right, np.cross(back, right), back, scale, size)


class _Image(NamedTuple):
    depth: np.ndarray  # (H, W), -inf where nothing is
    normal: np.ndarray  # (H, W, 3)
    owner: np.ndarray  # (H, W), index of the part
    local: np.ndarray  # (H, W, 3), place in the part's frame


def _hit(part: Part, start: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays leave a part towards the viewer: distance along `way` (-inf for a miss) and local normal."""
    size = np.asarray(part.dimensions, np.float64)
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    with np.errstate(all="ignore"):
        if part.primitive not in (*ROUND, "sphere"):
            first, second = (-0.5 * size - start) / way, (0.5 * size - start) / way
            leave, enter = np.maximum(first, second), np.minimum(first, second)
            far = leave.min(axis=-1)
            axis = leave.argmin(axis=-1)
            return np.where(enter.max(axis=-1) <= far, far, -np.inf), np.eye(3)[axis] * np.sign(way)
        if part.primitive == "sphere":
            b, c = start @ way, (start * start).sum(axis=-1) - 0.25 * size[0] ** 2
            far = -b + np.sqrt(b * b - c)
            return np.where(b * b >= c, far, -np.inf), (start + far[..., None] * way) / (0.5 * size[0])
        r0, r1, half = 0.5 * size
        slope, middle = (r1 - r0) / size[2], 0.5 * (r0 + r1)
        a = way[0] ** 2 + way[1] ** 2 - (slope * way[2]) ** 2
        a = a if abs(a) > 1e-12 else 1e-12
        radius = middle + slope * start[..., 2]
        b = start[..., 0] * way[0] + start[..., 1] * way[1] - slope * radius * way[2]
        c = start[..., 0] ** 2 + start[..., 1] ** 2 - radius**2
        root = np.sqrt(b * b - a * c)
        best, normal = np.full(start.shape[:-1], -np.inf), np.zeros(start.shape)
        for t in ((-b + root) / a, (-b - root) / a):
            place = start + t[..., None] * way
            good = (np.abs(place[..., 2]) <= half) & (middle + slope * place[..., 2] >= 0.0) & (t > best)
            outward = place * (1.0, 1.0, 0.0)
            outward = outward / np.linalg.norm(outward, axis=-1, keepdims=True) - (0.0, 0.0, slope)
            best, normal = np.where(good, t, best), np.where(good[..., None], outward, normal)
        for end, r in ((-half, r0), (half, r1)):
            t = (end - start[..., 2]) / way[2]
            place = start + t[..., None] * way
            good = (place[..., 0] ** 2 + place[..., 1] ** 2 <= r * r) & (t > best)
            best = np.where(good, t, best)
            normal = np.where(good[..., None], (0.0, 0.0, np.sign(end)), normal)
        return best, normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


def _cast(parts: tuple[Part, ...], camera: _Camera) -> _Image:
    width, height = camera.size
    image = _Image(
        np.full((height, width), -np.inf, np.float32),
        np.zeros((height, width, 3), np.float32),
        np.full((height, width), -1, np.int16),
        np.zeros((height, width, 3), np.float32),
    )
    for number, part in enumerate(parts):
        corners = np.stack(np.meshgrid(*bounds(part).T, indexing="ij"), axis=-1).reshape(8, 3)
        pixels, _ = camera.project(corners)
        u0, v0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
        u1, v1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, (width, height))
        if u0 >= u1 or v0 >= v1:
            continue
        u = (np.arange(u0, u1) + 0.5 - 0.5 * width) / camera.scale
        v = (0.5 * height - np.arange(v0, v1) - 0.5) / camera.scale
        turn = rotation(part)
        origin = (_CENTRE - np.asarray(part.position)) @ turn
        start = origin + u[None, :, None] * (camera.right @ turn) + v[:, None, None] * (camera.up @ turn)
        way = camera.back @ turn
        depth, normal = _hit(part, start, way)
        window = (slice(v0, v1), slice(u0, u1))
        seen = depth > image.depth[window]
        image.depth[window][seen] = depth[seen]
        image.normal[window][seen] = normal[seen] @ turn.T
        image.owner[window][seen] = number
        image.local[window][seen] = start[seen] + depth[seen, None] * way
    return image


def _texture(parts: tuple[Part, ...], image: _Image) -> np.ndarray:
    """Linear base colour of every pixel with a part: its material's, with seams where panels fold and shields join."""
    names = list(MATERIALS)
    palette = np.array([MATERIALS[part.material].colour for part in parts]) ** 2.2
    kinds = np.array([names.index(part.material) for part in parts])
    seen = np.isfinite(image.depth)
    colour, kind = palette[image.owner[seen]], kinds[image.owner[seen]]
    x, z = image.local[seen][:, 0], image.local[seen][:, 2]
    for material, across, along, wide, tone in (
        ("array", 2.1, 1.05, 0.09, 0.52),
        ("array_blue", 0.85, 0.85, 0.07, 2.2),
        ("radiator", 100.0, 2.9, 0.10, 0.62),
        ("shield", 100.0, 1.55, 0.07, 0.72),
        ("russian", 100.0, 1.9, 0.07, 0.75),
    ):
        seam = (np.abs((z / along) % 1.0 - 0.5) * along < 0.5 * wide) | (
            np.abs((x / across) % 1.0 - 0.5) * across < 0.5 * wide
        )
        colour[(kind == names.index(material)) & seam] *= tone
    return colour


def _shade(parts: tuple[Part, ...], camera: _Camera) -> tuple[np.ndarray, np.ndarray]:
    """Linear colour (H, W, 3) and depth (H, W) of the parts."""
    import cv2

    image = _cast(parts, camera)
    colour = _texture(parts, image)
    seen = np.isfinite(image.depth)
    sun = _SUN / np.linalg.norm(_SUN)
    light = _camera(sun, 12.0, (1500, 1350))
    shadow = _cast(parts, light).depth
    v, u = np.nonzero(seen)
    width, height = camera.size
    places = (
        _CENTRE
        + ((u + 0.5 - 0.5 * width) / camera.scale)[:, None] * camera.right
        + ((0.5 * height - v - 0.5) / camera.scale)[:, None] * camera.up
        + image.depth[seen][:, None] * camera.back
    )
    at, depth = light.project(places + 0.12 * image.normal[seen])
    column, row = (np.clip(at[:, i], 0.5, n - 1.5) for i, n in enumerate(light.size))
    lit = sum(shadow[(row + dv).astype(int), (column + du).astype(int)] < depth + 0.15
              for du, dv in ((-0.4, -0.2), (0.4, 0.2), (0.2, -0.4), (-0.2, 0.4))) / 4.0  # fmt: skip
    facing = np.maximum(image.normal[seen] @ sun, 0.0)
    half = (sun + camera.back) / np.linalg.norm(sun + camera.back)
    gloss = np.array([1.0 - MATERIALS[part.material].roughness for part in parts])[image.owner[seen]]
    shine = gloss * np.maximum(image.normal[seen] @ half, 0.0) ** 24
    zenith, view = image.normal[seen][:, 2], np.maximum(image.normal[seen] @ camera.back, 0.0)
    sky = 0.17 + 0.07 * zenith + 0.10 * view
    # What neighbours in front of a place hide of the sky, at two sizes.
    flat = np.where(seen, image.depth, np.nanmin(np.where(seen, image.depth, np.nan)))
    hidden = np.zeros(len(u))
    for metres in (0.6, 2.5):
        blurred = cv2.GaussianBlur(flat, (0, 0), metres * camera.scale)
        hidden += 0.5 * np.clip((blurred - flat)[seen] / metres, 0.0, 1.0)
    result = np.zeros((height, width, 3))
    result[seen] = colour * (sky * (1.0 - 0.75 * hidden) + 0.95 * facing * lit)[:, None]
    result[seen] += (0.35 * shine * lit)[:, None]
    return result, image.depth


def _line(canvas, camera: _Camera, depth: np.ndarray, ends: np.ndarray, colour, alpha: float, width: int = 1) -> None:
    """A straight line, its hidden stretches left out."""
    import cv2

    count = max(int(np.linalg.norm(np.diff(camera.project(ends)[0], axis=0)) / 3.0), 2)
    points = ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])
    pixels, near = camera.project(points)
    column, row = (np.clip(pixels[:, i].astype(int), 0, n - 1) for i, n in enumerate(camera.size))
    visible = depth[row, column] < near + 0.35
    fixed = np.round(pixels * 16.0).astype(np.int32)
    for a, b, both in zip(fixed[:-1], fixed[1:], visible[:-1] & visible[1:]):
        if both:
            cv2.line(canvas, a.tolist(), b.tolist(), (*colour, round(255 * alpha)), width, cv2.LINE_AA, 4)


def _box_edges(boxes: np.ndarray) -> np.ndarray:
    """The twelve edges of every box, (12 N, 2, 3), those inside another box left out."""
    edges = []
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        for a in (0, 1):
            for b in (0, 1):
                edge = np.empty((len(boxes), 2, 3))
                edge[:, :, axis] = boxes[:, :, axis]
                edge[:, :, others[0]] = boxes[:, a, others[0], None]
                edge[:, :, others[1]] = boxes[:, b, others[1], None]
                edges.append(edge)
    edges = np.concatenate(edges)
    middle = edges.mean(axis=1)
    inside = np.zeros(len(edges), bool)
    for lower, upper in boxes:
        inside |= np.all((middle > lower + 1e-3) & (middle < upper - 1e-3), axis=1)
    return edges[~inside]


# Where a port's name stands: metres along the corridor, and pixels to the side (negative: to the left of it).
_LABELS = {
    "harmony_forward": (13.0, 8),
    "harmony_zenith": (26.0, 8),
    "harmony_nadir": (18.0, 8),
    "zvezda_aft": (13.0, -8),
    "poisk_zenith": (26.0, 8),
    "pirs_nadir": (21.0, -8),
    "rassvet_nadir": (31.0, -8),
    "unity_nadir": (25.0, 8),
}


def draw_station(
    size: tuple[int, int] = (1600, 1000),
    boxes: Float[np.ndarray, "N 2 3"] | None = None,
    parts: tuple[Part, ...] = PARTS,
) -> UInt8[np.ndarray, "H W 3"]:
    """Draw the station from forward, starboard and zenith, with its collision boxes, ports and corridors.

    Args:
        size: width and height of the picture in pixels.
        boxes: (N, 2, 3) boxes to outline [m], station frame; the station's own hull if not given.
        parts: the table to draw.

    Returns:
        (H, W, 3) uint8, red first.

    Raises:
        ValueError: a picture under 320 by 200 pixels.
    """
    import cv2

    if size[0] < 320 or size[1] < 200:
        raise ValueError(f"size must be at least (320, 200) pixels; got {tuple(size)}")
    boxes = hull_boxes() if boxes is None else boxes
    width, height = size
    unit = min(width / 1600.0, height / 1000.0)
    camera = _camera(_FROM, 9.7 * unit, size)
    fine = camera._replace(scale=_FINE * camera.scale, size=(_FINE * width, _FINE * height))
    colour, depth = _shade(parts, fine)
    seen = np.isfinite(depth).astype(np.float32)
    shown = np.clip(colour, 0.0, 1.0).astype(np.float32)
    shown = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
    cover = cv2.resize(seen, size, interpolation=cv2.INTER_AREA)[..., None]
    rows = np.linspace(0.0, 1.0, height)[:, None, None]
    backdrop = (1.0 - rows) * _BACKGROUND[0] + rows * _BACKGROUND[1]
    shown = np.where(cover > 0.0, (shown / np.maximum(cover, 1e-6)) ** (1.0 / 2.2) * 255.0, 0.0)
    canvas = shown * cover + backdrop * (1.0 - cover)
    coarse = depth[_FINE // 2 :: _FINE, _FINE // 2 :: _FINE]

    layer = np.zeros((height, width, 4), np.uint8)
    for ends in _box_edges(boxes):
        _line(layer, camera, coarse, ends, _BOX, 0.42)
    alpha = layer[..., 3:] / 255.0
    canvas = canvas * (1.0 - alpha) + layer[..., :3] * alpha
    canvas = np.ascontiguousarray(canvas.clip(0.0, 255.0).astype(np.uint8))

    def write(
        text: str, at: tuple[float, float], scale: float, tone: tuple, right: bool = False, plate: bool = False
    ) -> None:
        font, thick = cv2.FONT_HERSHEY_SIMPLEX, max(round(unit), 1)
        (wide, high), _ = cv2.getTextSize(text, font, scale * unit, thick)
        place = (round(at[0] - wide * right), round(at[1]))
        if plate:  # the text stands out against whatever is behind
            x, y, pad = place[0], place[1], round(5 * unit)
            window = canvas[max(y - high - pad, 0) : y + pad, max(x - pad, 0) : x + wide + pad]
            window[:] = (0.3 * window + 0.7 * _BACKGROUND[1]).astype(np.uint8)
        cv2.putText(canvas, text, place, font, scale * unit, tone, thick, cv2.LINE_AA)

    fixed = lambda pixel: tuple(np.round(np.asarray(pixel) * 16.0).astype(int).tolist())
    stroke = max(round(2 * unit), 2)
    for port, goal in zip(PORTS, goal_poses()):
        tone, normal = _SPLIT[port.split], np.asarray(port.normal)
        length, side = _LABELS[port.name]
        mating, hold = np.asarray(port.interface), goal[:3]
        (start, centre, end), _ = camera.project(np.stack([mating, hold, hold + length * normal]))
        cv2.arrowedLine(
            canvas, fixed(end), fixed(centre), tone, stroke, cv2.LINE_AA, 4, 7.0 * unit / np.linalg.norm(end - centre)
        )
        cv2.line(canvas, fixed(centre), fixed(start), tone, 1, cv2.LINE_AA, 4)
        cv2.circle(canvas, fixed(centre), round(2.25 * camera.scale * 16), tone, stroke, cv2.LINE_AA, 4)
        cv2.circle(canvas, fixed(start), round(3.5 * unit * 16), tone, -1, cv2.LINE_AA, 4)
        write(port.name, (end[0] + side * unit, end[1] + 5 * unit), 0.52, tone, side < 0, True)
    _legend(canvas, camera, unit, len(boxes), write)
    return canvas


def _legend(canvas: np.ndarray, camera: _Camera, unit: float, boxes: int, write) -> None:
    import cv2

    height = canvas.shape[0]
    for row, (text, tone) in enumerate(
        (("train port", _SPLIT["train"]), ("held-out port", _SPLIT["held_out"]), (f"{boxes} collision boxes", _BOX))
    ):
        at = (round(30 * unit), round((34 + 28 * row) * unit))
        if row < 2:
            cv2.circle(canvas, at, round(7 * unit), tone, max(round(2 * unit), 1), cv2.LINE_AA)
        else:
            half = round(7 * unit)
            cv2.rectangle(canvas, (at[0] - half, at[1] - half), (at[0] + half, at[1] + half), tone, 1, cv2.LINE_AA)
        write(text, (at[0] + 18 * unit, at[1] + 6 * unit), 0.52, _TEXT)
    root = np.array([80 * unit, height - 90 * unit])
    for label, axis in (("forward", (0, -1, 0)), ("port", (1, 0, 0)), ("zenith", (0, 0, 1))):
        way = np.array([np.dot(axis, camera.right), -np.dot(axis, camera.up)])
        tip = root + 46 * unit * way
        ends = [tuple(np.round(p).astype(int).tolist()) for p in (root, tip)]
        cv2.arrowedLine(canvas, *ends, _TEXT, max(round(unit), 1), cv2.LINE_AA, 0, 0.18)
        write(label, tip + 14 * unit * way + (-20 * unit, 5 * unit), 0.42, _TEXT)
    length = 20.0 * camera.scale
    x, y = canvas.shape[1] - 40 * unit - length, height - 36 * unit
    cv2.line(canvas, (round(x), round(y)), (round(x + length), round(y)), _TEXT, max(round(2 * unit), 1), cv2.LINE_AA)
    write("20 m", (x + 0.5 * length - 18 * unit, y - 10 * unit), 0.48, _TEXT)
