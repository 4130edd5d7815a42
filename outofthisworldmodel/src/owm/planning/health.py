"""What is believed of a vehicle's thrusters."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

AXES = ("force x", "force y", "force z", "torque x", "torque y", "torque z")


class Health(NamedTuple):
    """What is believed of a vehicle's axes.

    Attributes:
        share: of what it was fitted to do that each axis of the wrench does when commanded backwards and forwards: 1 of
            a sound one, 0 of a dead one.
        deviation: of that, one standard deviation.
        leak: acceleration that acts whatever is commanded, beyond the fit's: m/s2 and rad/s2, body axes.
        alarms: how often the errors of its prediction showed a change in flight, by component of the leak.
    """

    share: Float[Array, "6 2"]
    deviation: Float[Array, "6"]
    leak: Float[Array, "6"]
    alarms: Float[Array, "6"]


_LEAST, _SURELY = 0.45, 0.75
"""Share of a direction that counts for nothing, if it is less than the second with 95 % confidence."""


def usable(health: Health) -> Float[Array, "6"]:
    """Return 0 for axes of force that push one way at most, 1 for all others: they are to be left alone."""
    return jnp.where(_out(health) & (jnp.arange(6) < 3), 0.0, 1.0).astype(health.share.dtype)


def may_dock(health: Health) -> Bool[Array, ""]:
    """Return whether enough is left to dock with: two axes of force, all three of torque. Else the planner leaves."""
    out = _out(health)
    return (jnp.sum(out[:3]) < 2) & ~jnp.any(out[3:])


def _out(health: Health) -> Bool[Array, "6"]:
    """Which axes push one way at most."""
    least = jnp.min(health.share, axis=-1)
    return (least < _LEAST) & (least + 2 * health.deviation < _SURELY)
