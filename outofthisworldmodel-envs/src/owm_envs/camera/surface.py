"""What a point of a part looks like: its colour, gloss and creases, by material.

One formula draws every pattern. A face has two coordinates in metres: across (around a round body) and along. On them
lie seams in both directions and a grid of patches. Panels between seams differ in tone, and a blanket is creased.
All of it is filtered: a pixel gets the mean over what it covers. So a fine grid far away is an even tone.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from owm_envs.camera.vectors import Vector
from owm_envs.station.parts import MATERIALS

MATERIAL_NAMES = tuple(MATERIALS)


class Pattern(NamedTuple):
    """What is drawn on a material. Lengths in metres, colours in sRGB, 0 to 1."""

    seams_across: tuple[float, float] = (1.0, 0.0)
    """Period across the face and width of the lines that run along it."""
    seams_along: tuple[float, float] = (1.0, 0.0)
    """Period along the face and width of the lines that run across it; of rings if `polar`."""
    seam: float = 1.0
    """How bright seams are, of the material itself."""
    patches_across: tuple[float, float] = (1.0, 0.0)
    """Period and width of the patches across the face."""
    patches_along: tuple[float, float] = (1.0, 0.0)
    """The same along it."""
    patch: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tones: float = 0.0
    """Share by which panels between seams are darker, at most."""
    creases: tuple[float, float] = (1.0, 0.0)
    """Size of the folds, and how far they tilt the normal."""
    polar: float = 0.0
    """1 where end faces are drawn around their middle: angle in radians across, radius along; else 0."""
    back: str = ""
    """Material of the face against local y; the same when empty."""


_RAIL = (0.62, 0.50, 0.28)
PATTERNS: dict[str, Pattern] = {
    # Shield panels, handrails in rows.
    "shield": Pattern((1.15, 0.035), (1.22, 0.04), 0.35, (2.3, 0.07), (2.44, 1.5), _RAIL, 0.22),
    "blanket": Pattern((0.95, 0.03), (1.05, 0.03), 0.5, tones=0.08, creases=(0.32, 0.16)),
    # Quilts tied down by seams, yellow handrails.
    "russian": Pattern((0.9, 0.03), (0.6, 0.03), 0.45, (1.6, 0.06), (1.8, 0.9), _RAIL, 0.22, (0.25, 0.18)),
    "russian_white": Pattern((0.8, 0.03), (0.7, 0.03), 0.45, (1.6, 0.06), (1.4, 0.8), _RAIL, 0.12, (0.22, 0.16)),
    "adapter": Pattern((0.9, 0.03), (0.8, 0.03), 2.4, (1.8, 0.07), (1.6, 0.8), (0.8, 0.78, 0.7), 0.2),
    "metal": Pattern((0.6, 0.03), (0.9, 0.03), 0.3, tones=0.15),
    "truss": Pattern((0.8, 0.02), (1.0, 0.03), 0.4, tones=0.10),
    # Trays and boxes side by side, slots between them.
    "equipment": Pattern((1.1, 0.06), (0.9, 0.06), 0.10, (2.2, 0.7), (2.7, 0.6), (0.50, 0.48, 0.42), 0.30),
    "foil": Pattern((0.5, 0.02), (0.5, 0.02), 0.4, tones=0.15, creases=(0.15, 0.3)),
    # Eight hinged panels, each with a pipe every 30 cm.
    "radiator": Pattern((0.30, 0.012), (2.92, 0.08), 0.35, (3.5, 3.2), (2.92, 0.35), (0.88, 0.89, 0.90), 0.04),
    # Folded panels, cells of 8 cm in strings.
    "array": Pattern(
        (0.787, 0.04), (0.39, 0.02), 1.4, (0.0984, 0.088), (0.0975, 0.089), (0.50, 0.36, 0.20), 0.16, back="array_back"
    ),
    "array_back": Pattern((0.787, 0.06), (0.39, 0.03), 0.5, tones=0.12),
    "array_blue": Pattern((1.0, 0.05), (0.9, 0.05), 2.2, (0.125, 0.112), (0.125, 0.112), (0.10, 0.12, 0.26), 0.15),
    "dragon": Pattern((1.44, 0.025), (1.15, 0.03), 0.35, tones=0.05),
    "trunk": Pattern((0.24, 0.015), (1.15, 0.04), 0.45, tones=0.06),
    "heat_shield": Pattern((0.4, 0.02), (0.4, 0.02), 0.4, tones=0.2),
    # Bolts and latches around the rim of a berthing ring.
    "berth": Pattern((0.3927, 0.10), (0.25, 0.04), 0.35, tones=0.1, polar=1.0),
    "hatch": Pattern((3.1416, 0.0), (0.45, 0.06), 0.2, tones=0.05, polar=1.0),
    "drogue": Pattern((1.5708, 0.12), (0.32, 0.06), 4.0, polar=1.0),
}


class Materials(NamedTuple):
    """The table of materials; traced, so that another colour or spacing recompiles nothing."""

    colour: Float[Array, "M 3"]
    """Linear RGB, the share of light that is thrown back."""
    metallic: Float[Array, "M"]
    roughness: Float[Array, "M"]
    seam: Float[Array, "M"]
    """As of `Pattern`."""
    patch: Float[Array, "M 3"]
    """Linear RGB."""
    seams: Float[Array, "M 4"]
    patches: Float[Array, "M 4"]
    """Period and width across, period and width along [m]."""
    tones: Float[Array, "M"]
    creases: Float[Array, "M 2"]
    polar: Float[Array, "M"]
    """As of `Pattern`."""
    back: Int[Array, "M"]
    """Row of the material on the face against local y."""


class Look(NamedTuple):
    """What shading needs to know of a point."""

    colour: Vector
    metallic: Array
    roughness: Array
    bend: Vector
    """To be added to the unit normal. It has no frame: nobody can tell which way a crease leans."""


def linear(srgb: Float[Array, "..."] | Float[np.ndarray, "..."]) -> Float[Array, "..."]:
    """Take colours from sRGB, 0 to 1, to linear light. Source: IEC 61966-2-1."""
    return jnp.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def materials() -> Materials:
    """Give the station's materials, in the order of `MATERIAL_NAMES`."""
    rows = MATERIALS.values()
    drawn = [PATTERNS.get(name, Pattern()) for name in MATERIAL_NAMES]
    table = lambda values: jnp.asarray(np.array(values), jnp.float32)
    return Materials(
        colour=table(linear(np.array([row.colour for row in rows]))),
        metallic=table([row.metallic for row in rows]),
        roughness=table([row.roughness for row in rows]),
        seam=table([p.seam for p in drawn]),
        patch=table(linear(np.array([p.patch for p in drawn]))),
        seams=table([(*p.seams_across, *p.seams_along) for p in drawn]),
        patches=table([(*p.patches_across, *p.patches_along) for p in drawn]),
        tones=table([p.tones for p in drawn]),
        creases=table([p.creases for p in drawn]),
        polar=table([p.polar for p in drawn]),
        back=jnp.asarray([MATERIAL_NAMES.index(p.back or name) for name, p in zip(MATERIAL_NAMES, drawn)], jnp.int32),
    )


def _angle(x: Array, y: Array) -> Array:
    """Angle of a unit vector from the x axis, -pi to pi, to 0.0005 rad."""
    wide, tall = jnp.abs(x), jnp.abs(y)
    sine = jnp.minimum(jnp.minimum(wide, tall), 0.71)
    square = sine * sine
    angle = sine + sine * square * (0.16209 + 0.10954 * square)
    angle = jnp.where(tall > wide, 0.5 * np.pi - angle, angle)
    angle = jnp.where(x < 0, np.pi - angle, angle)
    return jnp.where(y < 0, -angle, angle)


def _covered(place: Array, period: Array, width: Array, span: Array) -> Array:
    """Share of a stretch that lines cover which lie around every multiple of a period: a box filter.

    Args:
        place, span: middle and length of the stretch [m].
        period, width: of the lines [m].
    """
    rate = 1.0 / period
    duty = width * rate
    reach = 0.5 * span * rate
    # The integral of the lines up to a place, on either end of the stretch.
    middle = place * rate + 0.5 * duty
    high, low = middle + reach, middle - reach
    floors = jnp.floor(high), jnp.floor(low)
    above = floors[0] * duty + jnp.minimum(high - floors[0], duty)
    below = floors[1] * duty + jnp.minimum(low - floors[1], duty)
    return jnp.clip((above - below) / (2.0 * reach), 0.0, 1.0)


def _wave(turns: Array) -> Array:
    """A triangle between -1 and 1 with period 1."""
    return 4.0 * jnp.abs(turns - jnp.floor(turns) - 0.5) - 1.0


def look(
    materials: Materials, material: Int[Array, "..."], place: Vector, normal: Vector, half: Vector, width: Array
) -> Look:
    """Give the look of points.

    Args:
        material: rows of the table.
        place, normal: of the points, in their parts' own frames [m].
        half: half extents of their parts [m].
        width: of what a pixel covers there [m].
    """
    reverse = materials.back.at[material].get(mode="promise_in_bounds")
    material = jnp.where(normal[1] < -0.9, reverse, material)
    row = lambda table: table.at[material].get(mode="promise_in_bounds")
    rows = lambda table: [row(table[:, j]) for j in range(table.shape[1])]
    x, y, z = place
    end = jnp.abs(normal[2]) > 0.9
    polar = end & (row(materials.polar) > 0.5)
    radius = jnp.sqrt(jnp.maximum(x * x + y * y, 1e-12))
    # Around: of an end face the angle of the place; of a round side that of the normal; of a flat side both.
    toward = jnp.where(end, x, normal[0]), jnp.where(end, y, normal[1])
    inverse = 1.0 / jnp.sqrt(jnp.maximum(toward[0] * toward[0] + toward[1] * toward[1], 1e-12))
    angle = _angle(toward[0] * inverse, toward[1] * inverse)
    around = half[0] * angle + normal[0] * y - normal[1] * x
    u = jnp.where(polar, angle, jnp.where(end, x, around))
    v = jnp.where(polar, radius, jnp.where(end, y, z))
    span_v = jnp.maximum(width, 1e-4)
    span_u = jnp.where(polar, jnp.minimum(span_v / radius, np.pi), span_v)

    seams, patches = rows(materials.seams), rows(materials.patches)
    ratio = span_v / jnp.minimum(seams[0], seams[2])
    panel = jnp.floor(u / seams[0]) * 0.618 + jnp.floor(v / seams[2]) * 0.7549
    tone = 1.0 - row(materials.tones) * (0.5 + jnp.maximum(1.0 - ratio, 0.0) * (panel - jnp.floor(panel) - 0.5))
    grid = _covered(u - 0.5 * patches[0], *patches[:2], span_u) * _covered(v - 0.5 * patches[2], *patches[2:], span_v)
    open_ = (1.0 - _covered(u, *seams[:2], span_u)) * (1.0 - _covered(v, *seams[2:], span_v))
    seam = row(materials.seam)
    bare = tone * (seam + open_ * (1.0 - seam))
    filled = tone * open_ * grid
    colour = tuple(
        jnp.minimum(bare * base + filled * (patch - base), 1.0)
        for base, patch in zip(rows(materials.colour), rows(materials.patch))
    )

    size, lean = rows(materials.creases)
    # Creases too small to be seen blur the gloss instead.
    hidden = lean * jnp.minimum(span_v / size, 1.0)
    lean, roughness = lean - hidden, jnp.minimum(row(materials.roughness) + 0.25 * hidden, 1.0)
    a, b, c = x / size, y / size, z / size
    first = _wave(a + 0.37 * c + 0.21 * b)
    second = _wave(b + 0.4 * first + 0.19 * c)
    third = _wave(c + 0.4 * second - 0.31 * a)
    bend = (lean * third, lean * first, lean * second)
    return Look(colour, row(materials.metallic), roughness, bend)
