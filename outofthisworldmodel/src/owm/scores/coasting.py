"""Whether a chaser that stops thrusting stays clear of the station: coasts from the true states of flights."""

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from astrojax.constants import GM_EARTH
from owm.scores.flights import Flights
from owm_envs.field import GeodesicField, clearance
from owm_envs.field.drift import drift_matrices

COAST = 360.0
"""s without thrust."""
EVERY = 2.0
"""s of flight from one instant to the next: the planner's replans."""
SAMPLE = 1.0
"""s between the positions that are looked at."""
MARGIN = 0.2
"""m; looked up between nodes a metre apart, a clearance near the hull is at most this much too large (tested)."""
_CHUNK = 512


FAR = 10.0
"""m of clearance. Beyond, a chaser that stops thrusting is to drift clear; nearer, a small impulse is to save it."""
IMPULSES = (0.5, 1.0)
"""m/s: sizes of an avoidance impulse."""


class Coasts(NamedTuple):
    """What would come of flights whose thrusters stop, an instant a row.

    Attributes:
        when: which instants of the flights, every `EVERY` seconds, these are.
        states: true position m and velocity m/s, station frame.
        gap: clearance of the hull, m.
        clear: a coast of `COAST` seconds clears the hull.
        avoidable: it does after a small impulse, see `impulse_clears`; only asked no farther than `FAR`.
    """

    when: Bool[np.ndarray, "N T"]
    states: Float[np.ndarray, "M 6"]
    gap: Float[np.ndarray, "M"]
    clear: Bool[np.ndarray, "M"]
    avoidable: Bool[np.ndarray, "M"]

    @property
    def far(self) -> Bool[np.ndarray, "M"]:
        """Beyond `FAR`."""
        return self.gap > FAR


def coasts_of(flights: Flights, field: GeodesicField, semi_major_axis: float = 6_795_000.0) -> Coasts:
    """Let go of flights every other second.

    Approximated, to the safe side but for the first: motion is Hill-Clohessy-Wiltshire about a circular orbit (after
    360 s 0.1 m, at most 0.5 m, from `iss-numerical`); clearance is looked up between the field's nodes, less `MARGIN`;
    the way between two samples is taken to be cleared by what their clearances leave of it, so that passing closer
    than half of it counts as contact. Hull and sphere are those of `field`; to a sphere attitude does not matter.

    Args:
        flights: with trajectories.
        field: for its clearance of the true hull.
        semi_major_axis: of the station's orbit, m.

    Raises:
        ValueError: the flights were recorded without trajectories.
    """
    if flights.trajectory is None:
        raise ValueError("these flights were recorded without trajectories")
    stride = max(1, round(EVERY / flights.decision_dt))
    # The last state is where the flight ended: nothing is planned from it.
    when = np.isfinite(flights.trajectory[:, 1:, 0])[:, ::stride]
    states = flights.trajectory[:, :-1:stride, :6][when].astype(np.float32)
    n = math.sqrt(GM_EARTH / semi_major_axis**3)
    gap = np.asarray(_gaps(field, states[:, :3]))
    near, avoidable = gap <= FAR, np.zeros(len(states), bool)
    avoidable[near] = impulse_clears(field, states[near], n)
    return Coasts(when, states, gap, coasts_clear(field, states, n), avoidable)


def add_coasts(flights: Flights, field: GeodesicField, semi_major_axis: float = 6_795_000.0) -> Flights:
    """Add to flights with trajectories how many of their instants are passively safe, and how many can be made so.

    Arguments and errors as of `coasts_of`.
    """
    coasts = coasts_of(flights, field, semi_major_axis)

    def counted(which: Bool[np.ndarray, "M"]) -> Int[np.ndarray, "N"]:
        marks = np.zeros(coasts.when.shape, bool)
        marks[coasts.when] = which
        return marks.sum(axis=1)

    return replace(
        flights,
        instants=coasts.when.sum(axis=1),
        instants_safe=counted(coasts.clear),
        instants_far=counted(coasts.far),
        instants_far_safe=counted(coasts.far & coasts.clear),
        instants_avoidable=counted(coasts.avoidable),
    )


def impulse_clears(field: GeodesicField, states: Float[np.ndarray, "N 6"], n: float) -> Bool[np.ndarray, "N"]:
    """Whether an impulse of at most 1 m/s, along any five of the six axis directions, leads to a coast that is clear.

    So at least two of the six must: whichever one fails, another is left.

    Args:
        states: position m and velocity m/s, station frame, whose axes are those of the impulses.
        n: mean motion of the station, rad/s.
    """
    ways = np.zeros(len(states), int)
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        clears = np.zeros(len(states), bool)
        for size in IMPULSES:
            pushed = states + np.concatenate([np.zeros(3), size * direction]).astype(states.dtype)
            clears |= coasts_clear(field, pushed, n)
        ways += clears
    return ways >= 2


def coasts_clear(field: GeodesicField, states: Float[np.ndarray, "N 6"], n: float) -> Bool[np.ndarray, "N"]:
    """Whether the sphere stays clear of the hull for `COAST` seconds from each state, in batches of one size.

    Args:
        states: position m and velocity m/s, station frame.
        n: mean motion of the station, rad/s.
    """
    padded = np.concatenate([states, np.zeros((-len(states) % _CHUNK, 6), states.dtype)])
    transition = transitions(n)
    parts = [_clear(field, transition, padded[i : i + _CHUNK]) for i in range(0, len(padded), _CHUNK)]
    return np.concatenate([np.zeros(0, bool), *map(np.asarray, parts)])[: len(states)]


def transitions(n: float) -> Float[np.ndarray, "T 3 6"]:
    """From a state in the station frame to the positions every `SAMPLE` seconds, from now on."""
    return drift_matrices(n, np.arange(0.0, COAST + SAMPLE / 2, SAMPLE))


@jax.jit
def _clear(field, transition: Float[Array, "T 3 6"], states: Float[Array, "B 6"]) -> Bool[Array, "B"]:
    def one(state):
        path = jnp.einsum("tij,j->ti", transition, state)
        gap = jax.vmap(clearance, (None, 0))(field, path)
        way = jnp.linalg.norm(path[1:] - path[:-1], axis=-1)
        # Clearance falls by no more than the way gone, from either end.
        least = (gap[1:] + gap[:-1] - way) / 2
        return jnp.all(jnp.minimum(least, jnp.minimum(gap[1:], gap[:-1])) > MARGIN)

    return jax.vmap(one)(states)


@jax.jit
def _gaps(field, positions: Float[Array, "B 3"]) -> Float[Array, "B"]:
    return jax.vmap(clearance, (None, 0))(field, positions)
