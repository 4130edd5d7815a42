"""The unscented Kalman filter: moments carried by points instead of derivatives.

Source: Julier and Uhlmann (2004), Proc. IEEE 92(3), 401; the scaled points of Wan and van der Merwe (2000).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float

from astrojax._types import FloatScalar, Scalar
from astrojax.estimate.gaussian import Gaussian, Innovation, innovation, symmetric
from astrojax.estimate.kalman import Residual, difference


class Spread(NamedTuple):
    """How far the points lie from the mean, and how much its own counts; traced.

    Attributes:
        alpha: distance in standard deviations, over the root of n + kappa.
        beta: what is known of the distribution's tails: 2 for a Gaussian.
        kappa: a further distance.
    """

    alpha: Scalar = 1.0
    beta: Scalar = 2.0
    kappa: Scalar = 0.0


GAUSSIAN = Spread()
"""Points at the root of n standard deviations, the mean of weight two in a covariance: no weight is negative."""


def sigma_points(
    belief: Gaussian, spread: Spread = GAUSSIAN
) -> tuple[Float[Array, "points n"], tuple[FloatScalar, FloatScalar]]:
    """Points of a belief, and the weights of the first in a covariance and of each other in anything.

    Args:
        belief: of positive covariance.
        spread: of the points.
    """
    n = belief.mean.shape[0]
    alpha, beta, kappa = (jnp.asarray(x, belief.mean.dtype) for x in spread)
    scale = alpha * alpha * (n + kappa)
    legs = jnp.sqrt(scale) * jnp.linalg.cholesky(belief.covariance).T
    mean = belief.mean[None]
    weights = 2.0 - n / scale - alpha * alpha + beta, 0.5 / scale
    return jnp.concatenate([mean, mean + legs, mean - legs]), weights


def _moments(points, centre, weights, away):
    """Mean as a shift from the first point, deviations of the points from it, and their covariance."""
    centred, rest = weights
    apart = jax.vmap(away, (0, None))(points, centre)
    shift = rest * jnp.sum(apart[1:], axis=0)
    apart = apart - shift[None]
    covariance = rest * apart[1:].T @ apart[1:] + centred * jnp.outer(apart[0], apart[0])
    return shift, apart, covariance


def ukf_predict(
    belief: Gaussian,
    propagate: Callable[[Float[Array, "n"]], Float[Array, "n"]],
    process_noise: Float[Array, "n n"],
    spread: Spread = GAUSSIAN,
) -> Gaussian:
    """The belief after a step; arguments as for `ekf_predict`, and the `spread` of the points."""
    points, weights = sigma_points(belief, spread)
    ahead = jax.vmap(propagate)(points)
    shift, _, covariance = _moments(ahead, ahead[0], weights, difference)
    return Gaussian(ahead[0] + shift, symmetric(covariance + process_noise))


def ukf_update(
    belief: Gaussian,
    measured: Float[Array, "m"],
    measure: Callable[[Float[Array, "n"]], Float[Array, "m"]],
    noise: Float[Array, "m m"],
    residual: Residual = difference,
    spread: Spread = GAUSSIAN,
) -> tuple[Gaussian, Innovation]:
    """The belief after a measurement; arguments as for `ekf_update`, and the `spread` of the points."""
    points, weights = sigma_points(belief, spread)
    expected = jax.vmap(measure)(points)
    shift, apart, covariance = _moments(expected, expected[0], weights, residual)
    size = symmetric(covariance + noise)
    found = innovation(residual(measured, expected[0]) - shift, size)
    legs = points[1:] - belief.mean[None]
    # The first point is the mean itself, so only the others tell how state and measurement go together.
    cross = weights[1] * legs.T @ apart[1:]
    gain = cho_solve((jnp.linalg.cholesky(size), True), cross.T).T
    # P - K S K^T, written so that it stays positive: both sides are sums over the same points.
    kept = legs - apart[1:] @ gain.T
    centre = gain @ apart[0]
    after = weights[1] * kept.T @ kept + weights[0] * jnp.outer(centre, centre) + gain @ noise @ gain.T
    return Gaussian(belief.mean + gain @ found.residual, symmetric(after)), found
