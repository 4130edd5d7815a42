"""NRLMSISE-00: temperature and composition of the atmosphere from the ground to the exosphere.

Source: Picone, Hedin, Drob and Aikin (2002), J. Geophys. Res. 107(A12), 1468, doi:10.1029/2002JA009430. The model is
the work of the United States Naval Research Laboratory, in the public domain; this implementation is independent of it.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real

from astrojax._types import FloatScalar, Scalar, Vector3
from astrojax.compilation import stored
from astrojax.forces.atmosphere import expansions, species
from astrojax.forces.atmosphere import tables as t
from astrojax.forces.atmosphere.calendar import year_and_day
from astrojax.forces.atmosphere.profile import NODES, descend, layer, planet, thermosphere
from astrojax.forces.atmosphere.space_weather import SpaceWeather
from astrojax.frames import position_ecef_to_geodetic
from astrojax.time import normalize_epoch

ALL_ON = (1.0,) * 23
"""Switches of the complete model, by the daily magnetic index."""
STORM_TIME = (*ALL_ON[:8], -1.0, *ALL_ON[9:])
"""The same, by the history of the magnetic index."""

_TOP, _MIXED, _MIDDLE = 72.5, 62.5, (72.5, 55.0, 45.0, 32.5)
_LOW = (32.5, 20.0, 15.0, 10.0, 0.0)
_STILL = 300.0  # above it the lower thermosphere's temperatures are held at their mean
_AMU = 1.66e-27  # the model's atomic mass unit [kg]


class Air(NamedTuple):
    """The air at one place and time.

    Attributes:
        number: (7,) densities of He, O, N2, O2, Ar, H, N [1/m^3]; O, H and N are zero below 72.5 km.
        hot_oxygen: of oxygen out of thermal equilibrium [1/m^3].
        density: of the seven [kg/m^3].
        density_effective: with hot oxygen, what drag feels [kg/m^3].
        exosphere: temperature at the top [K].
        temperature: here [K].
    """

    number: Float[ArrayLike, "7"]
    hot_oxygen: FloatScalar
    density: FloatScalar
    density_effective: FloatScalar
    exosphere: FloatScalar
    temperature: FloatScalar


def nrlmsise00(
    height: FloatScalar,
    latitude: FloatScalar,
    longitude: FloatScalar,
    day_of_year: Scalar,
    seconds: Scalar,
    weather: SpaceWeather,
    switches: tuple | Real[ArrayLike, "23"] = ALL_ON,
    hour: FloatScalar | None = None,
) -> Air:
    """Temperature, composition and density of the air.

    Args:
        height: above the ellipsoid [m].
        latitude: geodetic [rad]; longitude: east [rad].
        day_of_year: 1 for the first of January.
        seconds: of the day [s], UTC.
        weather: solar flux and magnetic activity.
        switches: (23,) the published ones, traced: 0 leaves a variation out, 1 takes it in, 2 takes in only its
            products with others; the ninth at -1 goes by the history of the magnetic index. Between 0 and 1 it is a
            weight, and from 1 to 2 the weight of the variation itself falls back to 0.
            In their order: flux, independent of time, annual, semiannual, annual odd about the equator, semiannual
            odd, diurnal, semidiurnal, magnetic, all that depends on longitude or universal time, longitude, universal
            time, both with magnetic activity, terdiurnal, departures from diffusive equilibrium, exospheric
            temperature, base temperature, lower thermosphere, gradient, mesosphere, densities at the base,
            stratosphere, turbopause (has no effect).
        hour: local apparent solar time [h]; if None that of the mean Sun.

    Validity: 0 to 1000 km. Below the ground it is held at the ground; above 1000 km the exosphere's formula goes on.
        The model has small steps of its own at 72.5, 123.4 and 300 km, and where a gas is taken to be separated
        (160 to 450 km); gradients are those between the steps, and finite everywhere.
    """
    km = jnp.maximum(height, 0.0) * 1e-3
    dtype = km.dtype
    values = jnp.abs(jnp.asarray(switches, dtype))
    main = jnp.where(values <= 1.0, values, jnp.maximum(2.0 - values, 0.0))
    storm = jnp.asarray(switches, dtype)[8] < 0
    seconds, day = jnp.asarray(seconds, dtype), jnp.asarray(day_of_year, dtype)
    degrees = longitude * (180.0 / math.pi)
    solar = seconds / 3600.0 + degrees / 15.0 if hour is None else hour
    sine, cosine = (fn(latitude * (180.0 / math.pi * expansions.DEGREE)) for fn in (jnp.sin, jnp.cos))
    at = expansions.Moment(
        legendre=expansions.legendre(sine, cosine),
        latitude=latitude * (180.0 / math.pi),
        longitude=degrees * expansions.DEGREE,
        day=day,
        seconds=seconds,
        hour=solar,
        f107=jnp.asarray(weather.f107, dtype),
        f107a=jnp.asarray(weather.f107a, dtype),
        ap=jnp.asarray(weather.ap, dtype),
        main=main,
        cross=jnp.minimum(values, 1.0),
        storm=storm,
    )
    return _model(km, at, sine)


def _model(km, at, sine):
    tables, dtype = t.tables(), km.dtype
    over = jnp.maximum(km, _TOP)

    def weight(i):
        return at.main[i - 1]

    varied, (active, active_below) = stored(expansions.upper(at))
    activity = jnp.stack([active] * 4 + [active_below] * 8 + [active, active_below])
    bent = stored(expansions.lower(at, activity))

    # Gravity of the mean latitude where the model is not to depend on latitude.
    double = 2.0 * sine * sine
    earth = planet(jnp.where(weight(2) > 0, 1.0 - double, math.cos(2.0 * expansions.DEGREE * 45.0)))

    # Temperatures: of the exosphere, the base, the nodes; each varies only where it matters.
    mean, rows = tables.temperature.tolist(), tables.upper[:, 0].tolist()
    join = float(tables.turbopause[1, 15])
    exosphere = mean[0] * rows[t.EXOSPHERE] * (1.0 + weight(16) * jnp.where(over > join, varied[t.EXOSPHERE], 0.0))
    gradient = mean[3] * rows[t.GRADIENT] * (1.0 + weight(19) * jnp.where(over > _TOP, varied[t.GRADIENT], 0.0))
    base = mean[1] * rows[t.BASE] * (1.0 + weight(17) * varied[t.BASE])
    shape = gradient / (exosphere - base)
    warm, cold = tables.temperature, tables.mean
    still = tables.lower[:, 0] * np.concatenate([warm[[6, 2, 7, 4]], cold[:8], warm[[8]], cold[[8]]])
    still = jnp.asarray(still, dtype)
    lower_on = weight(18) * jnp.where(over < _STILL, 1.0, 0.0)
    varies = jnp.stack([lower_on, lower_on, lower_on, lower_on * weight(20)])
    nodes = still[t.THERMOSPHERE] / (1.0 - varies * bent[t.THERMOSPHERE])
    slope = still[t.GRADIENT_THERMOSPHERE] * (1.0 + varies[3] * bent[t.GRADIENT_THERMOSPHERE])
    slope = slope * (nodes[3] / still[3]) ** 2
    upper = stored(thermosphere(earth, exosphere, base, shape, (join, *NODES), nodes, slope))

    logs, log_mixed, log_hot, warm = species.densities(earth, upper, over, varied, weight, at)
    high = 1e6 * jnp.exp(logs)

    # Below 72.5 km the gases are mixed, and the hydrostatic column of the mixture gives its density.
    both = weight(20) * weight(22)
    varies = jnp.stack([weight(20), weight(20), both])
    middle = jnp.concatenate([nodes[3:], still[t.MESOSPHERE] / (1.0 - varies * bent[t.MESOSPHERE])])
    join_slope = still[t.GRADIENT_MESOSPHERE] * (1.0 + both * bent[t.GRADIENT_MESOSPHERE])
    join_slope = join_slope * (middle[3] / still[t.MESOSPHERE][2]) ** 2
    low = still[t.STRATOSPHERE] / (1.0 - weight(22) * bent[t.STRATOSPHERE])
    ground_slope = still[t.GRADIENT_GROUND] * (1.0 + weight(22) * bent[t.GRADIENT_GROUND])
    ground_slope = ground_slope * (low[3] / still[t.STRATOSPHERE][3]) ** 2
    mesosphere = stored(layer(earth, _MIDDLE, middle, (slope, join_slope)))
    troposphere = stored(layer(earth, _LOW, jnp.concatenate([middle[3:], low]), (join_slope, ground_slope)))
    (cold, lost), (cool, lost_low) = descend(earth, mesosphere, km), descend(earth, troposphere, km)
    cold = jnp.where(km > _LOW[0], cold, cool)
    log_air = jnp.log(middle[0] / cold) + species.MIXED_MASS * (lost + lost_low)
    mixed = _mixed(
        high, 1e6 * jnp.exp(log_mixed), jnp.exp(log_air), jnp.clip((km - _MIXED) / (_TOP - _MIXED), 0.0, 1.0)
    )

    above = km >= _TOP
    number = jnp.where(above, high, mixed)
    hot = jnp.where(above, 1e6 * jnp.exp(log_hot), 0.0)
    masses = jnp.asarray(species.MASSES * _AMU, dtype)
    density = jnp.sum(masses * number)
    return Air(
        number=number,
        hot_oxygen=hot,
        density=density,
        density_effective=density + 16.0 * _AMU * hot,
        exosphere=exosphere,
        temperature=jnp.where(above, warm, cold),
    )


def _mixed(high, mixed, gain, share):
    """Densities below 72.5 km, from those there: what is mixed, and a `share` of its departure from the mixture."""
    nitrogen = mixed * gain * (1.0 + (high[2] / mixed - 1.0) * share)
    ratio = t.tables().density[:, 1].tolist()
    found = {2: nitrogen}
    for i in (0, 3, 4):  # He, O2, Ar
        found[i] = nitrogen * ratio[i] * (1.0 + (high[i] / (high[2] * ratio[i]) - 1.0) * share)
    return jnp.stack([found.get(i, jnp.zeros_like(nitrogen)) for i in range(7)])


def density_nrlmsise00(
    r: Vector3,
    day: Scalar,
    seconds: Scalar,
    weather: SpaceWeather,
    switches: tuple | Real[ArrayLike, "23"] = ALL_ON,
) -> FloatScalar:
    """Atmospheric density that drag feels, hot oxygen included [kg/m^3].

    Args:
        r: (3,) position [m], in Earth-fixed axes (ITRF: z to the pole, x to Greenwich).
        day: whole MJD, UTC.
        seconds: of the day [s], UTC; of any size.
        weather: solar flux and magnetic activity, as `space_weather` gives them.
        switches: as for `nrlmsise00`; `STORM_TIME` goes by the history of magnetic activity.

    Validity: as `nrlmsise00`.
    """
    day, seconds = normalize_epoch(day, seconds)
    latitude, longitude, height = position_ecef_to_geodetic(r)
    _, of_year = year_and_day(day)
    seconds = jnp.asarray(seconds, r.dtype)
    air = nrlmsise00(height, latitude, longitude, jnp.asarray(of_year, r.dtype), seconds, weather, switches)
    return air.density_effective
