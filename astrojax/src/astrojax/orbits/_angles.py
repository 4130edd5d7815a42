"""Angles brought into one turn."""

import jax.numpy as jnp

from astrojax._types import FloatScalar

TURN = 6.283185307179586


def nearest(angle: FloatScalar) -> FloatScalar:
    """The angle [rad] less whole turns, from -pi to pi."""
    return angle - TURN * jnp.round(angle / TURN)


def positive(angle: FloatScalar) -> FloatScalar:
    """The angle [rad] less whole turns, from 0 to 2 pi."""
    return angle - TURN * jnp.floor(angle / TURN)


def unsigned(angle: FloatScalar) -> FloatScalar:
    """An angle of atan2 [rad], from -pi to pi, moved to [0, 2 pi)."""
    return jnp.where(angle < 0, angle + TURN, angle)
