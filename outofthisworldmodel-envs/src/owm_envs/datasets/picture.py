"""A picture of recorded flights around the station, for the card: lines only, drawn in a moment."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

SIZE = (960, 600)
"""Pixels, width and height."""
_FROM = (-0.5, -0.72, 0.48)
"""Where the viewer is, seen from the station."""


class Path(NamedTuple):
    """Where a flight went."""

    positions: Float[np.ndarray, "T 3"]
    """m, station frame."""
    port: int


def flights_picture(paths: Sequence[Path]) -> bytes:
    """Draw the station's boxes and ports, and flights, each in its port's colour; as a PNG."""
    import cv2

    from owm_envs.camera import overlay
    from owm_envs.camera.lens import Pose
    from owm_envs.camera.overlay import Sheet
    from owm_envs.camera.schematic import COLOURS
    from owm_envs.camera.views import ZENITH, aimed, camera
    from owm_envs.station import PORT_NAMES, hull_boxes

    way = -np.asarray(_FROM) / np.linalg.norm(_FROM)
    right = np.cross(way, ZENITH) / np.linalg.norm(np.cross(way, ZENITH))
    axes = np.stack([right, np.cross(right, way), way], axis=1)
    boxes = hull_boxes()
    seen = np.concatenate([boxes.reshape(-1, 3), *(path.positions for path in paths)]) @ axes[:, :2]
    middle, extent = axes[:, :2] @ (seen.min(axis=0) + seen.max(axis=0)) / 2, np.ptp(seen, axis=0)
    width, height = SIZE
    stand = dataclasses.replace(
        camera("station_top", width=width, height=height),
        position=middle - 1000.0 * way,
        attitude=aimed((0.0, 0.0, 0.0), tuple(way)),
        field=1.08 * max(extent[1], extent[0] * height / width),
    )
    image = np.empty((height, width, 3), np.uint8)
    image[:] = overlay.BACKGROUND
    sheet = Sheet(image, np.full((height, width), np.inf), stand, Pose(stand.position, axes))
    overlay.boxes(sheet, boxes, overlay.MUTED, strength=0.35)
    colours = {path.port: COLOURS[path.port % len(COLOURS)] for path in paths}
    for path in paths:
        overlay.curve(sheet, path.positions[:: max(1, len(path.positions) // 400)], colours[path.port], strength=0.8)
    overlay.ports(sheet, colours)
    for row, (port, colour) in enumerate(sorted(colours.items())):
        overlay.write(image, PORT_NAMES[port], (16, 28 + 20 * row), 0.46, colour)
    overlay.compass(sheet)
    overlay.scale_bar(sheet)
    return cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
