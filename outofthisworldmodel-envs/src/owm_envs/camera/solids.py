"""Every part of a scene as one kind of solid: a quadric clipped by a box. So one formula meets them all.

In a part's own frame a solid is where `k (x^2 + y^2) + m z^2 + n z + c <= 0` and `|x|, |y|, |z|` stay within `half`.
Cylinder, cone and sphere are quadrics; of a box the quadric is -1, everywhere inside. All are convex.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from owm_envs.camera.vectors import Vector, dot, plus, unit, where
from owm_envs.station.geometry import ROUND, rotation
from owm_envs.station.parts import Part

Quadric = tuple[Array, Array, Array, Array]
FAR = 1e30
EXACT = jax.lax.Precision.HIGHEST
"""Accelerators may shorten the numbers of a product to ten bits, which is centimetres here."""
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
    """k, m, n, c as above."""
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
        centre=jnp.matmul(solids.centre, turn.T, precision=EXACT) + position[None, :],
        rotation=jnp.einsum("ij,njk->nik", turn, solids.rotation, precision=EXACT),
        present=solids.present & present,
    )


def joined(groups: Sequence[Solids]) -> Solids:
    """Give several groups of parts as one, in order."""
    return jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *groups)


class Crossing(NamedTuple):
    """Where a ray is inside a solid [m along the ray]; a miss has `leave < enter`."""

    enter: Array
    leave: Array


def crossing(start: Vector, way: Vector, half: Vector, quadric: Quadric) -> Crossing:
    """Meet a ray with a solid, in the solid's own frame; all arguments broadcast.

    Distances count from the point nearest to the solid's centre while they are found, so that float32 is good to
    some micrometres at a kilometre.

    Args:
        start, way: a point of the ray [m], and its unit direction.
        half, quadric: of the solid.
    """
    middle = -dot(start, way)
    x, y, z = plus(start, middle, way)
    near, far = -FAR, FAR
    for place, slope, reach in zip((x, y, z), way, half):
        inverse = 1.0 / jnp.where(jnp.abs(slope) < _FLAT, _FLAT, slope)
        mid, span = -place * inverse, reach * jnp.abs(inverse)
        near, far = jnp.maximum(near, mid - span), jnp.minimum(far, mid + span)
    k, m, n, c = quadric
    u, v, w = way
    a = k * (u * u + v * v) + m * w * w
    b = k * (x * u + y * v) + (m * z + 0.5 * n) * w
    inside = k * (x * x + y * y) + (m * z + n) * z + c
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
    missed = (closed & ~real) | ((k == 0) & (inside > 0))
    enter, leave = jnp.maximum(near, bow), jnp.minimum(far, stern)
    return Crossing(enter + middle, jnp.where(missed, -FAR, leave + middle))


def bow_normal(place: Vector, quadric: Quadric) -> Vector:
    """Give half the gradient of the quadric."""
    k, m, n, _ = quadric
    return (k * place[0], k * place[1], m * place[2] + 0.5 * n)


class Standing(NamedTuple):
    """Where a point of a solid's surface stands, in the solid's own frame."""

    distance: Array
    """Along the ray [m]."""
    place: Vector
    face: Int[Array, "..."]
    """0, 1, 2 for a pair of faces of the box, 3 for the bow."""


def standing(distance: Array, start: Vector, way: Vector, half: Vector, quadric: Quadric) -> Standing:
    """Settle where a ray meets a solid, given nearly how far off: one step of Newton's method, to be differentiated.

    The face is that whose constraint the point fulfils most narrowly.
    """
    near = plus(start, distance, way)
    k, m, n, c = quadric
    steep = bow_normal(near, quadric)
    value = k * (near[0] * near[0] + near[1] * near[1]) + (m * near[2] + n) * near[2] + c
    margin = 0.5 * value * jax.lax.rsqrt(jnp.maximum(dot(steep, steep), 1e-12))
    face, error, slope = jnp.full(jnp.shape(margin), 3, jnp.int32), 0.5 * value, dot(steep, way)
    for axis in range(3):
        other = jnp.abs(near[axis]) - half[axis]
        narrower = other > margin
        face, margin = jnp.where(narrower, axis, face), jnp.maximum(other, margin)
        error, slope = jnp.where(narrower, other, error), jnp.where(narrower, jnp.sign(near[axis]) * way[axis], slope)
    grazing = jnp.abs(slope) < 1e-3  # a step would be long, and wrong
    step = jnp.where(grazing, 0.0, error / jnp.where(grazing, 1.0, slope))
    return Standing(jnp.maximum(distance - step, 0.0), plus(near, -step, way), face)


def normal_at(face: Int[Array, "..."], place: Vector, quadric: Quadric) -> Vector:
    """Give the outward unit normal there, in the solid's own frame."""
    square = tuple(jnp.where(face == axis, jnp.sign(place[axis]), 0.0) for axis in range(3))
    return where(face == 3, unit(bow_normal(place, quadric)), square)
