"""The spherical harmonics of NRLMSISE-00: how its parameters vary with season, place, hour, Sun and magnetic activity.

Source: Picone et al. (2002), as in `tables`, appendix A; equation numbers are those of its appendix.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from astrojax._types import FloatScalar
from astrojax.compilation import stored
from astrojax.forces.atmosphere.tables import BASE, LEGENDRE, LOWER_TERMS, NITROGEN_ATOM, UPPER_TERMS, tables

DEGREE = 1.74533e-2  # the model's own radians of a degree
_YEAR = 1.72142e-2  # its radians of a day in a year,
_DAY = 7.2722e-5  # of a second in a day
_HOUR = 0.2618  # and of an hour in a day
_STORM_DECAY = 10800.0  # seconds between two entries of the history
_LONGEST = 0.99999  # memory


class Moment(NamedTuple):
    """What all expansions depend on.

    Attributes:
        legendre: (F,) associated Legendre functions of the sine of latitude, in the order of `LEGENDRE`.
        latitude: [deg]; longitude: in the model's radians.
        day: of year; seconds: of day, UTC; hour: local apparent solar time.
        f107, f107a: solar flux of the day before and its mean of 81 days [1e-22 W/m^2/Hz].
        ap: (7,) magnetic activity.
        main, cross: (23,) weights of the variations, and of their products with others.
        storm: whether the history of `ap` counts, not its daily value alone.
    """

    legendre: Float[Array, "F"]
    latitude: FloatScalar
    longitude: FloatScalar
    day: FloatScalar
    seconds: FloatScalar
    hour: FloatScalar
    f107: FloatScalar
    f107a: FloatScalar
    ap: Float[Array, "7"]
    main: Float[Array, "23"]
    cross: Float[Array, "23"]
    storm: Array


def legendre(sin: FloatScalar, cos: FloatScalar) -> Float[Array, "F"]:
    """Associated Legendre functions of the sine of latitude, unnormalised, without the sign (-1)^m.

    Args:
        sin, cos: of latitude.
    """
    found = {}
    for n, m in LEGENDRE:  # by order, then rising degree
        if n == m:
            found[n, m] = jnp.ones_like(sin) if m == 0 else (2 * m - 1) * cos * found[m - 1, m - 1]
        else:
            before = (n + m - 1) * found[n - 2, m] if n > m + 1 else 0.0
            found[n, m] = ((2 * n - 1) * sin * found[n - 1, m] - before) / (n - m)
    return jnp.stack([found[key] for key in LEGENDRE])


def upper(at: Moment) -> tuple[Float[Array, "11"], tuple[FloatScalar, FloatScalar]]:
    """The expansions of the thermosphere, and the activity that those of the lower atmosphere go by.

    Returns:
        (11,) relative deviations (of exospheric temperature, gradient, and base temperature) and logarithms of
        density; then the activity of the thermosphere's nodes and that of the nodes below.
    """
    dtype = at.legendre.dtype
    p = jnp.asarray(tables().upper.T, dtype)
    term = _terms(tables().upper_terms, UPPER_TERMS, at.legendre)
    main, cross = _weights(at)
    annual, semiannual, annual_odd, semiannual_odd = _seasons(at.day, p)

    change, mean = at.f107 - at.f107a, at.f107a - 150.0
    daily_flux = p[19] * change + p[20] * change * change
    f1 = 1.0 + (p[47] * mean + daily_flux) * cross(1)
    f2 = 1.0 + (p[49] * mean + daily_flux) * cross(1)
    season = annual_odd * cross(5)

    total = p[30] + main(1) * (
        p[19] * change * (1.0 + p[59] * mean) + p[20] * change * change + p[21] * mean + p[29] * mean * mean
    )
    total += main(2) * (term["steady"] + term["steady_flux"] * mean * cross(1))
    total += main(3) * term["annual"] * annual + main(4) * term["semiannual"] * semiannual
    total += main(5) * f1 * term["annual_odd"] * annual_odd + main(6) * term["semiannual_odd"] * semiannual_odd
    for switch, name, multiple in ((7, "diurnal", 1), (8, "semidiurnal", 2), (14, "terdiurnal", 3)):
        angle = multiple * _HOUR * at.hour
        cos, sin = (term[f"{name}_{part}"] + term[f"{name}_{part}_annual"] * season for part in ("cos", "sin"))
        total += main(switch) * f2 * (cos * jnp.cos(angle) + sin * jnp.sin(angle))

    # Magnetic activity: the daily value, or its history if the expansion has a memory at all.
    activity = jnp.where(at.storm, _storm(at, p), _daily(at, p))

    def chosen(name):
        return jnp.where(at.storm, term["storm" + name], term["daily" + name])

    def column(storm, daily):
        return jnp.where(at.storm, p[storm], p[daily])

    hour = _HOUR * (at.hour - column(131, 124))
    around = chosen("") + chosen("_annual") * season + chosen("_diurnal") * cross(7) * jnp.cos(hour)
    total += main(9) * activity * around

    place = (1.0 + p[80] * mean * cross(1)) * (
        (term["longitude_cos"] + term["longitude_cos_annual"] * season) * jnp.cos(at.longitude)
        + (term["longitude_sin"] + term["longitude_sin_annual"] * season) * jnp.sin(at.longitude)
    )
    north = at.legendre[LEGENDRE.index((1, 0))]
    universal = (1.0 + p[95] * north) * (1.0 + p[81] * mean * cross(1)) * (1.0 + p[119] * north * season)
    universal = universal * term["universal"] * jnp.cos(_DAY * (at.seconds - p[71]))
    universal += (
        cross(11)
        * term["universal_longitude"]
        * jnp.cos(_DAY * (at.seconds - p[79]) + 2.0 * at.longitude)
        * (1.0 + p[137] * mean * cross(1))
    )
    mixed = cross(11) * (
        (1.0 + column(132, 120) * north) * chosen("_longitude") * jnp.cos(at.longitude - DEGREE * column(97, 63))
        + season * chosen("_longitude_annual") * jnp.cos(at.longitude - DEGREE * column(136, 118))
    )
    mixed += cross(12) * chosen("_universal") * jnp.cos(_DAY * (at.seconds - column(58, 75)))
    total += main(10) * (main(11) * place + main(12) * universal + main(13) * activity * mixed)
    return total, (activity[BASE], jnp.where(at.storm, activity[NITROGEN_ATOM], activity[BASE]))


def lower(at: Moment, activity: Float[Array, "14"]) -> Float[Array, "14"]:
    """The expansions of the temperatures below, as relative deviations of inverse temperature or gradient.

    Args:
        activity: (14,) magnetic activity of each, from `upper`.
    """
    p = jnp.asarray(tables().lower.T, at.legendre.dtype)
    term = _terms(tables().lower_terms, LOWER_TERMS, at.legendre)
    main, cross = _weights(at)
    annual, semiannual, annual_odd, semiannual_odd = _seasons(at.day, p)
    season = annual_odd * cross(5)

    total = main(1) * term["flux"] * (at.f107a - 150.0) + main(2) * term["steady"]
    total += main(3) * term["annual"] * annual + main(4) * term["semiannual"] * semiannual
    total += main(5) * term["annual_odd"] * annual_odd + main(6) * term["semiannual_odd"] * semiannual_odd
    for switch, name, multiple in ((7, "diurnal", 1), (8, "semidiurnal", 2)):
        angle = multiple * _HOUR * at.hour
        cos, sin = (term[f"{name}_{part}"] + term[f"{name}_{part}_annual"] * season for part in ("cos", "sin"))
        total += main(switch) * (cos * jnp.cos(angle) + sin * jnp.sin(angle))
    angle = 3 * _HOUR * at.hour
    total += main(14) * (term["terdiurnal_cos"] * jnp.cos(angle) + term["terdiurnal_sin"] * jnp.sin(angle))
    storm, daily = (term[name] + term[f"{name}_cross"] * cross(2) for name in ("storm", "daily"))
    total += main(9) * activity * jnp.where(at.storm, storm, daily)

    def wave(size, phase, multiple):
        return p[size] * jnp.cos(multiple * _YEAR * (at.day - p[phase]))

    north = at.legendre[LEGENDRE.index((1, 0))]
    size = 1.0 + north * (wave(80, 81, 1) * cross(5) + wave(85, 86, 2) * cross(6))
    size += wave(83, 84, 1) * cross(3) + wave(87, 88, 2) * cross(4)
    place = term["longitude_cos"] * jnp.cos(at.longitude) + term["longitude_sin"] * jnp.sin(at.longitude)
    return total + main(10) * main(11) * size * place


def _terms(matrix, names, functions):
    """Every term of every expansion: one product with the Legendre functions."""
    product = jnp.matmul(jnp.asarray(matrix, functions.dtype), functions, precision=jax.lax.Precision.HIGHEST)
    return dict(zip(names, stored(jnp.reshape(product, (len(names), -1))), strict=True))


def _weights(at):
    """Weights by the published numbers of the switches, which count from 1."""
    return lambda i: at.main[i - 1], lambda i: at.cross[i - 1]


def _seasons(day, p):
    """Annual and semiannual waves, symmetric about the equator and not, with each expansion's own phase."""
    waves = ((31, 1), (17, 2), (13, 1), (38, 2))
    return stored(tuple(jnp.cos(multiple * _YEAR * (day - p[phase])) for phase, multiple in waves))


def _daily(at, p):
    """Saturating response to the daily value, eq. A23."""
    above = at.ap[0] - 4.0
    return above + (p[44] - 1.0) * (above + (jnp.exp(-p[43] * above) - 1.0) / p[43])


def _storm(at, p):
    """Response to the history of three days, each entry the weaker the older, eq. A24."""
    rate = jnp.abs(p[51])
    memory = jnp.exp(-_STORM_DECAY * rate / (1.0 + p[138] * (45.0 - jnp.abs(at.latitude))))
    memory = jnp.minimum(memory, _LONGEST)
    slope = jnp.maximum(p[24], 1e-4)

    def response(a):
        return a - 4.0 + (p[25] - 1.0) * (a - 4.0 + (jnp.exp(-slope * (a - 4.0)) - 1.0) / slope)

    ap = at.ap
    older = response(ap[5]) * memory**4 + response(ap[6]) * memory**12
    weighted = response(ap[1]) + response(ap[2]) * memory + response(ap[3]) * memory**2 + response(ap[4]) * memory**3
    weighted += older * (1.0 - memory**8) / (1.0 - memory)
    norm = 1.0 + (1.0 - memory**19) / (1.0 - memory) * jnp.sqrt(memory)
    return jnp.where(p[51] == 0, 0.0, weighted / norm)
