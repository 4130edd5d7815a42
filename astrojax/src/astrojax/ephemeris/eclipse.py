"""Eclipse of the Sun by the Earth, as a vehicle sees it."""

import math

import jax
import jax.numpy as jnp

from astrojax._types import FloatScalar, Scalar, Vector3, cross, dot, inverse_norm, safe_sqrt
from astrojax.constants import R_EARTH, R_SUN


def illumination_conical(r: Vector3, r_sun: Vector3) -> FloatScalar:
    """Fraction of the solar disc that the Earth leaves visible: 1 in sunlight, 0 in the umbra.

    Args:
        r: (3,) position of the vehicle from Earth's centre [m], |r| > R_EARTH.
        r_sun: (3,) position of the Sun from Earth's centre [m], same axes.

    Validity: a spherical Earth without air, whose limb and the solar disc overlap as circles in a plane; that is
    within 1e-3 of what a vehicle in low orbit sees. Gradients are finite everywhere and zero outside the
    penumbra.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.4.2.
    """
    return 1.0 - _covered(*eclipse_angles(r, r_sun))


def eclipse_angles(r: Vector3, r_sun: Vector3) -> tuple[FloatScalar, FloatScalar, FloatScalar]:
    """Angular radii of the Sun and of the Earth, and how far apart their centres stand [rad], as a vehicle sees them.

    Args:
        r, r_sun: as of `illumination_conical`.

    Source: Montenbruck and Gill, Satellite Orbits, eq. 3.85 to 3.87.
    """
    # In units of the Sun's distance: squares of 1.5e11 m leave the range of float32 when differentiated.
    inv_d = inverse_norm(r_sun)
    position, sun = r * inv_d, r_sun * inv_d
    to_sun = sun - position
    inv_sun, inv_r = inverse_norm(to_sun), inverse_norm(position)
    radius_sun = jnp.arcsin(R_SUN * inv_d * inv_sun)
    radius_earth = jnp.arcsin(jnp.minimum(R_EARTH * inv_d * inv_r, 1.0 - jnp.finfo(r.dtype).eps))
    axis = cross(position, to_sun)
    separation = jnp.arctan2(safe_sqrt(dot(axis, axis)), -dot(position, to_sun))
    return radius_sun, radius_earth, separation


def illumination_cylindrical(r: Vector3, r_sun: Vector3, radius: Scalar = R_EARTH) -> FloatScalar:
    """1 in sunlight, 0 in a shadow as wide as the Earth, without penumbra or end.

    Args:
        r: (3,) position of the vehicle from Earth's centre [m].
        r_sun: (3,) position of the Sun from Earth's centre [m], same axes.
        radius: of the shadow [m].

    Validity: in low orbit the terminator is within 10 s of the truth. Its derivative is zero everywhere, and
    tells nothing of the edge's own motion; `illumination_conical` is smooth.

    Source: Montenbruck and Gill, Satellite Orbits, sec. 3.4.2.
    """
    along = dot(r, r_sun * inverse_norm(r_sun))
    across = dot(r, r) - along * along
    dark = (along < 0) & (across < radius * radius)
    return jnp.where(dark, jnp.zeros_like(along), jnp.ones_like(along))


@jax.custom_jvp
def _covered(a: FloatScalar, b: FloatScalar, c: FloatScalar) -> FloatScalar:
    """Fraction of a circle of radius a that lies in one of radius b, their centres c apart.

    Apart or nested, the chord is zero and the arcs are none or the whole circle: the same expression holds.
    """
    arc_a, arc_b, half_chord = _lens(a, b, c)
    return arc_a / math.pi + (b * b * arc_b - c * half_chord) / (math.pi * a * a)


@_covered.defjvp
def _covered_jvp(primals, tangents):
    # Each circle's arc inside the other sweeps area as its radius grows, the chord as the centres part. The sum of
    # the expression's own derivatives would be infinity less infinity at first contact.
    a, b, c = primals
    da, db, dc = tangents
    _, arc_b, half_chord = _lens(a, b, c)
    per_disc = 2.0 / (math.pi * a * a)
    by_a = -per_disc * (b * b * arc_b - c * half_chord) / a
    return _covered(a, b, c), by_a * da + per_disc * (b * arc_b * db - half_chord * dc)


def _lens(a, b, c):
    """Half the angle of each circle's arc inside the other, and half their common chord."""
    c = jnp.maximum(c, jnp.finfo(c.dtype).eps)
    x = 0.5 * (c + (a - b) * ((a + b) / c))  # of the chord, from the centre of a
    half_chord = safe_sqrt((a - x) * (a + x))
    return jnp.arctan2(half_chord, x), jnp.arctan2(half_chord, c - x), half_chord
