"""Light on a surface, and from radiance to pixels.

Radiance counts in that of a white matt plane that faces the Sun. A surface is matt under a gloss: Lambert's law under
microfacets (Walter et al., Microfacet Models for Refraction, EGSR 2007; Schlick's Fresnel term, 1994).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt8

from astrojax.constants import R_EARTH
from owm_envs.camera.light import Heavens
from owm_envs.camera.surface import Look
from owm_envs.camera.vectors import Vector, dot, plus, unit

_EARTH_TINT = (0.86, 0.94, 1.0)


class Light(NamedTuple):
    """How bright everything shines, to be chosen or drawn."""

    sun: Float[Array, ""]
    """Of its true brightness."""
    earth: Float[Array, ""]
    """Share of sunlight that the Earth throws back."""
    bounce: Float[Array, ""]
    """Share of sunlight that comes from all sides, off the station's own parts."""
    lamp: Float[Array, ""]
    """Radiance of a white plane 10 m before a lamp at the camera."""


def default_light() -> Light:
    """Give the light of a clear day in orbit, and a small lamp."""
    return Light(*(jnp.asarray(number, jnp.float32) for number in (1.0, 0.3, 0.04, 0.5)))


class Lights(NamedTuple):
    """What lights the station at an instant, in the station frame."""

    sun: Float[Array, "3"]
    """Unit vector towards the Sun."""
    sunlight: Float[Array, ""]
    """Radiance of a white plane that faces it."""
    down: Float[Array, "3"]
    """Unit vector towards the middle of the Earth."""
    earth_sine: Float[Array, ""]
    """Sine of the Earth's angular radius."""
    earthshine: Float[Array, ""]
    """Radiance of the Earth below."""
    bounce: Float[Array, ""]
    """Radiance of what the station's own parts throw back, from all sides."""
    lamp: Float[Array, ""]
    """As of `Light`."""


def lights(light: Light, heavens: Heavens) -> Lights:
    """Give what lights the station, from where everything stands."""
    distance = jnp.sqrt((heavens.earth * heavens.earth).sum())
    down = heavens.earth / distance
    sunlight = light.sun * heavens.sunlight
    # The half of the Earth that lies in the sight of the station turns from the Sun only gradually.
    height = -(down * heavens.sun).sum()
    day = 0.5 * (height + jnp.sqrt(height * height + 0.02))
    earthshine = light.sun * light.earth * day
    return Lights(heavens.sun, sunlight, down, R_EARTH / distance, earthshine, light.bounce * sunlight, light.lamp)


def _fifth(x: Array) -> Array:
    return (x * x) ** 2 * x


def _gloss(look: Look, normal: Vector, to_eye: Vector, to_light: Vector, facing: Array) -> tuple[Array, Array]:
    """Reflectance times pi of the gloss without its Fresnel term, and that term's fifth power."""
    half = unit(plus(to_eye, 1.0, to_light))
    eye = jnp.maximum(dot(normal, to_eye), 1e-3)
    light = jnp.maximum(facing, 1e-3)
    alpha2 = jnp.maximum(look.roughness, 0.06) ** 4
    tilt = jnp.maximum(dot(normal, half), 0.0)
    lobe = alpha2 / (tilt * tilt * (alpha2 - 1.0) + 1.0) ** 2
    masking = 0.5 / (
        light * jnp.sqrt(eye * eye * (1.0 - alpha2) + alpha2) + eye * jnp.sqrt(light * light * (1.0 - alpha2) + alpha2)
    )
    return lobe * masking, _fifth(1.0 - jnp.maximum(dot(to_eye, half), 0.0))


def radiance(lights: Lights, look: Look, normal: Vector, to_eye: Vector, distance: Array, lit: Array) -> Vector:
    """Give what a surface sends towards the eye, red, green and blue.

    Args:
        normal, to_eye: unit vectors, station frame.
        distance: to the eye [m].
        lit: share of the Sun's disc that no other part hides, 0 to 1.
    """
    sun, down = (tuple(v[j] for j in range(3)) for v in (lights.sun, lights.down))
    normal = unit(plus(normal, 1.0, look.bend))
    facing = jnp.maximum(dot(normal, sun), 0.0)
    eye = jnp.maximum(dot(normal, to_eye), 1e-3)
    direct = facing * lit * lights.sunlight
    lobe, fresnel = _gloss(look, normal, to_eye, sun, facing)
    # The lamp sits at the eye, so that its half vector is the line of sight.
    lamp = lights.lamp * eye * 100.0 / jnp.maximum(distance * distance, 1.0)
    lamp_lobe, lamp_fresnel = _gloss(look, normal, to_eye, to_eye, eye)
    # A disc as wide as the Earth: exact if it filled half the sky, and zero when it has set for this surface.
    tilt = (dot(normal, down) + lights.earth_sine) / (1.0 + lights.earth_sine)
    earth = lights.earthshine * lights.earth_sine**2 * jnp.maximum(tilt, 0.0)
    away = plus((-to_eye[0], -to_eye[1], -to_eye[2]), 2.0 * eye, normal)
    horizon = -jnp.sqrt(jnp.maximum(1.0 - lights.earth_sine**2, 0.0))
    blur = 0.1 + 0.9 * look.roughness
    mirrored = lights.earthshine * jax.nn.sigmoid((dot(away, down) + horizon) / (0.25 * blur)) + lights.bounce
    # What the gloss throws back at grazing angles cannot come out of the matt layer as well.
    matt_eye, matt_sun = 1.0 - _fifth(1.0 - eye), 1.0 - _fifth(1.0 - facing)
    rim = (1.0 - matt_eye) * (1.0 - look.roughness) ** 2
    result = []
    for colour, tint in zip(look.colour, _EARTH_TINT):
        base = 0.04 + (colour - 0.04) * look.metallic
        matt = colour * (1.0 - look.metallic) * (1.0 - base) * matt_eye
        total = direct * (matt * matt_sun + lobe * (base + (1.0 - base) * fresnel))
        total = total + lamp * (matt * matt_eye + lamp_lobe * (base + (1.0 - base) * lamp_fresnel))
        total = total + matt * (earth * tint + lights.bounce) + (base + (1.0 - base) * rim) * mirrored * tint
        result.append(total)
    return tuple(result)


def developed(light: Array) -> Array:
    """Give exposed radiance as display light, 0 to 1: a filmic curve that lets highlights roll off.

    Source: a rational fit to the Academy's reference curve, K. Narkowicz, 2016.
    """
    x = 0.6 * jnp.maximum(light, 0.0)
    x = jnp.minimum(x, 1e4)
    return jnp.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)


def encoded(light: Float[Array, "..."]) -> UInt8[Array, "..."]:
    """Give display light, 0 to 1, as sRGB. Source: IEC 61966-2-1."""
    powered = jnp.exp(jnp.log(jnp.maximum(light, 0.0031308)) / 2.4)
    return jnp.round(255.0 * jnp.where(light <= 0.0031308, 12.92 * light, 1.055 * powered - 0.055)).astype(jnp.uint8)
