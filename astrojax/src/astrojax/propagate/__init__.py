"""Numerical integration of any pytree: fixed steps, steps to a tolerance, dense output, events, derivatives."""

from astrojax.propagate.adaptive import (
    NOT_FINITE,
    STEP_TOO_SMALL,
    SUCCESS,
    TOO_MANY_STEPS,
    Solution,
    integrate,
)
from astrojax.propagate.dense import Trajectory, interpolate, trajectory
from astrojax.propagate.dormand_prince import DORMAND_PRINCE
from astrojax.propagate.events import (
    Events,
    events,
)
from astrojax.propagate.fehlberg import FEHLBERG
from astrojax.propagate.methods import Method
from astrojax.propagate.nystrom import NYSTROM_12
from astrojax.propagate.runge_kutta import compensated_add, rk4_increment, rk4_increment_looped, rk4_step
from astrojax.propagate.sensitivity import parameter_sensitivity, pullback, state_transition_matrix

__all__ = [
    "DORMAND_PRINCE",
    "FEHLBERG",
    "NOT_FINITE",
    "NYSTROM_12",
    "STEP_TOO_SMALL",
    "SUCCESS",
    "TOO_MANY_STEPS",
    "Events",
    "Method",
    "Solution",
    "Trajectory",
    "compensated_add",
    "events",
    "integrate",
    "interpolate",
    "parameter_sensitivity",
    "pullback",
    "rk4_increment",
    "rk4_increment_looped",
    "rk4_step",
    "state_transition_matrix",
    "trajectory",
]
