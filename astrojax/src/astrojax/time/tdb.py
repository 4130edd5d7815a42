"""Barycentric Dynamical Time: what its clock is ahead of Terrestrial Time at the geocentre."""

import functools
from importlib import resources

import jax.numpy as jnp
import numpy as np

from astrojax import constants as c
from astrojax._types import FloatScalar, Scalar, float_dtype


@functools.cache
def _series() -> dict[str, np.ndarray]:
    with resources.files("astrojax.time").joinpath("data/tdb.npz").open("rb") as file:
        return dict(np.load(file))


def tdb_minus_tt(day: Scalar, seconds: Scalar) -> FloatScalar:
    """TDB - TT [s] at the geocentre.

    Args:
        day: whole MJD, TT (TDB serves as well: they differ by less than 2 ms).
        seconds: seconds of day [s], TT.

    Validity: 1850 to 2150, to 25 ns of the full series of 787 terms (measured against ERFA `dtdb`); float32 within
    0.2 us of float64. A site on the ground adds up to 2.1 us of its own, which are left out.

    Source: Fairhead and Bretagnon 1990, A&A 229, 240: the 243 terms of 1 ns or more.
    """
    dtype = float_dtype(day, seconds)
    days = jnp.asarray(day, dtype) - 51544.0
    millennia = (days + (jnp.asarray(seconds, dtype) / c.SECONDS_PER_DAY - 0.5)) / 365250.0
    terms = _series()
    angle = jnp.asarray(terms["rate"], dtype) * millennia + jnp.asarray(terms["phase"], dtype)
    total = jnp.zeros((), dtype)
    wave = jnp.asarray(terms["amplitude"], dtype) * jnp.sin(angle)
    for power in range(int(terms["power"].max()), -1, -1):  # Horner's rule over the powers of t
        of_power = jnp.asarray(terms["power"] == power)
        total = total * millennia + jnp.sum(jnp.where(of_power, wave, 0.0))
    return total
