"""Positions on and above the WGS84 ellipsoid: latitude, longitude and height, both ways."""

import jax
import jax.numpy as jnp

from astrojax._types import FloatScalar, Vector3, dot, inverse_norm, safe_sqrt
from astrojax.constants import WGS84_A, WGS84_F

_E2 = WGS84_F * (2.0 - WGS84_F)
_FLAT = 1.0 - WGS84_F
_TINY = 1e-6
"""Metres from the axis below which the longitude, which is free there, is taken as zero."""


def geodetic_height(r: Vector3) -> FloatScalar:
    """Height [m] above the WGS84 ellipsoid, by its expansion to second order in the flattening.

    Args:
        r: (3,) position from Earth's centre [m], z along the figure axis.

    Validity: within 0.1 m from the ground to 2000 km; smooth at the poles, no iteration, no trigonometry.

    Source: the ellipsoid's radius at the geocentric latitude, r - a (1 - f s^2 - ...), and the foot point's
    offset from it, expanded in f; the tests hold it against brahe's iterative conversion.
    """
    inv_r = inverse_norm(r)
    s2 = (r[2] * inv_r) ** 2
    bend = 2.0 * WGS84_F * s2 * (1.0 - s2) * (WGS84_A * inv_r - 0.25)  # sin^2(2 phi) / 2 = 2 s2 (1 - s2)
    return dot(r, r) * inv_r - WGS84_A * (1.0 - WGS84_F * (s2 + bend))


def position_geodetic_to_ecef(geodetic: Vector3) -> Vector3:
    """Earth-fixed position [m] of a geodetic one.

    Args:
        geodetic: (3,) latitude, longitude [rad] and height [m] above the WGS84 ellipsoid.

    Source: NIMA TR8350.2 (3rd ed.), eq. 4-14.
    """
    latitude, longitude, height = geodetic
    sin, cos = jnp.sin(latitude), jnp.cos(latitude)
    radius = WGS84_A / jnp.sqrt(1.0 - _E2 * sin * sin)  # of curvature, in the prime vertical
    flat = (radius + height) * cos
    return jnp.stack([flat * jnp.cos(longitude), flat * jnp.sin(longitude), (radius * (1.0 - _E2) + height) * sin])


def position_ecef_to_geodetic(r: Vector3) -> Vector3:
    """Geodetic position of an Earth-fixed one: latitude, longitude [rad] and height [m] above WGS84.

    Args:
        r: (3,) position from Earth's centre [m], Earth-fixed.

    Returns:
        (3,) latitude in [-pi/2, pi/2], longitude in [-pi, pi] (0 on the axis), height.

    Validity: from 5000 km below the surface outwards without limit, at all latitudes, the poles included: 1e-8 m and
    4e-15 rad there and back (float32: 1 m, 3e-7 rad). Nearer than 43 km from the centre the nearest point of the
    ellipsoid is not unique; the result is then finite, but not a position.

    Source: Fukushima 2006, J. Geodesy 79, 689: Halley's method for the tangent of the reduced latitude, kept as sine
    and cosine; three steps, of which two suffice from the surface on.
    """
    x, y, z = r / WGS84_A
    p = safe_sqrt(x * x + y * y)
    high = jnp.abs(z)
    pole = _FLAT * high
    sine, cosine = _unit(high, _FLAT * p, jnp.zeros_like(p), jnp.ones_like(p))
    for _ in range(3):
        # f(T) = P T - Z - E T / sqrt(1 + T^2), its derivatives, and the step, all times powers of the cosine.
        d = pole + _E2 * sine**3
        f = p - _E2 * cosine**3
        b = 1.5 * _E2 * sine * cosine * cosine * (p * sine - pole * cosine - _E2 * sine * cosine)
        sine, cosine = _unit(d * f - b * sine, f * f - b * cosine, sine, cosine)
    sine, cosine = _unit(sine, _FLAT * cosine, sine, cosine)  # from the reduced to the geodetic latitude
    height = p * cosine + high * sine - jnp.sqrt(1.0 - _E2 * sine * sine)
    latitude = jnp.where(z < 0.0, -1.0, 1.0) * jnp.arctan2(sine, cosine)
    off_axis = p > _TINY / WGS84_A
    longitude = jnp.arctan2(jnp.where(off_axis, y, 0.0), jnp.where(off_axis, x, 1.0))
    return jnp.stack([latitude, longitude, WGS84_A * height])


def _unit(sine: FloatScalar, cosine: FloatScalar, *otherwise: FloatScalar) -> tuple[FloatScalar, FloatScalar]:
    """Two numbers scaled to a sine and a cosine; where both vanish, at the centre or on the axis, the others."""
    square = sine * sine + cosine * cosine
    none = square <= jnp.finfo(square.dtype).tiny
    scale = jax.lax.rsqrt(jnp.where(none, 1.0, square))
    return jnp.where(none, otherwise[0], sine * scale), jnp.where(none, otherwise[1], cosine * scale)


def position_ecef_to_geocentric(r: Vector3) -> Vector3:
    """Geocentric latitude, longitude [rad] and radius [m] of an Earth-fixed position.

    Args:
        r: (3,) position from Earth's centre [m].

    Validity: everywhere; the longitude is 0 on the axis, the latitude 0 at the centre.
    """
    p = safe_sqrt(r[0] * r[0] + r[1] * r[1])
    off_axis = p > _TINY
    longitude = jnp.arctan2(jnp.where(off_axis, r[1], 0.0), jnp.where(off_axis, r[0], 1.0))
    centre = (p <= 0.0) & (r[2] == 0.0)
    latitude = jnp.arctan2(r[2], jnp.where(centre, 1.0, p))
    return jnp.stack([latitude, longitude, safe_sqrt(dot(r, r))])


def position_geocentric_to_ecef(geocentric: Vector3) -> Vector3:
    """Earth-fixed position [m] of a geocentric latitude, longitude [rad] and radius [m].

    Args:
        geocentric: (3,) latitude, longitude [rad] and radius [m].
    """
    latitude, longitude, radius = geocentric
    flat = radius * jnp.cos(latitude)
    return jnp.stack([flat * jnp.cos(longitude), flat * jnp.sin(longitude), radius * jnp.sin(latitude)])


def geocentric_latitude(latitude: FloatScalar) -> FloatScalar:
    """Geocentric latitude [rad] of the point of the WGS84 ellipsoid at a geodetic latitude.

    Args:
        latitude: geodetic [rad], in [-pi/2, pi/2].
    """
    return jnp.arctan2((1.0 - _E2) * jnp.sin(latitude), jnp.cos(latitude))
