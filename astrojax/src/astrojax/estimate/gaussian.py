"""A Gaussian belief about a state, and how consistent its errors are with it."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Float

from astrojax._types import FloatScalar


class Gaussian(NamedTuple):
    """A belief.

    Attributes:
        mean: (n,) of the state.
        covariance: (n, n), symmetric and positive.
    """

    mean: Float[Array, "n"]
    covariance: Float[Array, "n n"]


class Innovation(NamedTuple):
    """What a measurement said that was not expected.

    Attributes:
        residual: (m,) measured minus expected.
        covariance: (m, m) that it should have.
        nis: its normalised square, of mean m if the filter is consistent.
        log_likelihood: of the measurement, given all before it.
    """

    residual: Float[Array, "m"]
    covariance: Float[Array, "m m"]
    nis: FloatScalar
    log_likelihood: FloatScalar


def symmetric(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The symmetric part of a matrix, which rounding has left not quite so."""
    return 0.5 * (matrix + matrix.T)


def normalized_square(error: Float[Array, "n"], covariance: Float[Array, "n n"]) -> FloatScalar:
    """Square of an error in units of its covariance: NEES of a state, NIS of a measurement.

    Args:
        error: (n,).
        covariance: (n, n) that it should have, positive.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, sec. 5.4.
    """
    whitened = solve_triangular(jnp.linalg.cholesky(covariance), error, lower=True)
    return jnp.sum(whitened * whitened)


def innovation(residual: Float[Array, "m"], covariance: Float[Array, "m m"]) -> Innovation:
    """The innovation of a residual, with what tells whether it is one."""
    factor = jnp.linalg.cholesky(covariance)
    whitened = solve_triangular(factor, residual, lower=True)
    nis = jnp.sum(whitened * whitened)
    volume = jnp.sum(jnp.log(jnp.diagonal(factor)))
    constant = 0.5 * residual.shape[0] * 1.8378770664093453  # ln 2 pi
    return Innovation(residual, covariance, nis, -0.5 * nis - volume - constant)


def joseph_update(
    covariance: Float[Array, "n n"],
    sensitivity: Float[Array, "m n"],
    noise: Float[Array, "m m"],
) -> tuple[Float[Array, "n m"], Float[Array, "n n"], Float[Array, "m m"]]:
    """Gain of a linear measurement, the covariance after it, and that of its innovation.

    Args:
        covariance: (n, n) before.
        sensitivity: (m, n) of the measurement to the state.
        noise: (m, m) covariance of the measurement.

    Source: Bucy and Joseph (1968); Bar-Shalom et al., sec. 5.2: symmetric and positive for any gain.
    """
    cross = covariance @ sensitivity.T
    expected = symmetric(sensitivity @ cross + noise)
    gain = cho_solve((jnp.linalg.cholesky(expected), True), cross.T).T
    keep = jnp.eye(covariance.shape[0], dtype=covariance.dtype) - gain @ sensitivity
    return gain, symmetric(keep @ covariance @ keep.T + gain @ noise @ gain.T), expected
