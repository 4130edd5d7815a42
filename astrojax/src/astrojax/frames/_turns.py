"""Rotations about the axes, applied without a product of matrices, and states in frames that turn."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from astrojax import constants as c
from astrojax._types import FloatScalar, Matrix3, Scalar, Vector6


def turn_x(angle: FloatScalar, m: Array) -> Array:
    """What `m` is in axes that are turned by `angle` [rad] about x."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([m[0], cos * m[1] + sin * m[2], cos * m[2] - sin * m[1]])


def turn_y(angle: FloatScalar, m: Array) -> Array:
    """What `m` is in axes that are turned by `angle` [rad] about y."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * m[0] - sin * m[2], m[1], sin * m[0] + cos * m[2]])


def turn_z(angle: FloatScalar, m: Array) -> Array:
    """What `m` is in axes that are turned by `angle` [rad] about z."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * m[0] + sin * m[1], cos * m[1] - sin * m[0], m[2]])


def with_rate(
    rotation: Callable[[FloatScalar, FloatScalar], Matrix3],
    seconds: Scalar,
    ut1_minus_utc: FloatScalar,
    length_of_day: FloatScalar,
) -> tuple[Matrix3, Matrix3]:
    """A rotation that goes with the Earth, and its derivative by time [1/s].

    Args:
        rotation: gives it from the seconds of day, UTC, and UT1 - UTC.
        seconds, ut1_minus_utc: now [s].
        length_of_day: excess over 86400 s [s], by which UT1 - UTC falls in a day.
    """
    dtype = ut1_minus_utc.dtype
    rates = jnp.ones((), dtype), -length_of_day / c.SECONDS_PER_DAY
    return jax.jvp(rotation, (jnp.asarray(seconds, dtype), ut1_minus_utc), rates)


def into_turning(rotation: Matrix3, rate: Matrix3, state: Vector6) -> Vector6:
    """Position and velocity, as seen from axes that turn, of a state in axes at rest."""
    return jnp.concatenate([rotation @ state[:3], rotation @ state[3:] + rate @ state[:3]])


def out_of_turning(rotation: Matrix3, rate: Matrix3, state: Vector6) -> Vector6:
    """Position and velocity in axes at rest of a state as seen from axes that turn: the inverse of `into_turning`."""
    position = rotation.T @ state[:3]
    return jnp.concatenate([position, rotation.T @ (state[3:] - rate @ position)])
