"""The camera as a sensor of the environment: frames as one more part of the observation."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, Shaped

from owm_envs.camera.effects import (
    Effects,
    Look,
    Ranges,
    draw_look,
    effects_from,
    happens,
    looking,
    ranges_from,
    shaken,
    spoiled,
)
from owm_envs.camera.lens import Camera
from owm_envs.camera.light import heavens
from owm_envs.camera.render import render
from owm_envs.camera.scene import Scene, Visitors, default_scene
from owm_envs.camera.sky import load_sky
from owm_envs.camera.views import camera
from owm_envs.config.camera import CameraConfig
from owm_envs.config.parts import CameraRanges
from owm_envs.station.ports import PORTS, docked_attitude, port_index
from owm_envs.task.sensors import Measurement, Truth

PIXELS = "pixels"
_DTYPES = {"rgb": "uint8", "gray": "uint8", "depth": "float32", "part": "int32", "port": "int32"}
_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Of sRGB's red, green and blue. Source: IEC 61966-2-1."""
_CONFIG, _NOTHING_DRAWN = CameraConfig(), CameraRanges()
_NOSE = 2.1
"""From the middle of a Dragon to its hatch [m]."""


class CameraParams(NamedTuple):
    """The numbers behind a camera's frames, `params.sensors["pixels"]`: each may be swept, drawn or vmapped."""

    scene: Scene
    """Its heavens are those of the instant when a frame is taken."""
    camera: Camera
    effects: Effects | None
    """None without any."""
    ranges: Ranges | None
    """None if nothing is drawn."""


@dataclass(frozen=True, eq=False)
class CameraSensor:
    """A camera: frames (H, W, C) as `CameraConfig.channels` says.

    Cameras of one name and structure are equal, and share compiled programs: what else they are configured to is in
    their numbers alone.
    """

    config: CameraConfig = _CONFIG
    ranges: CameraRanges = _NOTHING_DRAWN
    """What is drawn for each episode."""
    name: str = PIXELS
    costly: ClassVar[bool] = True
    needs_orbit: ClassVar[bool] = True

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other._key == self._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self):
        return self.name, self.config.structure, self.ranges.active

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels."""
        return self.config.height, self.config.width, 3 if self.config.channels == "rgb" else 1

    @property
    def dtype(self) -> str:
        """Of a frame."""
        return _DTYPES[self.config.channels]

    @property
    def every(self) -> int:
        """Decisions from one frame to the next."""
        return self.config.every

    @property
    def may_miss(self) -> bool:
        """Whether frames may freeze."""
        return self.config.effects.active

    def default_params(self) -> CameraParams:
        """Give the scene, the camera and the sizes of its errors as arrays."""
        config = self.config
        sky = load_sky(config.earth_map, config.cloud_map, config.night_map) if config.sky else None
        scene = default_scene(len(config.visitors), sky)
        light = scene.light._replace(
            sun=scene.light.sun * jnp.asarray(config.sun, jnp.float32), lamp=jnp.asarray(config.lamp, jnp.float32)
        )
        scene = scene._replace(light=light, visitors=_visitors(config))
        changes: dict[str, Any] = {"exposure": config.exposure, "samples": config.samples}
        if config.field_deg is not None:
            changes["field"] = np.radians(config.field_deg)
        if config.position is not None:
            changes["position"] = config.position
        changes["outputs"] = ("rgb" if config.channels == "gray" else config.channels,)
        lens = camera(config.view, height=config.height, width=config.width, port=config.port, **changes)
        return CameraParams(
            scene,
            lens,
            effects_from(config.effects) if config.effects.active else None,
            ranges_from(self.ranges) if self.ranges.active else None,
        )

    def draw(self, own: CameraParams, key: Key[Array, ""]) -> Look | None:
        """Draw the light and look of an episode; None if nothing is left to it."""
        if own.ranges is None:
            return None
        return draw_look(own.ranges, own.scene.materials.colour.shape[0], key=key)

    def measure(self, key: Key[Array, ""], truth: Truth) -> Shaped[Array, "H W C"] | Measurement:
        """Take a frame."""
        own: CameraParams = truth.params.sensors[self.name]
        scene = own.scene._replace(heavens=heavens(truth.epoch, truth.orbit[:3], truth.orbit[3:]))
        lens = own.camera
        if truth.drawn is not None:
            scene, lens = looking(scene, lens, truth.drawn)
        if own.effects is not None:
            lens = shaken(lens, own.effects, key=key)
        channels = self.config.channels
        picture = render(scene, truth.view, lens)["rgb" if channels == "gray" else channels]
        if channels == "depth":
            picture = jnp.where(jnp.isfinite(picture), picture, 0.0)
        if channels == "gray":
            luma = (picture.astype(jnp.float32) * _LUMA[None, None, :]).sum(axis=-1)
            picture = jnp.round(luma).astype(jnp.uint8)
        picture = picture.reshape(self.shape)
        if own.effects is None:
            return picture
        if self.dtype == "uint8":
            picture = spoiled(picture, own.effects, key=key)
        frozen = happens(own.effects.frozen, "frozen", key=key) & (truth.count > 0)
        return Measurement(picture, ~frozen)


def _visitors(config: CameraConfig) -> Visitors:
    """The configured visitors: at a port with the hatch on its interface, or anywhere."""
    poses = []
    for visitor in config.visitors:
        if isinstance(visitor, str):
            port = PORTS[port_index(visitor)]
            place = np.asarray(port.interface) + _NOSE * np.asarray(port.normal)
            visitor = (*place, *docked_attitude(port.normal))
        poses.append(visitor)
    poses = np.asarray(poses, np.float64).reshape(-1, 7)
    turns = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    number = lambda values: jnp.asarray(values, jnp.float32)
    return Visitors(number(poses[:, :3]), number(turns), jnp.ones(len(poses), bool))
