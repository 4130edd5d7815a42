"""What a sensor is, and how its measurements become parts of an observation."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from owm_envs.config.params import Params
from owm_envs.dynamics.state import PhysicalState
from owm_envs.task.reset import named_key
from owm_envs.task.selected import apply_where
from owm_envs.view import View
from owm_envs.words import require_parts

STATE = "state"
"""The part that every observation has: what relative navigation measures, laid out by `ObservationLayout`."""


STATE_VALID = "state_valid"
"""Beside it where relative navigation may go quiet: whether it was measured at this very instant, shape (1,)."""


TARGET_RATE = "target_rate"
"""Of a target that turns: its rate, rad/s in its own axes, shape (3,)."""


class Truth(NamedTuple):
    """The truth at one instant of one episode: all that a sensor may look at."""

    params: Params
    """This episode's own numbers, drawn ones included."""
    view: View
    """True relative view."""
    epoch: Float[Array, "2"]
    """UTC: [MJD day, s of day]."""
    port: Int[Array, ""]
    """Index of the assigned port."""
    count: Int[Array, ""]
    """Decisions so far."""
    physics: PhysicalState
    """The fidelity's own state: the orbit of the station, where there is one."""
    bias: Float[Array, "4 3"] | None
    """Time-correlated error of relative navigation, of unit variance; None without."""
    stream: Key[Array, ""]
    """Of this episode's sensor errors, the same at every instant: for `standard_normal(stream, count, ...)`, and for
    streams of names of their own."""
    orbit: Float[Array, "6"] | None = None
    """The station's position and velocity [m, m/s] in inertial axes; None but for a sensor with `needs_orbit`."""
    drawn: PyTree = None
    """What the sensor's own `draw` drew for this episode; None without."""


class Measurement(NamedTuple):
    """What a sensor that may miss returns: a value, and whether there is one."""

    value: Array
    valid: Bool[Array, ""]


class Sensor(Protocol):
    """One part of an observation; static and hashable, as a frozen dataclass without arrays is.

    Between its instants, and where it misses, its last value is held; there are zeros before the first. A sensor that
    may do either has a second part beside it, `NAME_valid`: whether the value was measured at this very instant.

    What only some sensors have, and others leave out:
        costly: whether to measure only where due, in a batch too, and without gradient. Such a sensor has no second
            part: how many decisions ago its value was measured stands in `info` as `NAME_age`.
        needs_orbit: whether it looks at `truth.orbit`.
        default_params(): its numbers, a pytree of arrays; `truth.params.sensors[name]` when it measures.
        draw(own, key): from these numbers, what it draws for an episode: a NamedTuple, `truth.drawn` when it measures.
    """

    name: str
    """Of the part: a Python identifier."""
    shape: tuple[int, ...]
    """Of one measurement; () becomes (1,)."""
    dtype: str
    """Of one measurement: "float32", "uint8", ..."""
    every: int
    """Decisions from one measurement to the next; the first is that of the start."""
    may_miss: bool
    """Whether `measure` returns a `Measurement`."""

    def measure(self, key: Key[Array, ""], truth: Truth) -> Array | Measurement:
        """Measure: pure, for one episode.

        Args:
            key: of this measurement alone.
            truth: at this instant.
        """


def require_sensors(sensors: Sequence[Any]) -> tuple[Sensor, ...]:
    """The sensors as a tuple.

    Raises:
        TypeError: one lacks something that a `Sensor` has, or cannot be hashed.
        ValueError: a name is no identifier or taken, or `every` is less than 1.
    """
    sensors = tuple(sensors)
    taken: set[str] = set()
    for sensor in sensors:
        names = ("name", "shape", "dtype", "every", "may_miss", "measure")
        require_parts("sensors", "Sensors (owm_envs.task.sensors)", sensor, names)
        if not (isinstance(sensor.name, str) and sensor.name.isidentifier()):
            raise ValueError(f"a sensor's name must be a Python identifier, got {sensor.name!r}")
        names = {sensor.name, valid_name(sensor)}
        if names & taken:
            raise ValueError(f"two parts of the observation are called {sorted(names & taken)[0]!r}")
        taken |= names
        if sensor.every < 1:
            raise ValueError(f"every must be at least 1 decision, got {sensor.every} of sensor {sensor.name!r}")
    return sensors


def valid_name(sensor: Sensor) -> str:
    """What the part is called that tells whether a sensor's value was measured at this instant."""
    return f"{sensor.name}_valid"


def holds(sensor: Sensor) -> bool:
    """Whether there are instants without a measurement."""
    return sensor.every > 1 or sensor.may_miss


def is_costly(sensor: Sensor) -> bool:
    """Whether a sensor measures only where it is due."""
    return getattr(sensor, "costly", False)


def age_name(sensor: Sensor) -> str:
    """What is told in `info` of how many decisions ago a costly sensor measured what it shows."""
    return f"{sensor.name}_age"


def own_params(sensors: Sequence[Sensor]) -> dict[str, PyTree]:
    """The numbers of those sensors that have any, by name."""
    return {sensor.name: sensor.default_params() for sensor in sensors if hasattr(sensor, "default_params")}


def own_draws(sensors: Sequence[Sensor], params: Params, *, key: Key[Array, ""]) -> dict[str, PyTree]:
    """What sensors draw for an episode, by name; nothing of those that draw nothing."""
    draws = {}
    for sensor in sensors:
        drawn = (
            sensor.draw(params.sensors.get(sensor.name), named_key(key, sensor.name))
            if hasattr(sensor, "draw")
            else None
        )
        if drawn is not None:
            draws[sensor.name] = drawn
    return draws


def part_shapes(sensors: Sequence[Sensor]) -> dict[str, jax.ShapeDtypeStruct]:
    """Shape and dtype of each part that the sensors bring, by its name."""
    shapes = {}
    for sensor in sensors:
        shapes[sensor.name] = jax.ShapeDtypeStruct(tuple(sensor.shape) or (1,), np.dtype(sensor.dtype))
        if holds(sensor) and not is_costly(sensor):
            shapes[valid_name(sensor)] = jax.ShapeDtypeStruct((1,), np.dtype(bool))
    return shapes


def blank(sensors: Sequence[Sensor]) -> dict[str, Array]:
    """The parts before anything was measured: zeros, and so are the ages of what costly sensors show."""
    parts = {name: jnp.zeros(part.shape, part.dtype) for name, part in part_shapes(sensors).items()}
    return parts | {age_name(sensor): jnp.zeros((), jnp.int32) for sensor in sensors if is_costly(sensor)}


def sense(
    sensors: Sequence[Sensor],
    held: Mapping[str, Array],
    truth: Truth,
    *,
    key: Key[Array, ""],
    orbit: Callable[[Truth], Float[Array, "6"]],
    drawn: Mapping[str, PyTree],
    running: Bool[Array, ""] | bool = True,
) -> dict[str, Array]:
    """What the sensors show at an instant, and how old it is where they are costly.

    Args:
        held: what they showed at the last one.
        key: of all their measurements at this instant.
        orbit: gives `truth.orbit`, for those that need it.
        drawn: what they drew for this episode, by name.
        running: whether the episode was when the decision was taken; costly sensors measure nothing after its end.

    Raises:
        ValueError: a measurement is not of the shape and dtype that its sensor declares.
    """
    parts = {}
    for sensor in sensors:
        name, own = sensor.name, named_key(key, sensor.name)
        seen = truth._replace(drawn=drawn.get(name))
        due = truth.count % sensor.every == 0
        if is_costly(sensor):
            due = due & running
            parts[name], fresh = _only_where_due(sensor, due, held[name], own, seen, orbit)
            age = held[age_name(sensor)]
            parts[age_name(sensor)] = jnp.where(fresh, 0, jnp.where(running, age + 1, age)).astype(jnp.int32)
            continue
        value, valid = _measured(sensor, own, seen, orbit)
        if holds(sensor):
            fresh = valid & due
            value = jnp.where(fresh, value, held[name])
            parts[valid_name(sensor)] = jnp.reshape(fresh, (1,))
        parts[name] = value
    return parts


def _measured(sensor, key, truth, orbit) -> tuple[Array, Array | bool]:
    """A checked measurement in the shape of its part, and whether there is one."""
    if getattr(sensor, "needs_orbit", False):
        truth = truth._replace(orbit=orbit(truth))
    measured = sensor.measure(key, truth)
    if isinstance(measured, Measurement) != sensor.may_miss:
        raise ValueError(
            f"sensor {sensor.name!r} must return {'a Measurement' if sensor.may_miss else 'an array'}, as its "
            f"may_miss={sensor.may_miss} says, got {type(measured).__name__}"
        )
    value, valid = measured if sensor.may_miss else (measured, True)
    value, declared = jnp.asarray(value), part_shapes([sensor])[sensor.name]
    if value.dtype != declared.dtype or value.shape != tuple(sensor.shape):
        raise ValueError(
            f"sensor {sensor.name!r} declares {tuple(sensor.shape)} {declared.dtype}, "
            f"but measures {value.shape} {value.dtype}"
        )
    return value.reshape(declared.shape), valid


def _only_where_due(sensor, due, held, key, truth, orbit) -> tuple[Array, Bool[Array, ""]]:
    """What a costly sensor shows, and whether it is fresh.

    `vmap` would turn a condition into measuring everywhere. So a batch goes through a loop of its own, over those of
    its members that are due.
    """

    def fresh(held, key, truth):
        value, valid = _measured(sensor, key, truth, orbit)
        valid = jnp.asarray(valid)
        return jnp.where(valid, value, held), valid

    @custom_vmap
    def show(due, held, key, truth):
        return jax.lax.cond(due, lambda: fresh(held, key, truth), lambda: (held, jnp.zeros((), bool)))

    @show.def_vmap
    def _(size, batched, due, held, key, truth):
        wide = lambda array: jnp.broadcast_to(array, (size, *jnp.shape(array)))
        due, held = (array if own else wide(array) for array, own in zip((due, held), batched[:2]))
        leaves, tree = jax.tree.flatten((key, truth))
        own = jax.tree.leaves(batched[2:])

        def one(held, *mine):
            mine = iter(mine)
            return fresh(held, *tree.unflatten([next(mine) if its else leaf for leaf, its in zip(leaves, own)]))

        mine = [leaf for leaf, its in zip(leaves, own) if its]
        shown = apply_where(due, one, (held, jnp.zeros(size, bool)), held, *mine, chunk=chunk_of_costly())
        return shown, (True, True)

    return show(due, *jax.lax.stop_gradient((held, key, truth)))


def chunk_of_costly() -> int | None:
    """How many members of a batch a costly sensor measures at a time, as `apply_where` takes it.

    On a CPU one by one: about half as fast as 64 at a time, but none for nothing, and no batch changes a rounding.
    """
    return None if jax.default_backend() == "cpu" else 64
