"""What is believed of a vehicle's thrusters."""

from typing import NamedTuple

from jaxtyping import Array, Bool, Float

AXES = ("force x", "force y", "force z", "torque x", "torque y", "torque z")


class Health(NamedTuple):
    """What is believed of a vehicle's axes.

    Attributes:
        share: of what it was fitted to do that each axis of the wrench does: 1 of a sound one, 0 of a dead one.
        deviation: of that, one standard deviation.
        leak: acceleration that acts whatever is commanded, beyond the fit's: m/s2 and rad/s2, body axes.
        changed: whether the errors of its prediction showed a change in flight, by component of the leak.
    """

    share: Float[Array, "6"]
    deviation: Float[Array, "6"]
    leak: Float[Array, "6"]
    changed: Bool[Array, "6"]
