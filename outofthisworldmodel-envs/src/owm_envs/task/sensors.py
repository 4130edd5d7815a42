"""What a sensor is, and how its measurements become parts of an observation."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from owm_envs.config.params import Params
from owm_envs.dynamics.state import PhysicalState
from owm_envs.task.reset import named_key
from owm_envs.view import View
from owm_envs.words import require_parts

STATE = "state"
"""The part that every observation has: what relative navigation measures, laid out by `ObservationLayout`."""


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
    """Of this episode's sensor errors, the same at every instant: for `standard_normal(stream, count, ...)` alone."""


class Measurement(NamedTuple):
    """What a sensor that may miss returns: a value, and whether there is one."""

    value: Array
    valid: Bool[Array, ""]


class Sensor(Protocol):
    """One part of an observation; static and hashable, as a frozen dataclass without arrays is.

    Between its instants, and where it misses, its last value is held; there are zeros before the first. A sensor that
    may do either has a second part beside it, `NAME_valid`: whether the value was measured at this very instant.
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


def part_shapes(sensors: Sequence[Sensor]) -> dict[str, jax.ShapeDtypeStruct]:
    """Shape and dtype of each part that the sensors bring, by its name."""
    shapes = {}
    for sensor in sensors:
        shapes[sensor.name] = jax.ShapeDtypeStruct(tuple(sensor.shape) or (1,), np.dtype(sensor.dtype))
        if holds(sensor):
            shapes[valid_name(sensor)] = jax.ShapeDtypeStruct((1,), np.dtype(bool))
    return shapes


def blank(sensors: Sequence[Sensor]) -> dict[str, Array]:
    """The parts before anything was measured: zeros."""
    return {name: jnp.zeros(part.shape, part.dtype) for name, part in part_shapes(sensors).items()}


def sense(
    sensors: Sequence[Sensor], held: Mapping[str, Array], truth: Truth, *, key: Key[Array, ""]
) -> dict[str, Array]:
    """What the sensors show at an instant.

    Args:
        held: what they showed at the last one.
        key: of all their measurements at this instant.

    Raises:
        ValueError: a measurement is not of the shape and dtype that its sensor declares.
    """
    shapes, parts = part_shapes(sensors), {}
    for sensor in sensors:
        measured = sensor.measure(named_key(key, sensor.name), truth)
        if isinstance(measured, Measurement) != sensor.may_miss:
            raise ValueError(
                f"sensor {sensor.name!r} must return {'a Measurement' if sensor.may_miss else 'an array'}, as its "
                f"may_miss={sensor.may_miss} says, got {type(measured).__name__}"
            )
        value, valid = measured if sensor.may_miss else (measured, True)
        value, declared = jnp.asarray(value), shapes[sensor.name]
        if value.dtype != declared.dtype or value.shape != tuple(sensor.shape):
            raise ValueError(
                f"sensor {sensor.name!r} declares {tuple(sensor.shape)} {declared.dtype}, "
                f"but measures {value.shape} {value.dtype}"
            )
        value = value.reshape(declared.shape)
        if holds(sensor):
            fresh = valid & (truth.count % sensor.every == 0)
            value = jnp.where(fresh, value, held[sensor.name])
            parts[valid_name(sensor)] = jnp.reshape(fresh, (1,))
        parts[sensor.name] = value
    return parts
