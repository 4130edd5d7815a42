"""Where the station is: the orbit that each fidelity starts from, and that those without one of their own follow."""

import numpy as np
from jaxtyping import Array, Float

from astrojax.constants import GM_EARTH
from astrojax.orbits import keplerian_to_cartesian, propagate_keplerian, secular_rates_j2
from owm_envs.config.params import ChiefParams, Params
from owm_envs.dynamics.state import PhysicalState

RTN_TO_STATION = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Station axes x = N, y = -T, z = R."""


def elements_at(chief: ChiefParams, epoch: Float[Array, "2"]) -> Float[Array, "6"]:
    """Elements [a m, e, i, raan, argp, M rad] to which the configured orbit has come at `epoch` [MJD day, s] UTC."""
    since = (epoch[0] - chief.epoch[0]) * 86_400.0 + (epoch[1] - chief.epoch[1])
    drifted = chief.elements + chief.drift * since * secular_rates_j2(chief.elements)
    return propagate_keplerian(drifted, since, GM_EARTH)


def kepler_orbit(params: Params, state: PhysicalState) -> Float[Array, "6"]:
    """The station's position and velocity [m, m/s] in inertial axes, on a Kepler orbit from the episode's start.

    In float32 a week from the reference epoch costs about 4e-5 rad along the orbit; the motion within an episode is
    smooth.
    """
    elements = propagate_keplerian(elements_at(params.chief, state.epoch), state.elapsed, GM_EARTH)
    return keplerian_to_cartesian(elements, GM_EARTH)


def station_orbit(dynamics: object, params: Params, state: PhysicalState) -> Float[Array, "6"]:
    """The station's position and velocity [m, m/s] in inertial axes (EME2000), whatever the fidelity.

    Dynamics of one's own may have `chief_orbit(params, state) -> (6,)`; without it the station flies `kepler_orbit`.
    """
    return getattr(dynamics, "chief_orbit", kepler_orbit)(params, state)
