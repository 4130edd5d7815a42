"""The filters: exact where theory is exact, consistent where it is statistical."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from astrojax import estimate


def system(dtype=jnp.float64):
    """A pushed mass, seen by its position and a mixture."""
    a = jnp.array([[1.0, 0.5], [-0.1, 0.97]], dtype)
    h = jnp.array([[1.0, 0.0], [0.3, 1.0]], dtype)
    q, r = jnp.array([[0.02, 0.01], [0.01, 0.05]], dtype), jnp.array([[0.3, 0.1], [0.1, 0.5]], dtype)
    return a, h, q, r


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_a_linear_filter_is_batch_least_squares(kind, quick, x64, rng):
    """Where all is linear, the last estimate is the conditional mean of the whole joint Gaussian."""
    a, h, q, r = system()
    predict, update = (getattr(estimate, f"{kind}_{step}") for step in ("predict", "update"))
    measured = rng.normal(size=(6, 2))
    start = estimate.Gaussian(jnp.array([0.5, -0.2]), jnp.array([[1.0, 0.2], [0.2, 2.0]]))

    def run(measured):
        belief = start
        for z in measured:
            belief = predict(belief, lambda x: a @ x, q)
            belief, seen = update(belief, z, lambda x: h @ x, r)
        return belief, seen

    belief, _ = quick(run)(jnp.asarray(measured))
    # The joint Gaussian of last state and all measurements, by propagating the noise sources.
    a, h, q, r, p = (np.asarray(x) for x in (a, h, q, r, start.covariance))
    sources = [p, *[q] * 6]
    states = []  # of each step: the map from the start and the six noises
    state = [np.eye(2), *[np.zeros((2, 2))] * 6]
    for k in range(6):
        state = [a @ m for m in state]
        state[k + 1] = np.eye(2)
        states.append(np.hstack(state))
    block = np.zeros((14, 14))
    for i, s in enumerate(sources):
        block[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = s
    seen = np.vstack([h @ s for s in states])
    expected = np.concatenate([h @ np.linalg.matrix_power(a, k + 1) @ np.asarray(start.mean) for k in range(6)])
    covariance = seen @ block @ seen.T + np.kron(np.eye(6), r)
    cross = states[-1] @ block @ seen.T
    gain = cross @ np.linalg.inv(covariance)
    mean = np.linalg.matrix_power(a, 6) @ np.asarray(start.mean) + gain @ (measured.ravel() - expected)
    np.testing.assert_allclose(belief.mean, mean, rtol=0, atol=1e-12)
    after = states[-1] @ block @ states[-1].T - gain @ cross.T
    np.testing.assert_allclose(belief.covariance, after, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_errors_are_as_large_as_the_filter_says(kind, quick, x64):
    """NEES and NIS of 400 runs of orbit determination lie where chi-square puts their means."""
    runs, steps = 400, 12
    predict, update = (getattr(estimate, f"{kind}_{step}") for step in ("predict", "update"))
    radius, rate = 7e6, np.sqrt(3.986004415e14 / 7e6**3)
    spread = jnp.array([50.0, 50.0, 50.0, 0.05, 0.05, 0.05])
    noise = jnp.diag(jnp.array([20.0, 1e-3, 1e-3]) ** 2)
    wrapped = estimate.wrapped((False, True, True))

    def flow(x):
        # Half a minute of two-body motion, by one step of a Taylor series: the same for truth and filter.
        for _ in range(3):
            r, v = x[:3], x[3:]
            g = -3.986004415e14 * r / jnp.sum(r * r) ** 1.5
            x = jnp.concatenate([r + 10.0 * v + 50.0 * g, v + 10.0 * g])
        return x

    def measure(k, x):
        station, axes = estimate.station_state(jnp.asarray(0.2), jnp.asarray(0.1), jnp.asarray(6.37e6), 7.3e-5 * 30 * k)
        angles = estimate.measure_azimuth_elevation(x, station, axes)
        return jnp.concatenate([estimate.measure_range(x, station), angles])

    def run(key):
        keys = jax.random.split(key, 3)
        truth = jnp.array([radius, 0.0, 0.0, 0.0, radius * rate, 300.0])
        start = truth + spread * jax.random.normal(keys[0], (6,))
        added = jnp.array([1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-3])

        def step(carry, inputs):
            truth, belief = carry
            k, disturbance, error = inputs
            truth = flow(truth) + added * disturbance
            belief = predict(belief, flow, jnp.diag(added**2))
            z = measure(k, truth) + jnp.sqrt(jnp.diagonal(noise)) * error
            belief, seen = update(belief, z, lambda x: measure(k, x), noise, residual=wrapped)
            nees = estimate.normalized_square(truth - belief.mean, belief.covariance)
            return (truth, belief), (nees, seen.nis, seen.log_likelihood)

        belief = estimate.Gaussian(start, jnp.diag(spread**2))
        inputs = (
            jnp.arange(1.0, steps + 1),
            jax.random.normal(keys[1], (steps, 6)),
            jax.random.normal(keys[2], (steps, 3)),
        )
        return jax.lax.scan(step, (truth, belief), inputs)[1]

    nees, nis, likelihood = quick(jax.vmap(run))(jax.random.split(jax.random.key(3), runs))
    assert np.all(np.isfinite(likelihood))
    for found, dimension in ((nees[:, -1], 6), (nees[:, 0], 6), (nis.ravel(), 3)):
        low, high = stats.chi2(dimension * found.size).ppf([1e-4, 1 - 1e-4]) / found.size
        assert low < np.mean(found) < high


def test_iterating_helps_where_the_measurement_bends(quick, x64):
    """A near range: the iterated filter finds the most probable point, one linearisation does not."""
    belief = estimate.Gaussian(jnp.array([1.0, 1.0]), jnp.eye(2))
    measure, noise = lambda x: jnp.sqrt(jnp.sum(x * x))[None], jnp.array([[1e-4]])
    z = jnp.array([3.0])

    def cost(x):
        return 0.5 * jnp.sum((x - belief.mean) ** 2) + 0.5 * jnp.sum((z - measure(x)) ** 2) / noise[0, 0]

    gradients = [
        np.linalg.norm(jax.grad(cost)(estimate.ekf_update(belief, z, measure, noise, iterations=n)[0].mean))
        for n in (1, 8)
    ]
    assert gradients[1] < 1e-6
    with pytest.raises(ValueError, match="iterations: expected at least 1, got 0"):
        estimate.ekf_update(belief, z, measure, noise, iterations=0)


def test_the_unscented_filter_knows_what_bends(quick, x64):
    """Mean and variance of a square: exact for a Gaussian, where a linearisation has a variance of none."""
    belief = estimate.Gaussian(jnp.zeros(1), jnp.array([[4.0]]))
    ahead = estimate.ukf_predict(belief, lambda x: x * x, jnp.zeros((1, 1)), estimate.Spread(1.0, 2.0, 0.0))
    np.testing.assert_allclose(ahead.mean, [4.0], rtol=1e-12)
    np.testing.assert_allclose(ahead.covariance, [[32.0]], rtol=1e-12)
    linear = estimate.ekf_predict(belief, lambda x: x * x, jnp.zeros((1, 1)))
    assert linear.covariance[0, 0] == 0


def test_angles_wrap(x64):
    residual = estimate.wrapped((True, False))
    found = residual(jnp.array([3.1, 9.0]), jnp.array([-3.1, 1.0]))
    np.testing.assert_allclose(found, [6.2 - 2 * np.pi, 8.0], rtol=1e-12)


def test_rates_and_angles_of_a_station(x64):
    """Range rate is the derivative of range; a point above a station is at elevation 90 degrees less its tilt."""
    state, station = jnp.array([5e6, 4e6, 3e6, -4e3, 5e3, 2e3]), jnp.array([4.5e6, 3.6e6, 2.7e6, -260.0, 330.0, 0.0])

    def at(t):
        step = t * jnp.concatenate([state[3:], jnp.zeros(3)]), t * jnp.concatenate([station[3:], jnp.zeros(3)])
        return estimate.measure_range(state + step[0], station + step[1])[0]

    np.testing.assert_allclose(estimate.measure_range_and_rate(state, station)[1], jax.grad(at)(0.0), rtol=1e-12)
    place, axes = estimate.station_state(jnp.asarray(0.7), jnp.asarray(-1.2), jnp.asarray(6.37e6), 2.0)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    target = place.at[:3].add(1e5 * (0.6 * axes[0] + 0.8 * axes[2]))
    np.testing.assert_allclose(
        estimate.measure_azimuth_elevation(target, place, axes), [np.pi / 2, np.arctan2(0.8, 0.6)], rtol=1e-9
    )
