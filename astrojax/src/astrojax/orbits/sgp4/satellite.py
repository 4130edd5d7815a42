"""A satellite made ready for SGP4: what its elements at epoch fix once and for all."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from astrojax.orbits.sgp4.elements import Sgp4Elements
from astrojax.orbits.sgp4.gravity import gravity_of
from astrojax.orbits.sgp4.lunisolar import Body, Rates, lunisolar
from astrojax.orbits.sgp4.near_earth import Drag, Mean, Number, drag_series, mean_at_epoch
from astrojax.orbits.sgp4.resonance import Resonance, resonance_terms

OPSMODES = ("improved", "afspc")
_TURN = 6.283185307179586
_DEEP_MINUTES = 225.0
_JD_STEPS = 2.0**31  # a day, of a Julian date in double precision


class Deep(NamedTuple):
    """Deep-space part; all zero for a near-Earth satellite."""

    active: Array  # bool
    sidereal: Number  # Greenwich mean sidereal time at epoch [rad]
    sun: Body
    moon: Body
    rates: Rates
    resonance: Resonance


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sgp4Satellite:
    """What `sgp4` flies: a pytree of coefficients in Earth radii and minutes, made by `sgp4_init`."""

    mean: Mean
    drag: Drag
    deep: Deep | None  # None: made for near-Earth satellites only
    status: Int[Array, "..."]  # of the elements themselves
    gravity: str = dataclasses.field(metadata={"static": True})
    opsmode: str = dataclasses.field(metadata={"static": True})


def sgp4_init(
    elements: Sgp4Elements, gravity: str = "wgs72", opsmode: str = "improved", deep_space: bool = True
) -> Sgp4Satellite:
    """A satellite ready for `sgp4`, from its mean elements; vmap it over a catalogue.

    Args:
        elements: of one satellite, as `parse_tle` and its like give them.
        gravity: "wgs72", which published elements are fitted with, or "wgs84"; static.
        opsmode: "improved" or "afspc", which differ in sidereal time at epoch and in the quadrant of the node
            of deep-space orbits near the equator; static.
        deep_space: whether to carry the deep-space part, which near-Earth satellites may do without; static. Without
            it a satellite of 225 minutes or more has status 8.

    Validity: as the report. float64; in float32 a day after epoch costs some 100 m near Earth.

    Raises:
        ValueError: an unknown gravity or opsmode.

    Source: Vallado et al., Revisiting Spacetrack Report #3, AIAA 2006-6753, appendix B.
    """
    g = gravity_of(gravity)
    if opsmode not in OPSMODES:
        raise ValueError(f"opsmode: expected one of {', '.join(OPSMODES)}, got {opsmode!r}")
    dtype = jnp.result_type(elements.mean_motion)
    elements = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), elements)

    sane_e = (elements.e >= 0.0) & (elements.e < 1.0)
    sane_n = elements.mean_motion > 0.0
    status = jnp.where(sane_n, jnp.where(sane_e, 0, 1), 2).astype(jnp.int32)
    elements = elements._replace(
        e=jnp.where(sane_e, elements.e, 0.0), mean_motion=jnp.where(sane_n, elements.mean_motion, 1e-3)
    )
    mean = mean_at_epoch(elements, g)
    deep = _TURN / mean.n >= _DEEP_MINUTES
    drag = drag_series(mean, elements.bstar, deep, g)
    if not deep_space:
        return Sgp4Satellite(mean, drag, None, jnp.where(deep & (status == 0), 8, status), gravity, opsmode)

    # The report's epoch is one Julian date in double precision. WIND, at e = 0.97, moves 4 mm if it is finer.
    part = elements.seconds / 86400.0
    part = part + jax.lax.stop_gradient(jnp.round(part * _JD_STEPS) / _JD_STEPS - part)
    sidereal = _sidereal_time(elements.day, part, opsmode)
    sun, moon, rates = lunisolar(mean, (elements.day - 15020.0) + (part + 0.5))
    sun, moon, rates = jax.tree.map(lambda leaf: jnp.where(deep, leaf, 0.0), (sun, moon, rates))
    resonance = resonance_terms(mean, rates, sidereal, deep)
    return Sgp4Satellite(mean, drag, Deep(deep, sidereal, sun, moon, rates, resonance), status, gravity, opsmode)


def _sidereal_time(day: Number, part: Number, opsmode: str) -> Number:
    """Greenwich mean sidereal time [rad] as SGP4 has it: of 1982, or of 1970 in the older mode."""
    turn = jnp.full_like(part, _TURN)
    if opsmode == "afspc":
        days = day - 40586.0  # since 1969 December 31.0
        angle = 1.7321343856509374 + jax.lax.rem(1.72027916940703639e-2 * days, turn)
        span = days + part
        angle = angle + (1.72027916940703639e-2 + _TURN) * part + span * span * 5.07551419432269442e-15
    else:
        centuries = ((day - 51544.0) + (part - 0.5)) / 36525.0
        # 876600 h a century is a turn a day; whole turns are left out.
        small = (-6.2e-6 * centuries + 0.093104) * centuries * centuries + 8640184.812866 * centuries + 67310.54841
        angle = jax.lax.rem(small * (_TURN / 86400.0), turn) + _TURN * (part - 0.5)
    angle = jax.lax.rem(angle, turn)
    return jnp.where(angle < 0.0, angle + turn, angle)
