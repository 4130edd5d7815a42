"""What the geodesic field tells a policy at a measured position."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from owm_envs.field import GeodesicField, cost_to_go
from owm_envs.view import View

FEATURES = 4
_LENGTH = 225.0
"""Metres by which the cost-to-go is divided: the scale of observed positions."""


@jax.jit
def field_features(field: GeodesicField, ports: Int[Array, "B"], positions: Float[Array, "B 3"]) -> Float[Array, "B 4"]:
    """Return the gradient of the cost-to-go (station frame) and the cost-to-go over 225 m.

    Args:
        field: geodesic field of all ports.
        ports: port of each slot.
        positions: measured, m, station frame.
    """

    def one(port: Array, position: Array) -> Array:
        phi, gradient = cost_to_go(field, port, position)
        return jnp.concatenate([gradient, phi[None] / _LENGTH])

    return jax.vmap(one)(ports, positions)


def with_field(
    field: GeodesicField, ports: Int[np.ndarray, "B"], views: Float[np.ndarray, "B 13"], observation: np.ndarray
) -> Float[np.ndarray, "B O+4"]:
    """Append the features of the measured views to observations (B, O)."""
    positions = np.asarray(View.of(views).position, np.float32)
    told = np.asarray(field_features(field, np.asarray(ports, np.int32), positions))
    return np.concatenate([observation, told], axis=1).astype(np.float32)
