"""A policy that flies as visiting vehicles must: wherever its thrusters stop, it drifts clear of the station."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_rotate
from owm_envs.field.drift import drift_shortfall
from owm_envs.policies.base import Vehicle, goal_of, read_view
from owm_envs.policies.geodesic import body_wrench, field_speed, turn_towards
from owm_envs.task.events import safe_norm
from owm_envs.task.observation import Observation, ObservationLayout
from owm_envs.view import View

DRIFT_TIMES = np.concatenate([np.arange(4.0, 80.0, 4.0), np.arange(80.0, 361.0, 14.0)])
"""s without thrust at which the clearance is looked up."""
NEAR = 8.5
"""m between bounding sphere and hull. Nearer, whoever closes in at all drifts into the hull: there the chaser is slow
enough for a small impulse to lead it away."""
_MARGIN = 3.0
"""m of clearance that a drift keeps; more, up to `_STRIDE`, for what it moves between two looks."""
_STRIDE = 3.0
_WEIGHT, _CAP = 4.0, 4.0
"""1/s, m: what a metre of shortfall costs, in m/s of progress, and from where on more of it costs no more."""
_STEADY = 0.02
"""s/m: what a change of velocity costs."""
_FIRST_PART = 0.15
"""Of the way to a new velocity, as far as it comes in a moment: the drift from there must be clear, too."""
_TIME_CONSTANT = 2.0
"""s, of the velocity loop."""
_CORRIDOR = 5.0
"""m before the hold pose, where the last leg begins; its width is 0.6 m, and 0.4 m more a metre out."""
_CONTACT = 0.078
"""m/s: the closing speed at contact. The docking standard asks for 0.05 to 0.10 m/s."""


def sphere_directions(count: int) -> Float[np.ndarray, "K 3"]:
    """Unit vectors spread evenly over the sphere, on a Fibonacci spiral."""
    i = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1).astype(np.float32)


_DIRECTIONS = sphere_directions(64)
_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DockSafePolicy:
    """Dock with a way out at every moment: from afar a drift of 360 s clears the hull, near it all is slow.

    It is given the station's hull by way of `field`, and the orbit's rate. Beyond `NEAR` it looks at velocities in 65
    directions at two speeds, and takes the one of most progress down the geodesic cost-to-go whose free drift keeps
    clear of the hull. So it passes by, beside the port, and turns in late. Nearer it follows the cost-to-go at no more
    than 0.2 m/s + 0.12 / s of clearance. The last 5 m lead straight down the port's axis, to a contact at 0.078 m/s;
    off the axis the chaser holds back.

    Chosen on the nominal starts of `owm.scores.docking.trials(per_port=3, seed=501)`.
    """

    vehicle: Vehicle
    field: Any
    """A `GeodesicField`."""
    rows: Int[Array, "8"]
    """Its row of each port, -1 where it has none: there the action is not finite, which ends the episode."""
    drift: Float[Array, "T 3 6"]
    """From `drift_matrices` at `DRIFT_TIMES`."""
    layout: ObservationLayout = field(metadata=_STATIC)
    name: str = field(default="dock-safe", metadata=_STATIC)

    def init(self, key: Key[Array, ""], port: Int[Array, ""]) -> Int[Array, ""]:
        """State: the port."""
        return jnp.asarray(port, jnp.int32)

    def act(self, state: Int[Array, ""], observation: Observation) -> tuple[Float[Array, "6"], Int[Array, ""]]:
        """Track the velocity that is safe here."""
        view = read_view(self.layout, observation)
        accel = (self.wanted_velocity(state, view) - view.velocity) / _TIME_CONSTANT
        return self.layout.action(body_wrench(self.vehicle, view, accel, turn_towards(state, view))), state

    def wanted_velocity(self, port: Int[Array, ""], view: View) -> Float[Array, "3"]:
        """The velocity to fly at, m/s, station frame."""
        speed, gradient, gap = field_speed(self.field, self.rows, port, view.position)
        lacking = jnp.isnan(speed)
        speed = jnp.minimum(speed, 0.2 + 0.12 * jnp.maximum(gap, 0))
        down = -gradient / jnp.maximum(safe_norm(gradient), 1e-6)
        wanted = jnp.where(gap > NEAR, self._passing_by(view, speed, down), speed * down)
        last, velocity = _last_leg(port, view)
        return jnp.where(lacking, jnp.nan, jnp.where(last, velocity, wanted))

    def _passing_by(self, view: View, speed: Float[Array, ""], down: Float[Array, "3"]) -> Float[Array, "3"]:
        """The velocity of most progress whose drift keeps clear; where none does, the one that falls least short."""
        dtype = view.position.dtype
        directions = jnp.concatenate([down[None], jnp.asarray(_DIRECTIONS, dtype)])
        velocities = jnp.concatenate([speed * directions, 0.5 * speed * directions])
        strides = jnp.asarray(np.diff(DRIFT_TIMES, prepend=0.0), dtype)

        def short(velocity):
            margins = _MARGIN + jnp.minimum(0.5 * safe_norm(velocity) * strides, _STRIDE)
            return drift_shortfall(self.field, jnp.asarray(self.drift, dtype), margins, view.position, velocity)

        def score(velocity):
            change = velocity - view.velocity
            lost = jnp.minimum(short(velocity) + short(view.velocity + _FIRST_PART * change), _CAP)
            return jnp.sum(velocity * down) - _WEIGHT * lost - _STEADY * jnp.sum(change * change)

        return velocities[jnp.argmax(jax.vmap(score)(velocities))]


def _last_leg(port: Int[Array, ""], view: View) -> tuple[Array, Float[Array, "3"]]:
    """Whether the chaser is on the last leg, and the velocity there: along the axis, and back to it."""
    position, attitude = goal_of(port, view.position.dtype)
    outwards = -quat_rotate(attitude, jnp.asarray([0.0, 0.0, 1.0], position.dtype))
    offset = view.position - position
    axial = jnp.sum(offset * outwards)
    aside = offset - axial * outwards
    lateral = safe_norm(aside)
    ahead = jnp.maximum(axial, 0)
    on_it = (safe_norm(offset) < _CORRIDOR) & (lateral < 0.6 + 0.4 * ahead)
    closing = jnp.clip(jnp.abs(axial) / 8.0, _CONTACT, 0.6)
    closing = closing * jnp.clip(1.5 - lateral / (0.08 + 0.12 * ahead), -0.3, 1.0)
    closing = jnp.where(axial < -0.05, -0.05, closing)
    back = jnp.minimum(lateral / 4.0, 0.3)
    return on_it, -closing * outwards - back * aside / jnp.maximum(lateral, 1e-6)
