"""The schematic with several chasers, each in a colour of its own."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from owm_envs.render.schematic import _MUTED, _TEXT, Vehicle, _compose, _write
from owm_envs.station import PORTS

COLOURS = (
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


def draw_fleet(
    boxes: Float[np.ndarray, "N 2 3"],
    goals: Float[np.ndarray, "8 7"],
    states: Float[np.ndarray, "V 13"],
    paths: Sequence[Float[np.ndarray, "T 3"]],
    ports: Sequence[int],
    notes: Sequence[str],
    title: str,
    size: tuple[int, int] = (960, 540),
) -> UInt8[np.ndarray, "H W 3"]:
    """Draw one frame: the station in three views, and every chaser with its path, its port and a note.

    Args:
        boxes, goals, size: as for `draw_schematic`.
        states: (V, 13) true states, as there; one that is not finite is not drawn.
        paths: V arrays (T, 3) of positions so far [m], station frame.
        ports: the port of each chaser, an index into `PORTS`.
        notes: a few words on each chaser for the panel at the right.
        title: one line above.

    Returns:
        (H, W, 3) uint8, red first.

    Raises:
        ValueError: as `draw_schematic`.
    """
    colours = [COLOURS[index % len(COLOURS)] for index in range(len(states))]
    vehicles = [Vehicle(*parts, colour, colour) for *parts, colour in zip(states, paths, ports, colours)]
    image, scene = _compose(boxes, goals, vehicles, size)
    unit = scene.unit
    _write(image, title, (16 * unit, 28 * unit), 0.5 * unit, _TEXT)
    x, y, _, h = scene.panel
    row_height = min(30.0, (h / unit - 10) / len(vehicles))
    for row, (vehicle, note) in enumerate(zip(vehicles, notes)):
        at = np.array([x + 10 * unit, y + (20 + row_height * row) * unit])
        _write(image, f"{row}  {PORTS[vehicle.port].name}", at, 0.41 * unit, vehicle.path_colour)
        _write(image, note, at + (168 * unit, 0), 0.38 * unit, _MUTED if note[0].isdigit() else _TEXT)
    return image
