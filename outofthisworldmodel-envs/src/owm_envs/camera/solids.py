"""Every part of a scene as one kind of solid: a quadric clipped by a box. So one formula meets them all.

In a part's own frame a solid is where `k (x^2 + y^2) + m z^2 + l z + c <= 0` and `|x|, |y|, |z|` stay within `half`.
Cylinder, cone and sphere are quadrics; of a box the quadric is -1, everywhere inside. All are convex.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from owm_envs.camera.vectors import Vector
from owm_envs.station.geometry import ROUND, rotation
from owm_envs.station.parts import Part

FAR = 1e30
_FLAT = 1e-9


class Solids(NamedTuple):
    """Parts as arrays: traced leaves all, so that a moved, missing or other part recompiles nothing."""

    centre: Float[Array, "N 3"]
    """m, in the frame of the table that they come from."""
    rotation: Float[Array, "N 3 3"]
    """Columns are the part's own x, y, z."""
    half: Float[Array, "N 3"]
    """Half extents along them [m]."""
    quadric: Float[Array, "N 4"]
    """k, m, l, c as above."""
    material: Int[Array, "N"]
    """Row of the table of materials."""
    present: Bool[Array, "N"]
    """Whether the part is there."""


def solids(parts: Sequence[Part], materials: Sequence[str]) -> Solids:
    """Give rows of the table of parts as arrays, float32.

    Args:
        parts: at least one.
        materials: names in the order of the table of materials.
    """
    half, quadric = [], []
    for part in parts:
        size = 0.5 * np.asarray(part.dimensions)
        if part.primitive == "sphere":
            shape = (1.0, 1.0, 0.0, -(size[0] ** 2))
        elif part.primitive in ROUND:
            slope, middle = (size[1] - size[0]) / (2.0 * size[2]), 0.5 * (size[0] + size[1])
            shape = (1.0, -(slope**2), -2.0 * middle * slope, -(middle**2))
            size = np.array([max(size[:2]), max(size[:2]), size[2]])
        else:
            shape = (0.0, 0.0, 0.0, -1.0)
        half.append(size)
        quadric.append(shape)
    return Solids(
        centre=jnp.asarray(np.array([part.position for part in parts]), jnp.float32),
        rotation=jnp.asarray(np.array([rotation(part) for part in parts]), jnp.float32),
        half=jnp.asarray(np.array(half), jnp.float32),
        quadric=jnp.asarray(np.array(quadric), jnp.float32),
        material=jnp.asarray([materials.index(part.material) for part in parts], jnp.int32),
        present=jnp.ones(len(parts), bool),
    )


def moved(solids: Solids, position: Float[Array, "3"], turn: Float[Array, "3 3"], present: Bool[Array, ""]) -> Solids:
    """Give the parts of a vehicle in the station frame.

    Args:
        position: of the vehicle's origin [m], station frame.
        turn: rotation from the vehicle's frame to the station's.
        present: whether it is there at all.
    """
    return solids._replace(
        centre=solids.centre @ turn.T + position[None, :],
        rotation=jnp.einsum("ij,njk->nik", turn, solids.rotation),
        present=solids.present & present,
    )


def joined(groups: Sequence[Solids]) -> Solids:
    """Give several groups of parts as one, in order."""
    return jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *groups)


class Crossing(NamedTuple):
    """Where a ray is inside a solid, and what it enters through; a miss has `leave < enter`."""

    enter: Array
    leave: Array
    """Distances along the ray [m]."""
    slabs: Vector
    """Distance at which it comes between each pair of faces."""
    bow: Array
    """Distance at which it enters the quadric."""


def crossing(start: Vector, way: Vector, half: Vector, quadric: tuple[Array, Array, Array, Array]) -> Crossing:
    """Meet a ray with a solid, in the solid's own frame; all arguments broadcast.

    Distances count from the point nearest to the solid's centre while they are found, so that float32 is good to
    some micrometres at a kilometre.

    Args:
        start, way: a point of the ray [m], and its unit direction.
        half, quadric: of the solid.
    """
    middle = -(start[0] * way[0] + start[1] * way[1] + start[2] * way[2])
    x, y, z = (s + middle * w for s, w in zip(start, way))
    near, far, slabs = -FAR, FAR, []
    for place, slope, reach in zip((x, y, z), way, half):
        inverse = 1.0 / jnp.where(jnp.abs(slope) < _FLAT, _FLAT, slope)
        mid, span = -place * inverse, reach * jnp.abs(inverse)
        slabs.append(mid - span)
        near, far = jnp.maximum(near, mid - span), jnp.minimum(far, mid + span)
    k, m, l, c = quadric
    u, v, w = way
    a = k * (u * u + v * v) + m * w * w
    b = k * (x * u + y * v) + (m * z + 0.5 * l) * w
    inside = k * (x * x + y * y) + (m * z + l) * z + c
    square = b * b - a * inside
    real = square > 0
    root = jnp.sqrt(jnp.where(real, square, 1.0))
    closed = a > _FLAT  # the ray is inside between the roots
    inverse = 1.0 / jnp.where(jnp.abs(a) < _FLAT, jnp.where(a < 0, -_FLAT, _FLAT), a)
    first, second = (-b - root) * inverse, (-b + root) * inverse
    # Steeper than its cone a ray is inside before `second` and after `first`; the box holds one of the two.
    early = near <= second
    bow = jnp.where(closed, first, jnp.where(early | ~real, -FAR, first))
    stern = jnp.where(closed, second, jnp.where(early & real, second, FAR))
    enter, leave = jnp.maximum(near, bow), jnp.minimum(far, stern)
    missed = (closed & ~real) | ((k == 0) & (inside > 0))
    return Crossing(
        enter + middle, jnp.where(missed, -FAR, leave + middle), tuple(s + middle for s in slabs), bow + middle
    )
