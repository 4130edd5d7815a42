"""What is drawn anew for each episode: the vehicle and the station's orbit within their configured ranges."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_to_rotation_vector
from owm_envs.config.params import Params, RandomizationParams
from owm_envs.task.reset import isotropic, named_key

ELEMENTS = ("semi-major axis", "eccentricity", "inclination", "raan", "argument of perigee", "mean anomaly")


class Drawn(NamedTuple):
    """One episode's draws; factors multiply the configured numbers, the rest is added to them."""

    mass_scale: Float[Array, ""]
    inertia_scale: Float[Array, "3"]
    """Per body axis."""
    thrust_scale: Float[Array, "6"]
    """Per axis of the wrench."""
    misalignment: Float[Array, "3"]
    """Rotation vector, rad."""
    actuation_delay: Int[Array, ""]
    """Simulation steps."""
    chief_elements: Float[Array, "6"]
    """[m, -, rad, rad, rad, rad]."""


def draw(ranges: RandomizationParams, *, key: Key[Array, ""]) -> Drawn:
    """Draw one episode's numbers, uniformly within `ranges`, each under a key of its own."""
    dtype = ranges.mass_scale.dtype

    def uniform(name, bounds, shape=()):
        return jax.random.uniform(named_key(key, name), shape, dtype, bounds[0], bounds[1])

    delay = ranges.actuation_delay
    return Drawn(
        mass_scale=uniform("mass", ranges.mass_scale),
        inertia_scale=uniform("inertia", ranges.inertia_scale, (3,)),
        thrust_scale=uniform("thrust", ranges.thrust_scale, (6,)),
        misalignment=uniform("misalignment", ranges.misalignment)
        * isotropic(named_key(key, "misalignment axis"), dtype),
        actuation_delay=jax.random.randint(named_key(key, "delay"), (), delay[0], delay[1] + 1, jnp.int32),
        chief_elements=jnp.stack([uniform(f"chief {n}", r) for n, r in zip(ELEMENTS, ranges.chief_elements)]),
    )


def episode_params(params: Params, drawn: Drawn | None) -> Params:
    """The numbers of one episode: `params` as they are when nothing is drawn."""
    if drawn is None:
        return params
    chaser, chief = params.chaser, params.chief
    turn = quat_multiply(quat_from_rotation_vector(chaser.misalignment), quat_from_rotation_vector(drawn.misalignment))
    root = jnp.sqrt(drawn.inertia_scale)
    return params._replace(
        chaser=chaser._replace(
            mass=chaser.mass * drawn.mass_scale,
            # Both sides, so that an inertia with products stays symmetric and positive definite.
            inertia=root[:, None] * chaser.inertia * root[None],
            thrust_scale=chaser.thrust_scale * drawn.thrust_scale,
            misalignment=quat_to_rotation_vector(turn),
            actuation_delay=chaser.actuation_delay + drawn.actuation_delay,
        ),
        chief=chief._replace(elements=chief.elements + drawn.chief_elements),
    )
