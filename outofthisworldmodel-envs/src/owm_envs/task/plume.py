"""Plumes on the hull: what jets blow at it near by comes back and pushes the chaser away.

A jet's density falls with the angle off its axis as cos^k, k = 2 / (g - 1) with g the ratio of specific heats (Simons
(1972), AIAA Journal 10, 1534, with a limiting angle of a quarter turn). Here k = 7, so g = 1.29. A jet is six plumes,
one against the force along each body axis. Of each, the share that the hull throws back falls with the clearance d as
(D / (D + d))^2: the source flow's 1/r^2, held finite at contact. The push is along the way from the nearest point of
the hull, and through the centre of mass.

A model of size and shape, not of flow: one flat piece of hull, no shadows, no torque. Nothing pushes the station, and
nothing other than the nearest box throws back. Its strength is a parameter, not computed from a nozzle.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax.attitude import quat_conjugate, quat_rotate
from owm_envs.config.params import ChaserParams
from owm_envs.task.collision import nearest_point
from owm_envs.task.events import safe_norm
from owm_envs.view import View


class NearHull(NamedTuple):
    """How the nearest piece of hull throws plumes back."""

    away: Float[Array, "3"]
    """Unit vector from the hull to the chaser, body axes; zero inside."""
    share: Float[Array, ""]
    """Of the thrust of a jet straight at the hull."""


def near_hull(chaser: ChaserParams, view: Float[Array, "13"], boxes: Float[Array, "N 2 3"]) -> NearHull:
    """What of the hull is nearest to a chaser at a relative view (SI units); boxes in m, station frame."""
    now = View.of(view)
    apart = now.position - nearest_point(now.position, boxes)
    distance = safe_norm(apart)
    away = apart / jnp.maximum(distance, 1e-6)
    strength, reach = chaser.plume
    fall = reach / (reach + jnp.maximum(distance - chaser.radius, 0))
    return NearHull(quat_rotate(quat_conjugate(now.attitude), away), strength * fall**2)


def thrown_back(near: NearHull, wrench: Float[Array, "6"]) -> Float[Array, "6"]:
    """The push of the thrusters' plumes on the chaser itself, N and N m, body axes.

    Args:
        wrench: of the thrusters, N and N m, body axes.
    """
    # A force away from the hull comes of a jet towards it; cos^7 of its axis.
    at_hull = jnp.sum(jnp.maximum(wrench[:3] * near.away, 0) * near.away**6)
    return jnp.concatenate([near.share * at_hull * near.away, jnp.zeros_like(wrench[3:])])
