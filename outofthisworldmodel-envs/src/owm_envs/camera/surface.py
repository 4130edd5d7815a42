"""What a point of a part looks like: its colour and gloss, by material."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from owm_envs.camera.vectors import Vector
from owm_envs.station.parts import MATERIALS

MATERIAL_NAMES = tuple(MATERIALS)


class Materials(NamedTuple):
    """The table of materials; traced, so that another colour recompiles nothing."""

    colour: Float[Array, "M 3"]
    """Linear RGB, the share of light that is thrown back."""
    metallic: Float[Array, "M"]
    roughness: Float[Array, "M"]


class Look(NamedTuple):
    """What shading needs to know of a point."""

    colour: Vector
    metallic: Array
    roughness: Array
    normal: Vector
    """In the part's own frame."""


def linear(srgb: np.ndarray) -> np.ndarray:
    """Take colours from sRGB, 0 to 1, to linear light. Source: IEC 61966-2-1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def materials() -> Materials:
    """Give the station's materials, in the order of `MATERIAL_NAMES`."""
    rows = MATERIALS.values()
    return Materials(
        jnp.asarray(linear(np.array([row.colour for row in rows])), jnp.float32),
        jnp.asarray([row.metallic for row in rows], jnp.float32),
        jnp.asarray([row.roughness for row in rows], jnp.float32),
    )


def look(
    materials: Materials, material: Int[Array, "..."], place: Vector, normal: Vector, half: Vector, width: Array
) -> Look:
    """Give the look of points.

    Args:
        material: rows of the table.
        place, normal: of the points, in their parts' own frames [m].
        half: half extents of their parts [m].
        width: of what a ray covers there, across the ray [m].
    """
    row = lambda table: table[material]
    colour = tuple(row(materials.colour[:, channel]) for channel in range(3))
    return Look(colour, row(materials.metallic), row(materials.roughness), normal)
