"""Relative motion in the chief's RTN frame.

RTN axes: R along the position, N along the orbital angular momentum, T = N x R completing the triad.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import Matrix3, Scalar, Vector3, Vector6, cross, dot, float_dtype, inverse_norm


def rotation_eci_to_rtn(state: Vector6) -> Matrix3:
    """Rotation matrix from inertial to RTN axes (its rows are R, T, N in inertial axes).

    Args:
        state: (6,) inertial position and velocity [m, m/s], not parallel.

    Source: Alfriend et al., Spacecraft Formation Flying (2010), ch. 2.
    """
    r, v = state[:3], state[3:]
    radial = r * inverse_norm(r)
    h = cross(r, v)
    normal = h * inverse_norm(h)
    return jnp.stack([radial, cross(normal, radial), normal])


def rtn_rate(state: Vector6, accel: Vector3) -> Vector3:
    """Angular velocity [rad/s] of the RTN frame with respect to inertial space, in RTN axes.

    Args:
        state: (6,) inertial position and velocity of the frame's owner [m, m/s].
        accel: (3,) its total inertial acceleration [m/s^2]; only the part along N matters. That part turns
            the orbit plane: (r a_N / h) about R, which brahe and the Keplerian frame leave out.

    Source: Gauss's variational equations for the plane; Alfriend et al., Spacecraft Formation Flying (2010).
    """
    r, v = state[:3], state[3:]
    h = cross(r, v)
    inv_h = inverse_norm(h)
    inv_r = inverse_norm(r)
    out_of_plane = dot(accel, h) * inv_h * inv_h / inv_r
    return jnp.stack([out_of_plane, jnp.zeros_like(out_of_plane), inv_r * inv_r / inv_h])


def _rate(chief: Vector6, accel_chief: Vector3 | None) -> Vector3:
    return rtn_rate(chief, jnp.zeros_like(chief[:3]) if accel_chief is None else accel_chief)


def state_eci_to_rtn(chief: Vector6, deputy: Vector6, accel_chief: Vector3 | None = None) -> Vector6:
    """Position and velocity of the deputy as seen from the chief's rotating RTN frame [m, m/s].

    Args:
        chief: (6,) inertial state of the chief [m, m/s].
        deputy: (6,) inertial state of the deputy [m, m/s].
        accel_chief: (3,) inertial acceleration of the chief [m/s^2]; without it the frame turns about N only,
            exact for Keplerian motion.
    """
    rotation = rotation_eci_to_rtn(chief)
    position = rotation @ (deputy[:3] - chief[:3])
    velocity = rotation @ (deputy[3:] - chief[3:]) - cross(_rate(chief, accel_chief), position)
    return jnp.concatenate([position, velocity])


def state_rtn_to_eci(chief: Vector6, rel: Vector6, accel_chief: Vector3 | None = None) -> Vector6:
    """Inertial state of a deputy given relative to the chief's rotating RTN frame [m, m/s].

    Args:
        chief: (6,) inertial state of the chief [m, m/s].
        rel: (6,) relative position and velocity in RTN axes [m, m/s].
        accel_chief: as in `state_eci_to_rtn`, of which this is the inverse.
    """
    to_eci = rotation_eci_to_rtn(chief).T
    position = to_eci @ rel[:3]
    velocity = to_eci @ (rel[3:] + cross(_rate(chief, accel_chief), rel[:3]))
    return chief + jnp.concatenate([position, velocity])


def accel_hcw(state: Vector6, n: Scalar) -> Vector3:
    """Relative acceleration [m/s^2] of the Hill-Clohessy-Wiltshire equations, in RTN axes.

    Args:
        state: (6,) relative position and velocity in the rotating RTN frame [m, m/s].
        n: mean motion of the circular chief orbit [rad/s].

    Validity: circular chief, two-body gravity, separations small against the orbit radius.

    Source: Clohessy and Wiltshire (1960), J. Aerospace Sci. 27(9), 653, here in RTN order.
    """
    x, _, z, vx, vy, _ = state
    return jnp.stack([n * (3.0 * n * x + 2.0 * vy), -2.0 * n * vx, -(n * n) * z])


def stm_hcw(n: Scalar, dt: Scalar) -> Float[Array, "6 6"]:
    """State-transition matrix of `accel_hcw` over `dt` seconds.

    Args:
        n: mean motion [rad/s]; zero gives free drift, with finite gradients.
        dt: seconds, either sign.

    Source: closed-form solution, Alfriend et al., Spacecraft Formation Flying (2010), ch. 5; its differences such
    as n t - sin(n t), which cancel for short steps, are summed as series.
    """
    dtype = float_dtype(n, dt)
    n, t = jnp.asarray(n, dtype), jnp.asarray(dt, dtype)
    x = n * t
    s, c = jnp.sin(x), jnp.cos(x)
    c1, c2, c3 = _stumpff(x)
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    along = 2.0 * x * c2 * t
    rows = [
        [one + 3.0 * x * x * c2, zero, zero, c1 * t, along, zero],
        [-6.0 * x * x * x * c3, one, zero, -along, (4.0 * c1 - 3.0) * t, zero],
        [zero, zero, c, zero, zero, c1 * t],
        [3.0 * n * s, zero, zero, c, 2.0 * s, zero],
        [-6.0 * n * x * x * c2, zero, zero, -2.0 * s, 4.0 * c - 3.0, zero],
        [zero, zero, -n * s, zero, zero, c],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def _stumpff(x):
    """sin(x) / x, (1 - cos x) / x^2 and (x - sin x) / x^3, smooth through zero."""
    small = jnp.abs(x) < 0.5
    y = jnp.where(small, x * x, 0.0)
    big = jnp.where(small, 1.0, x)

    def series(first):  # sum of (-y)^k / (first + 2 k)! * first!, to rounding level below x = 0.5
        total = 1.0
        for k in range(5, 0, -1):
            total = 1.0 - y / ((first + 2 * k - 1) * (first + 2 * k)) * total
        return total

    c1 = jnp.where(small, series(1), jnp.sin(big) / big)
    c2 = jnp.where(small, 0.5 * series(2), 2.0 * (jnp.sin(0.5 * big) / big) ** 2)
    c3 = jnp.where(small, series(3) / 6.0, (big - jnp.sin(big)) / big**3)
    return c1, c2, c3
