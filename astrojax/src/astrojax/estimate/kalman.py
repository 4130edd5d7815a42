"""The extended Kalman filter, over any propagation and any measurement that JAX can differentiate.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, sec. 10.3.
"""

from collections.abc import Callable

import jax
from jaxtyping import Array, Float

from astrojax.estimate.gaussian import Gaussian, Innovation, innovation, joseph_update, symmetric

Residual = Callable[[Float[Array, "m"], Float[Array, "m"]], Float[Array, "m"]]


def difference(measured: Float[Array, "m"], expected: Float[Array, "m"]) -> Float[Array, "m"]:
    """The residual of a measurement without angles."""
    return measured - expected


def ekf_predict(
    belief: Gaussian,
    propagate: Callable[[Float[Array, "n"]], Float[Array, "n"]],
    process_noise: Float[Array, "n n"],
) -> Gaussian:
    """The belief after a step.

    Args:
        belief: before it.
        propagate: from the state before to the state after.
        process_noise: (n, n) covariance that the step adds.
    """
    mean = propagate(belief.mean)
    matrix = jax.jacfwd(propagate)(belief.mean)
    return Gaussian(mean, symmetric(matrix @ belief.covariance @ matrix.T + process_noise))


def ekf_update(
    belief: Gaussian,
    measured: Float[Array, "m"],
    measure: Callable[[Float[Array, "n"]], Float[Array, "m"]],
    noise: Float[Array, "m m"],
    residual: Residual = difference,
    iterations: int = 1,
) -> tuple[Gaussian, Innovation]:
    """The belief after a measurement.

    Args:
        belief: before it.
        measured: (m,) what the sensor says.
        measure: what it should say, from the state.
        noise: (m, m) its covariance.
        residual: static: measured minus expected, `wrapped` for angles.
        iterations: static: one, or more for the iterated filter, which linearises where the measurement leads.

    Raises:
        ValueError: `iterations` is less than one.
    """
    if iterations < 1:
        raise ValueError(f"iterations: expected at least 1, got {iterations}")
    expected, sensitivity = measure(belief.mean), jax.jacfwd(measure)(belief.mean)
    gain, covariance, size = joseph_update(belief.covariance, sensitivity, noise)
    found = innovation(residual(measured, expected), size)
    mean = belief.mean + gain @ found.residual
    for _ in range(iterations - 1):
        expected, sensitivity = measure(mean), jax.jacfwd(measure)(mean)
        gain, covariance, _ = joseph_update(belief.covariance, sensitivity, noise)
        mean = belief.mean + gain @ (residual(measured, expected) - sensitivity @ (belief.mean - mean))
    return Gaussian(mean, covariance), found
