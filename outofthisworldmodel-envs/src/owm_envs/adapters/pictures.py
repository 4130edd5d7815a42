"""What `render()` gives: a schematic of the flight, or what a named camera sees; and what has to be kept for it."""

from collections.abc import Sequence

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, UInt8

from owm_envs.config import DockingConfig
from owm_envs.view import View
from owm_envs.words import short, unknown

RENDER_MODES = ("rgb_array",)
SIZE = (960, 540)
"""Width and height of a picture in pixels, if not given."""


def require_station(config: DockingConfig, mode: str | None) -> None:
    """Raise ValueError if pictures are asked for of another target than the station at rest."""
    if mode is not None and config.own_target:
        raise ValueError(f"render_mode={mode!r} draws the station at rest, and the target has settings of its own")


class Pictures:
    """Paths and forces of some vehicles, and the pictures of them; keeps nothing without a render mode.

    Args:
        mode: None or one of `RENDER_MODES`.
        width, height: pixels of a picture.
        camera_name: of `owm_envs.camera.views.CAMERA_NAMES`; None for the schematic.
        vehicles: how many there are.

    Raises:
        ValueError: an unknown mode or camera (naming the nearest), or a picture that is too small.
    """

    def __init__(self, mode: str | None, width: int, height: int, camera_name: str | None, vehicles: int):
        if mode is not None and mode not in RENDER_MODES:
            raise ValueError(unknown("render_mode", mode, RENDER_MODES))
        self.mode, self.size, self.camera_name = mode, (width, height), camera_name
        self.paths: list[list[np.ndarray]] = [[] for _ in range(vehicles)]
        self.forces = np.zeros((vehicles, 3))
        if camera_name is not None:
            from owm_envs.camera.views import CAMERA_NAMES

            if camera_name not in CAMERA_NAMES:
                raise ValueError(unknown("camera_name", camera_name, CAMERA_NAMES))
        least = (1, 1) if camera_name else (160, 120)
        for name, side in (("width", width), ("height", height)):
            if not isinstance(side, int | np.integer) or isinstance(side, bool) or side > 16_384:
                raise ValueError(f"{name} must be a whole number of pixels, at most 16384, got {short(side)}")
        if mode is not None and (width < least[0] or height < least[1]):
            raise ValueError(f"width and height must be at least {least[0]} and {least[1]}, got {width} and {height}")

    def begin(self, views: Float[np.ndarray, "B 13"], slots: Sequence[int]) -> None:
        """Start the paths of the slots that a new episode starts in."""
        if self.mode is not None:
            for slot in slots:
                self.paths[slot] = [View.of(views[slot]).position.copy()]
                self.forces[slot] = 0.0

    def extend(
        self,
        views: Float[np.ndarray, "B 13"],
        actions: Float[np.ndarray, "B 6"],
        limit: Float[np.ndarray, "6"],
        moved: Bool[np.ndarray, "B"],
    ) -> None:
        """Lengthen the paths of those that moved, and keep their forces in parts of the largest."""
        if self.mode is not None:
            for slot in np.flatnonzero(moved):
                self.paths[slot].append(View.of(views[slot]).position.copy())
                self.forces[slot] = np.clip(actions[slot, :3] / limit[:3], -1.0, 1.0)

    def drawn(
        self,
        groups: Sequence[Sequence[int]],
        views: Float[np.ndarray, "B 13"],
        ports: Sequence[int],
        notes: Sequence[str],
        titles: Sequence[str],
        rows: Sequence[Sequence[tuple[str, str]]],
        boxes: Float[np.ndarray, "N 2 3"],
    ) -> list[UInt8[np.ndarray, "H W 3"]]:
        """Give a picture of each group of slots, all in one compiled call.

        Args:
            groups: slots of the chasers that share a picture; a camera goes with the first.
            views, ports, notes: of each slot; `Vehicle` says what they are.
            titles, rows: of each group; `Drawing` says what they are.
            boxes: hull and obstacles [m], station frame.
        """
        from owm_envs.camera.schematic import Drawing, Vehicle, schematics, seen
        from owm_envs.camera.views import camera

        if self.camera_name is not None:
            width, height = self.size
            named = camera(self.camera_name, width=width, height=height)
            return list(seen(np.stack([views[list(group)] for group in groups]), named))
        vehicle = lambda slot: Vehicle(
            views[slot], np.asarray(self.paths[slot]), int(ports[slot]), self.forces[slot], notes[slot]
        )
        drawings = [Drawing([vehicle(slot) for slot in group], title, lines, boxes)
                    for group, title, lines in zip(groups, titles, rows)]  # fmt: skip
        return schematics(drawings, self.size)


def need_reset(state: object) -> None:
    """Raise Gymnasium's error if there is no state to draw yet."""
    if state is None:
        raise gymnasium.error.ResetNeeded("call reset() before render()")
