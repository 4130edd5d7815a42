"""Example calls of `estimate`, for test_conformance.py, and its rows of the conformance page."""

import jax.numpy as jnp
import numpy as np

from astrojax import estimate

HOST = {"wrapped"}  # gives a function
MODELS = [
    (
        "estimate",
        "extended Kalman filter, Joseph form, iterated",
        "Bar-Shalom et al. sec. 10.3",
        "batch conditional mean; NEES and NIS of 400 runs",
        "1e-12; inside chi-square's 0.9998",
        "",
    ),
    (
        "estimate",
        "unscented Kalman filter",
        "Julier & Uhlmann 2004",
        "batch conditional mean; NEES and NIS of 400 runs",
        "1e-12; inside chi-square's 0.9998",
        "",
    ),
    ("estimate", "range rate, azimuth and elevation", "-", "derivative of range; closed form", "1e-9", ""),
]
A = np.array
MEAN = A([1.0, -0.5, 0.3])
FACTOR = A([[1.0, 0.0, 0.0], [0.3, 0.8, 0.0], [-0.2, 0.1, 0.6]])
NOISE = A([[0.2, 0.05], [0.05, 0.3]])
STATE, STATION = A([5e6, 4e6, 3e6, -4e3, 5e3, 2e3]), A([4.5e6, 3.6e6, 2.7e6, -260.0, 330.0, 1.0])


def _moved(x):
    return jnp.stack([x[0] + 0.1 * x[1], x[1] - 0.1 * jnp.sin(x[0]), x[2] * (1.0 - 0.02 * x[2])])


def _seen(x):
    return jnp.stack([x[0] * x[1], jnp.cos(x[2])])


def _belief(mean, factor):
    return estimate.Gaussian(mean, factor @ factor.T)


def cases(case):
    out = A([0.4, 0.7])

    def predict(step):
        return lambda mean, factor: tuple(step(_belief(mean, factor), _moved, 0.01 * jnp.eye(3, dtype=mean.dtype)))

    def update(step, **options):
        return lambda mean, factor, out, noise: step(_belief(mean, factor), out, _seen, noise, **options)

    axes = A([[-0.6, 0.8, 0.0], [-0.4, -0.3, 0.866], [0.69, 0.52, 0.5]])
    joined = update(estimate.ekf_update, iterations=3)
    return [
        case("symmetric", estimate.symmetric, (FACTOR,)),
        case("normalized_square", lambda e, f: estimate.normalized_square(e, f @ f.T), (MEAN, FACTOR), rtol32=1e-5),
        case("innovation", lambda e, f: tuple(estimate.innovation(e, f @ f.T)), (MEAN, FACTOR), rtol32=1e-5),
        case(
            "joseph_update",
            lambda f, h, r: estimate.joseph_update(f @ f.T, h, r @ r.T),
            (FACTOR, FACTOR[:2], NOISE),
            rtol32=1e-5,
        ),
        case("difference", estimate.difference, (MEAN, 2 * MEAN)),
        case("ekf_predict", predict(estimate.ekf_predict), (MEAN, FACTOR), rtol32=1e-5),
        case("ekf_update", update(estimate.ekf_update), (MEAN, FACTOR, out, NOISE), rtol32=1e-5),
        case("ekf_update/iterated", joined, (MEAN, FACTOR, out, NOISE), rtol32=1e-4),
        case("sigma_points", lambda m, f: estimate.sigma_points(_belief(m, f))[0], (MEAN, FACTOR), rtol32=1e-5),
        case("ukf_predict", predict(estimate.ukf_predict), (MEAN, FACTOR), rtol32=1e-5),
        case("ukf_update", update(estimate.ukf_update), (MEAN, FACTOR, out, NOISE), rtol32=1e-5),
        case("measure_range", estimate.measure_range, (STATE, STATION), rtol32=1e-5),
        case("measure_range_and_rate", estimate.measure_range_and_rate, (STATE, STATION), rtol32=1e-5),
        case("measure_azimuth_elevation", estimate.measure_azimuth_elevation, (STATE, STATION, axes), rtol32=1e-5),
        case("measure_position", estimate.measure_position, (STATE,)),
        case("station_state", estimate.station_state, (A(0.7), A(-1.2), A(6.37e6), A(2.0))),
    ]
