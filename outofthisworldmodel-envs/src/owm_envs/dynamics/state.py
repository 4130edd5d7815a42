"""The physical state shared by all fidelities."""

from typing import NamedTuple

from jaxtyping import Array, Float, PyTree


class VehicleState(NamedTuple):
    """A rigid vehicle: orbit [r m, v m/s], scalar-first attitude quaternion from body axes, body rate rad/s.

    Orbit is relative to the station. The frame of orbit, attitude and rate is the fidelity's own: inertial axes for
    `iss-numerical`, the station frame for the others.
    """

    orbit: Float[Array, "6"]
    attitude: Float[Array, "4"]
    rate: Float[Array, "3"]


class PhysicalState(NamedTuple):
    """Both vehicles at one instant.

    `epoch` is the episode's start [MJD day, s of day] UTC and `elapsed` the seconds since; `chief` is the station's
    inertial orbit, of length zero where the fidelity does not propagate it. `lost` is what rounding has taken from
    `elapsed`, `chief` and `chaser` so far where the fidelity makes up for it, None elsewhere.
    """

    epoch: Float[Array, "2"]
    elapsed: Float[Array, ""]
    chief: Float[Array, "C"]
    chaser: VehicleState
    lost: PyTree | None = None
