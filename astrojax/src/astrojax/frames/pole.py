"""The celestial intermediate pole and origin: X, Y and s, summed from the series or looked up in a table made of it."""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Real

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype
from astrojax.frames.precession import ALL_TERMS, pole_angles
from astrojax.time import centuries_tt, tai_minus_utc

POLE_INSIDE, POLE_OUTSIDE = 0, 1


class CelestialPole(NamedTuple):
    """Direction of the celestial intermediate pole in GCRF, and its origin.

    Attributes:
        x: the pole's direction cosine X.
        y: its Y.
        s: locator of the celestial intermediate origin [rad].
        status: 0, or 1 outside the span of a `PoleTable`, whose nearest end is then given.
    """

    x: FloatScalar
    y: FloatScalar
    s: FloatScalar
    status: Int[Array, ""]


@runtime_checkable
class PoleModel(Protocol):
    """What gives the celestial pole at a UTC epoch."""

    def at(self, day: Scalar, seconds: Scalar) -> CelestialPole: ...


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PoleSeries:
    """The celestial pole of IAU 2006/2000A, summed from its series.

    Attributes:
        terms: how many terms, largest first; static. All 1322 are the model. Error of the rotation over 1962 to 2050
            with fewer (and at the height of GEO): 600 1.1e-10 (5 mm), 300 4.2e-10 (2 cm), 100 2.7e-9 (10 cm), 30 2e-8
            (0.9 m), 10 1.5e-7 (6 m), none, which is precession alone, 5e-5 (2 km).
    """

    terms: int = dataclasses.field(default=ALL_TERMS, metadata={"static": True})

    def at(self, day: Scalar, seconds: Scalar) -> CelestialPole:
        """Pole at a UTC epoch (whole MJD, seconds of day [s]); see `celestial_pole`."""
        return celestial_pole(day, seconds, self.terms)


def celestial_pole(day: Scalar, seconds: Scalar, terms: int = ALL_TERMS) -> CelestialPole:
    """X, Y and s of the celestial intermediate pole and origin, IAU 2006/2000A.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        terms: how many terms of the series, largest first; static.

    Validity: ERFA `xys06a` to 1e-15 rad over 1962 to 2050 (float32: 1e-7 rad).

    Raises:
        ValueError: `terms` is not from 0 to `ALL_TERMS`.

    Source: IERS Conventions (2010), TN 36, sec. 5.4.4 and 5.5.6; Wallace and Capitaine 2006, A&A 459, 981.
    """
    return _pole(centuries_tt(day, seconds), terms)


def _pole(t: FloatScalar, terms: int) -> CelestialPole:
    a = pole_angles(t, terms)
    psi, epsilon = a.psi + a.dpsi, a.epsilon + a.depsilon
    sin_eps, cos_eps, cos_psi = jnp.sin(epsilon), jnp.cos(epsilon), jnp.cos(psi)
    along = sin_eps * jnp.sin(psi)
    across = sin_eps * cos_psi * jnp.cos(a.phi) - cos_eps * jnp.sin(a.phi)
    sin_gam, cos_gam = jnp.sin(a.gamma), jnp.cos(a.gamma)
    x, y = along * cos_gam - across * sin_gam, along * sin_gam + across * cos_gam
    return CelestialPole(x, y, a.locator - 0.5 * x * y, jnp.zeros((), jnp.int32))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PoleTable:
    """The celestial pole over a span, interpolated between nodes at equal steps: a pytree that `pole_table` makes.

    Attributes:
        nodes: (N, 3) X, Y and s.
        first_day: MJD (TT) of the first node.
        step: days between nodes; static.
    """

    nodes: Float[Array | np.ndarray, "*B N 3"]
    first_day: Real[ArrayLike, "..."]
    step: float = dataclasses.field(metadata={"static": True})

    def at(self, day: Scalar, seconds: Scalar) -> CelestialPole:
        """Pole at a UTC epoch (whole MJD, seconds of day [s]), by Lagrange's formula through ten nodes.

        Validity: within 1e-14 rad of the series at the default step of half a day; `status` says when outside.
        """
        dtype = float_dtype(day, seconds)
        nodes = jnp.asarray(self.nodes)
        count = nodes.shape[0]
        days = (jnp.asarray(day) - jnp.asarray(self.first_day, jnp.asarray(day).dtype)).astype(dtype)
        seconds = jnp.asarray(seconds, dtype) + (tai_minus_utc(day, seconds).astype(dtype) + c.TT_MINUS_TAI)
        position = (days + seconds / c.SECONDS_PER_DAY) / self.step
        inside = (position >= 0.0) & (position <= count - 1.0)
        position = jnp.clip(position, 0.0, count - 1.0)
        start = jnp.clip(position.astype(jnp.int32) - (_WIDTH // 2 - 1), 0, count - _WIDTH)
        near = jax.lax.dynamic_slice_in_dim(nodes, start, _WIDTH).astype(dtype)
        x, y, s = _lagrange(position - start.astype(dtype)) @ near
        return CelestialPole(x, y, s, jnp.where(inside, POLE_INSIDE, POLE_OUTSIDE).astype(jnp.int32))


_WIDTH = 10
_SCALE = np.array([float(np.prod([j - k for k in range(_WIDTH) if k != j])) for j in range(_WIDTH)])


def _lagrange(x: FloatScalar) -> Float[Array, "10"]:
    """Weights of ten values at 0 to 9, by products from both ends: finite at the nodes, derivatives too."""
    left = [jnp.ones_like(x)]
    for k in range(_WIDTH - 1):
        left.append(left[-1] * (x - k))
    right = [jnp.ones_like(x)]
    for k in range(_WIDTH - 1, 0, -1):
        right.append(right[-1] * (x - k))
    return jnp.stack([left[j] * right[_WIDTH - 1 - j] for j in range(_WIDTH)]) / jnp.asarray(_SCALE, x.dtype)


def pole_table(first_day: int, days: int, step: float = 0.5, terms: int = ALL_TERMS) -> PoleTable:
    """Table of the celestial pole over a span, to look up what costs a thousand terms to sum.

    Args:
        first_day: MJD (TT) of its first day.
        days: length of the span [d]; static.
        step: days between nodes, a divisor of a day such as 0.5; static.
        terms: how many terms of the series, largest first; static.

    Raises:
        ValueError: the span has fewer than ten nodes.
    """
    count = round(days / step) + 1
    if count < _WIDTH:
        raise ValueError(f"days: expected {_WIDTH - 1} steps of {step} d or more, got {days}")
    t = (float(first_day - 51544) - 0.5 + np.arange(count) * step) / c.DAYS_PER_CENTURY
    poles = jax.jit(jax.vmap(lambda t: _pole(t, terms)))(jnp.asarray(t))
    return PoleTable(jnp.stack(poles[:3], axis=-1), np.int32(first_day), step)
