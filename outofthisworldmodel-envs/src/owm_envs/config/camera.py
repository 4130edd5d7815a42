"""What the camera of an environment with pixels is: size and channels are static, the rest are numbers to sweep."""

import math
from typing import Annotated, Literal, NamedTuple, get_args

from pydantic import Field, field_validator

from owm_envs.config.parts import Coordinate, Frozen, HalfTurn, Offset, Stops, unit, within
from owm_envs.station.ports import PORTS, port_index
from owm_envs.words import unknown

CameraName = Literal["chaser_fpv", "chaser_isometric", "chaser_top", "station_isometric", "station_top", "station_fpv"]
CAMERA_NAMES: tuple[str, ...] = get_args(CameraName)
Channels = Literal["rgb", "gray", "depth", "part", "port"]
CHANNELS: tuple[str, ...] = get_args(Channels)

Pixels = Annotated[int, Field(ge=1, le=4096), unit("px")]
Probability = Annotated[float, within(0, 1), unit("1")]
Noise = Annotated[float, within(0, 10), unit("1")]
Brightness = Annotated[float, within(0, 1e4), unit("1")]
Pose = tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]


class EffectsConfig(Frozen):
    """What goes wrong in a frame, drawn anew for each; all zero for a perfect camera, which then costs nothing.

    Errors are total root-mean-square sizes. Noise counts in the light of the display, where white is 1.
    """

    position: Annotated[Offset, unit("m")] = 0.0
    attitude_deg: HalfTurn = 0.0
    field: Probability = 0.0
    """Of the field of view, as a fraction of it."""
    exposure: Annotated[float, within(0, 30), unit("stops")] = 0.0
    blur: Annotated[float, within(0, 3), unit("px")] = 0.0
    """Standard deviation of a Gaussian; not drawn."""
    shot_noise: Noise = 0.0
    """Standard deviation at white; it grows as the root of the light."""
    read_noise: Noise = 0.0
    """Standard deviation in the dark."""
    frozen: Probability = 0.0
    """That a frame does not come: the last one is held. The first of an episode always comes."""
    blocked: Probability = 0.0
    """That a frame comes black."""

    @property
    def active(self) -> bool:
        """Whether there is any."""
        return self != EffectsConfig()


class CameraStructure(NamedTuple):
    """All of a camera that compiled programs depend on."""

    view: str
    height: int
    width: int
    channels: str
    every: int
    samples: int
    visitors: int
    sky: bool
    effects: bool


class CameraConfig(Frozen):
    """The camera of an environment whose observation has pixels."""

    view: CameraName = "chaser_fpv"
    height: Pixels = 64
    width: Pixels = 64
    channels: Channels = "rgb"
    """rgb and gray are uint8; depth is float32 in metres, 0 where no part is; part and port are int32, -1 for none."""
    every: Annotated[int, Field(ge=1, le=10**9), unit("decisions")] = 1
    """Decisions from one frame to the next; the last one is held between."""
    samples: Annotated[int, Field(ge=1, le=8), unit("rays")] = 1
    """Rays along each side of a pixel."""
    port: str = PORTS[0].name
    """At which `station_fpv` stands."""
    field_deg: Annotated[Annotated[float, within(0.01, 175)] | None, unit("deg")] = None
    """Vertical field of view; the view's own if absent."""
    position: Annotated[tuple[Coordinate, Coordinate, Coordinate] | None, unit("m")] = None
    """Of the camera in its mount's frame; the view's own if absent."""
    exposure: Stops = 0.0
    sun: Brightness = 1.0
    """Brightness of the Sun, of its true one."""
    lamp: Brightness = 0.5
    """Brightness of a white plane 10 m before the camera's lamp, of one in sunlight."""
    visitors: Annotated[tuple[str | Pose, ...], unit("m")] = ()
    """Other Dragons: the name of the port where one holds, or position [m] and attitude (body to station)."""
    sky: bool = True
    """Whether Earth, Sun, Moon and stars stand behind the station; else it is black there."""
    earth_map: str | None = None
    """File of an equirectangular image of the Earth by day in place of the packaged one."""
    cloud_map: str | None = None
    night_map: str | None = None
    """Likewise, grey: opacity of clouds, and lights by night."""
    effects: EffectsConfig = EffectsConfig()

    @field_validator("view", "channels", mode="before")
    @classmethod
    def _known(cls, value, info):
        known = {"view": CAMERA_NAMES, "channels": CHANNELS}[info.field_name]
        if value not in known:
            raise ValueError(unknown({"view": "camera"}.get(info.field_name, info.field_name), value, known))
        return value

    @field_validator("port", "visitors")
    @classmethod
    def _known_ports(cls, value):
        for each in [value] if isinstance(value, str) else value:
            if isinstance(each, str):
                port_index(each)
            elif not 1e-3 <= math.hypot(*each[3:]) <= 1e3:  # it is brought to length 1
                raise ValueError(f"a visitor's attitude must be a quaternion of length 1, got {each[3:]}")
        return value

    @property
    def structure(self) -> CameraStructure:
        """What the compiled programs depend on."""
        return CameraStructure(
            self.view,
            self.height,
            self.width,
            self.channels,
            self.every,
            self.samples,
            len(self.visitors),
            self.sky,
            self.effects.active,
        )
