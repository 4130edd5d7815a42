"""What is drawn anew for each episode: the vehicle and the station's orbit within their configured ranges."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_to_rotation_vector
from owm_envs.config import DockingConfig
from owm_envs.config.params import Params, RandomizationParams
from owm_envs.config.parts import RandomizationConfig
from owm_envs.task.reset import isotropic, named_key

ELEMENTS = ("semi-major axis", "eccentricity", "inclination", "raan", "argument of perigee", "mean anomaly")


VARIATIONS: dict[str, tuple[str, ...]] = {
    "vehicle": ("mass_scale", "inertia_scale", "thrust_scale", "misalignment", "actuation_delay"),
    "fault": ("fault",),
    "target": ("target_rate",),
    "orbit": ("chief_elements",),
    "light": ("sun_scale", "earthshine_scale", "lamp_scale"),
    "camera": ("exposure", "offset", "tilt", "field_scale"),
    "material": ("albedo_scale",),
}
"""What may be drawn anew at a reset by itself: fields of `Drawn` and of what sensors draw."""


class DrawnFault(NamedTuple):
    """What a fault has of its own in one episode; the time is added to the configured one, the factors multiply."""

    time: Float[Array, ""]
    """s."""
    thrust_scale: Float[Array, "6"]
    misalignment: Float[Array, "3"]
    """Rotation vector, rad."""


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
    target_rate: Float[Array, "3"] | None
    """rad/s, in the target's axes; None where it never turns."""
    chief_elements: Float[Array, "6"]
    """[m, -, rad, rad, rad, rad]."""
    fault: DrawnFault | None
    """None where thrusters never fail."""


def draw(ranges: RandomizationParams, *, faulty: bool = False, turning: bool = False, key: Key[Array, ""]) -> Drawn:
    """Draw one episode's numbers, uniformly within `ranges`, each under a key of its own.

    Args:
        faulty: whether to draw a fault.
        turning: whether to draw the target's rate.
    """
    dtype = ranges.mass_scale.dtype

    def uniform(name, bounds, shape=()):
        return jax.random.uniform(named_key(key, name), shape, dtype, bounds[0], bounds[1])

    def turn(name, bounds):
        return uniform(name, bounds) * isotropic(named_key(key, f"{name} axis"), dtype)

    def fault():
        axis = jax.random.randint(named_key(key, "fault axis"), (), 0, 3)
        left = uniform("fault scale", ranges.fault_scale)
        return DrawnFault(
            time=uniform("fault time", ranges.fault_time),
            thrust_scale=jnp.where(jnp.arange(6) == axis, left, jnp.ones((), dtype)),
            misalignment=turn("fault misalignment", ranges.fault_misalignment),
        )

    delay = ranges.actuation_delay
    return Drawn(
        mass_scale=uniform("mass", ranges.mass_scale),
        inertia_scale=uniform("inertia", ranges.inertia_scale, (3,)),
        thrust_scale=uniform("thrust", ranges.thrust_scale, (6,)),
        misalignment=turn("misalignment", ranges.misalignment),
        actuation_delay=jax.random.randint(named_key(key, "delay"), (), delay[0], delay[1] + 1, jnp.int32),
        target_rate=turn("target rate", ranges.target_rate) if turning else None,
        chief_elements=jnp.stack([uniform(f"chief {n}", r) for n, r in zip(ELEMENTS, ranges.chief_elements)]),
        fault=fault() if faulty else None,
    )


def episode_params(params: Params, drawn: Drawn | None) -> Params:
    """The numbers of one episode: `params` as they are when nothing is drawn."""
    if drawn is None:
        return params
    chaser, chief, fault = params.chaser, params.chief, params.chaser.fault
    if drawn.fault is not None:
        fault = fault._replace(
            time=fault.time + drawn.fault.time,
            thrust_scale=fault.thrust_scale * drawn.fault.thrust_scale,
            misalignment=_one_turn(fault.misalignment, drawn.fault.misalignment),
        )
    root = jnp.sqrt(drawn.inertia_scale)
    return params._replace(
        chaser=chaser._replace(
            mass=chaser.mass * drawn.mass_scale,
            # Both sides, so that an inertia with products stays symmetric and positive definite.
            inertia=root[:, None] * chaser.inertia * root[None],
            thrust_scale=chaser.thrust_scale * drawn.thrust_scale,
            misalignment=_one_turn(chaser.misalignment, drawn.misalignment),
            actuation_delay=chaser.actuation_delay + drawn.actuation_delay,
            fault=fault,
        ),
        target_rate=params.target_rate + (0 if drawn.target_rate is None else drawn.target_rate),
        chief=chief._replace(elements=chief.elements + drawn.chief_elements),
    )


def _one_turn(first: Float[Array, "3"], second: Float[Array, "3"]) -> Float[Array, "3"]:
    """The rotation vector of the product of two."""
    return quat_to_rotation_vector(quat_multiply(*map(quat_from_rotation_vector, (first, second))))


def named_draws(drawn: Drawn) -> dict[str, Array]:
    """Every draw by its name, those of a fault as `fault_time` and so on."""
    named = drawn._asdict()
    fault = named.pop("fault")
    named |= {} if fault is None else {f"fault_{name}": value for name, value in fault._asdict().items()}
    return {name: value for name, value in named.items() if value is not None}


def drawable(config: DockingConfig) -> list[str]:
    """Those of `VARIATIONS` for which a range is configured."""

    def flat(ranges: RandomizationConfig) -> dict[str, Any]:
        values = dict(ranges)
        values |= dict(values.pop("camera"))
        return {name.removesuffix("_deg"): value for name, value in values.items()}

    given, default = flat(config.randomization), flat(RandomizationConfig())
    moved = {name for name in given if given[name] != default[name]}
    moved = {"chief_elements" if name.startswith("chief_") else name for name in moved}
    moved = {"fault" if name.startswith("fault_") else name for name in moved}
    return [group for group, fields in VARIATIONS.items() if moved & set(fields)]


def drawn_anew(fresh: Any, before: Any, anew: Mapping[str, Bool[Array, ""]]) -> Any:
    """Draws of an episode of which some stay as they were: a NamedTuple, or None without any.

    Args:
        anew: of each of `VARIATIONS` whether it is drawn anew.
    """
    if fresh is None:
        return None
    of = {field: group for group, fields in VARIATIONS.items() for field in fields}

    def choose(name, new, old):
        return jax.tree.map(lambda a, b: jnp.where(anew[of[name]], a, b), new, old)

    return fresh._replace(**{name: choose(name, new, getattr(before, name)) for name, new in fresh._asdict().items()})
