"""Mean elements as SGP4 reads them: a pytree of arrays, one satellite or many."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import ArrayLike, Real

_DEEP_SPACE_MINUTES = 225.0


class Sgp4Elements(NamedTuple):
    """Brouwer mean elements of one satellite (scalars) or of a catalogue (arrays of one shape); TEME of epoch.

    The pair of day and seconds keeps microseconds over centuries, as everywhere in `astrojax.time`.
    """

    day: Real[ArrayLike, "..."]  # whole Modified Julian Day, UTC
    seconds: Real[ArrayLike, "..."]  # of that day [s]
    mean_motion: Real[ArrayLike, "..."]  # as published, in Kozai's sense [rad/s]
    e: Real[ArrayLike, "..."]
    inc: Real[ArrayLike, "..."]  # [rad]
    raan: Real[ArrayLike, "..."]  # [rad]
    argp: Real[ArrayLike, "..."]  # [rad]
    mean_anomaly: Real[ArrayLike, "..."]  # [rad]
    bstar: Real[ArrayLike, "..."]  # drag term [1 / Earth radii]


def stack_elements(elements: Sequence[Sgp4Elements]) -> Sgp4Elements:
    """Elements of many satellites as one pytree of NumPy arrays, to be vmapped over (host side).

    Args:
        elements: sets of one satellite each; at least one.
    """
    if not elements:
        raise ValueError("elements: expected at least one set, got none")
    return jax.tree.map(lambda *leaves: np.stack(leaves), *elements)


def is_deep_space(elements: Sgp4Elements) -> np.ndarray:
    """Whether SGP4 takes each satellite for a deep-space one: a period of 225 minutes or more (host side).

    A catalogue split by this runs faster: its near-Earth part needs no program of the deep-space terms.

    Args:
        elements: one satellite or many; the test is on the mean motion as published, which Kozai's correction
            moves by less than 0.1 %: within that margin the answer is the deep one, which serves both.
    """
    minutes = 2.0 * np.pi / (60.0 * np.asarray(elements.mean_motion))
    return minutes >= _DEEP_SPACE_MINUTES * (1.0 - 2e-3)
