"""What a force is: one frozen class, and the difference of two accelerations it makes."""

import dataclasses
from typing import Any, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp

from astrojax._types import Matrix3, Scalar, Vector3
from astrojax.forces.environment import Environment
from astrojax.forces.spacecraft import Spacecraft

Traced = Any
"""A number or array that may be swept; not checked, since tree operations put anything in its place."""

T = TypeVar("T")


def force(cls: type[T]) -> type[T]:
    """Class decorator: a frozen dataclass that is a pytree of its fields, but for those made by `static`."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True, eq=False)(cls))


def static(**options: Any) -> Any:
    """A dataclass field that is part of the compiled program: a degree, a name or a switch."""
    return dataclasses.field(metadata={"static": True}, **options)


@runtime_checkable
class Force(Protocol):
    """What accelerates a spacecraft.

    Besides, a force may have one of two methods from which `relative_acceleration` follows better than by subtraction.
    Where an exact difference of two accelerations exists,

        relative(t, r, v, rho, rho_dot, chief, spacecraft, environment) -> (3,)

    is the acceleration of `spacecraft` at r + rho less that of `chief` at r (velocities v + rho_dot and v). Where the
    acceleration depends on the position alone,

        acceleration_field(environment) -> function from r (3,) to (3,)

    gives it, for `field_difference`.
    """

    needs: frozenset[str]
    """Which of the environment's quantities it reads: "sun", "moon", a planet, "rotation", "epoch", "weather"."""

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration (3,) [m/s^2] at position r [m] and velocity v [m/s] about the central body."""


def relative_acceleration(
    force: Force,
    t: Scalar,
    r: Vector3,
    v: Vector3,
    rho: Vector3,
    rho_dot: Vector3,
    chief: Spacecraft,
    spacecraft: Spacecraft,
    environment: Environment,
) -> Vector3:
    """Acceleration [m/s^2] of a vehicle less that of a chief nearby: as good as the force can tell it.

    Args:
        force: either kind.
        t: handed to the force.
        r, v: (3,) inertial position and velocity of the chief [m, m/s].
        rho, rho_dot: (3,) those of the vehicle less the chief's.
        chief, spacecraft: what the force acts on, at r and at r + rho.
        environment: what the force needs to know.
    """
    if hasattr(force, "relative"):
        return force.relative(t, r, v, rho, rho_dot, chief, spacecraft, environment)
    if hasattr(force, "acceleration_field"):
        return field_difference(force.acceleration_field(environment), r, rho)
    own = force.accel(t, r + rho, v + rho_dot, spacecraft, environment)
    return own - force.accel(t, r, v, chief, environment)


def field_difference(field: Any, r: Vector3, rho: Vector3) -> Vector3:
    """field(r + rho) - field(r) for a smooth acceleration of position alone.

    Validity: float64 subtracts. In float32, where the difference would be lost, it is expanded about the middle of the
    two, with an error of third order in |rho| / |r|.
    """
    if r.dtype == jnp.float64:
        return field(r + rho) - field(r)
    return jax.jvp(field, (r + 0.5 * rho,), (rho,))[1]


def turned(rotation: Matrix3, a: Vector3) -> Vector3:
    """rotation @ a, written out: XLA fuses it where a batched product of matrices would be a call."""
    return jnp.stack([rotation[i, 0] * a[0] + rotation[i, 1] * a[1] + rotation[i, 2] * a[2] for i in range(3)])


def turned_back(rotation: Matrix3, a: Vector3) -> Vector3:
    """rotation.T @ a, written out."""
    return jnp.stack([rotation[0, i] * a[0] + rotation[1, i] * a[1] + rotation[2, i] * a[2] for i in range(3)])
