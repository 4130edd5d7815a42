"""What goes wrong between the scene and a frame: numbers, all traced; a camera without effects runs none of this."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, Shaped, UInt8

from astrojax.attitude import quat_from_rotation_vector, quat_multiply
from owm_envs.camera.lens import Camera
from owm_envs.camera.scene import Scene
from owm_envs.camera.shade import encoded
from owm_envs.camera.surface import linear
from owm_envs.config.camera import EffectsConfig
from owm_envs.config.parts import CameraRanges
from owm_envs.task.reset import isotropic, named_key

_REACH = 9  # pixels to each side that a blur looks at: three of its widest standard deviations


class Effects(NamedTuple):
    """Sizes of errors as in `EffectsConfig`, angles in rad."""

    position: Float[Array, ""]
    attitude: Float[Array, ""]
    field: Float[Array, ""]
    exposure: Float[Array, ""]
    blur: Float[Array, ""]
    shot_noise: Float[Array, ""]
    read_noise: Float[Array, ""]
    frozen: Float[Array, ""]
    blocked: Float[Array, ""]


class Ranges(NamedTuple):
    """Ranges (low, high) of an episode's draws, as in `CameraRanges`."""

    sun_scale: Float[Array, "2"]
    earthshine_scale: Float[Array, "2"]
    lamp_scale: Float[Array, "2"]
    exposure: Float[Array, "2"]
    offset: Float[Array, "2"]
    tilt: Float[Array, "2"]
    """rad."""
    field_scale: Float[Array, "2"]
    albedo_scale: Float[Array, "2"]


class Look(NamedTuple):
    """What was drawn for an episode: factors, but for the following."""

    sun_scale: Float[Array, ""]
    earthshine_scale: Float[Array, ""]
    lamp_scale: Float[Array, ""]
    exposure: Float[Array, ""]
    """Stops, added."""
    offset: Float[Array, "3"]
    """m, in the frame of the camera's mount."""
    tilt: Float[Array, "3"]
    """Rotation vector in the camera's frame, rad."""
    field_scale: Float[Array, ""]
    albedo_scale: Float[Array, "M"]
    """Per material."""


def effects_from(config: EffectsConfig) -> Effects:
    """Lay the configured sizes out as float32 arrays."""
    values = dict(config)
    values["attitude"] = np.radians(values.pop("attitude_deg"))
    return Effects(**{name: jnp.asarray(value, jnp.float32) for name, value in values.items()})


def ranges_from(config: CameraRanges) -> Ranges:
    """Lay the configured ranges out as float32 arrays."""
    values = dict(config)
    values["tilt"] = np.radians(values.pop("tilt_deg"))
    return Ranges(**{name: jnp.asarray(value, jnp.float32) for name, value in values.items()})


def draw_look(ranges: Ranges, materials: int, *, key: Key[Array, ""]) -> Look:
    """Draw an episode's light and look, uniformly within `ranges`, each under a key of its own."""

    def uniform(name, shape=()):
        low, high = getattr(ranges, name)
        return jax.random.uniform(named_key(key, name), shape, jnp.float32, low, high)

    def vector(name):
        return uniform(name) * isotropic(named_key(key, f"{name} direction"), jnp.float32)

    own = {"offset": vector("offset"), "tilt": vector("tilt"), "albedo_scale": uniform("albedo_scale", (materials,))}
    return Look(**{name: own[name] if name in own else uniform(name) for name in Look._fields})


def looking(scene: Scene, camera: Camera, look: Look) -> tuple[Scene, Camera]:
    """Give scene and camera as they are in an episode."""
    light, materials = scene.light, scene.materials
    light = light._replace(
        sun=light.sun * look.sun_scale, earth=light.earth * look.earthshine_scale, lamp=light.lamp * look.lamp_scale
    )
    colour = jnp.clip(materials.colour * look.albedo_scale[:, None], 0.0, 1.0)
    scene = scene._replace(light=light, materials=materials._replace(colour=colour))
    return scene, _displaced(camera, look.offset, look.tilt, look.field_scale, look.exposure)


def shaken(camera: Camera, effects: Effects, *, key: Key[Array, ""]) -> Camera:
    """Give the camera as it is at one frame: elsewhere by errors of the given total root-mean-square sizes."""
    normal = lambda name, shape: jax.random.normal(named_key(key, name), shape, jnp.float32)
    per_axis = np.float32(3**-0.5)
    return _displaced(
        camera,
        effects.position * per_axis * normal("position", (3,)),
        effects.attitude * per_axis * normal("attitude", (3,)),
        jnp.clip(1.0 + effects.field * normal("field", ()), 0.5, 2.0),
        effects.exposure * normal("exposure", ()),
    )


def _displaced(camera: Camera, offset, tilt, field_scale, exposure) -> Camera:
    field = camera.field * field_scale
    if camera.projection == "perspective":
        field = jnp.minimum(field, np.float32(np.radians(175.0)))
    return dataclasses.replace(
        camera,
        position=camera.position + offset,
        attitude=quat_multiply(camera.attitude, quat_from_rotation_vector(tilt)),
        field=field,
        exposure=camera.exposure + exposure,
    )


def spoiled(image: UInt8[Array, "H W C"], effects: Effects, *, key: Key[Array, ""]) -> UInt8[Array, "H W C"]:
    """Blur a picture and add noise, in the light of the display; then perhaps block it."""
    light = linear(image.astype(jnp.float32) / 255.0)
    light = _blurred(_blurred(light, effects.blur, 0), effects.blur, 1)
    spread = jnp.sqrt(effects.shot_noise**2 * light + effects.read_noise**2)
    light = light + spread * jax.random.normal(named_key(key, "pixels"), light.shape, jnp.float32)
    return jnp.where(happens(effects.blocked, "blocked", key=key), jnp.uint8(0), encoded(jnp.clip(light, 0.0, 1.0)))


def happens(probability: Float[Array, ""], name: str, *, key: Key[Array, ""]) -> Shaped[Array, ""]:
    """Draw whether something of this probability happens."""
    return jax.random.uniform(named_key(key, name), (), jnp.float32) < probability


def _blurred(light: Float[Array, "H W C"], width: Float[Array, ""], axis: int) -> Float[Array, "H W C"]:
    """Convolve along an axis with a Gaussian of a standard deviation in pixels; the border is repeated."""
    steps = np.arange(-_REACH, _REACH + 1)
    weights = jnp.exp(-0.5 * (jnp.asarray(steps, jnp.float32) / jnp.maximum(width, 1e-3)) ** 2)
    weights = weights / weights.sum()
    size = light.shape[axis]
    places = np.clip(np.arange(size)[:, None] + steps[None, :], 0, size - 1)
    return jnp.tensordot(jnp.take(light, places, axis=axis), weights, ((axis + 1,), (0,)))
