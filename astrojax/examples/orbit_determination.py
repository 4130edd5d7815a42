"""Where is the satellite? A few passes over two stations, seen as range, azimuth and elevation, filtered.

    python astrojax/examples/orbit_determination.py

A truth is flown with the Dormand-Prince integrator, measured with noise, and followed by an extended and an unscented
Kalman filter that start a kilometre and a metre a second off on each axis. Both use the same two functions: one that
propagates, one that measures.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from astrojax import estimate, forces, orbits, propagate
from astrojax.constants import OMEGA_EARTH

STEP, STEPS = 30.0, 400
STATIONS = np.radians([(40.0, -4.0), (-33.0, 149.0)])  # geocentric latitude, longitude
NOISE = np.diag([20.0, 2e-4, 2e-4]) ** 2  # m, rad
PROCESS = np.diag([1e-2] * 3 + [1e-5] * 3) ** 2
HORIZON = np.radians(5.0)


def derivative(t, state):
    """Two bodies and the Earth's flattening."""
    del t
    r = state[:3]
    return jnp.concatenate([state[3:], forces.accel_two_body(r) + forces.accel_zonal(r, 2)])


def flow(state):
    """The state half a minute later."""
    return propagate.integrate(derivative, 0.0, state, STEP, rtol=1e-10, atol=1e-6).y


def station(i, t):
    """State and local axes of a station."""
    latitude, longitude = jnp.asarray(STATIONS)[i]
    return estimate.station_state(latitude, longitude, 6371e3, OMEGA_EARTH * t)


def measure(i, t, state):
    """Range, azimuth and elevation from station i."""
    place, axes = station(i, t)
    angles = estimate.measure_azimuth_elevation(state, place, axes)
    return jnp.concatenate([estimate.measure_range(state, place), angles])


def follow(kind, key, truth):
    """Errors, their expected size and NIS at every step, from a false start."""
    predict, update = (getattr(estimate, f"{kind}_{step}") for step in ("predict", "update"))
    residual = estimate.wrapped((False, True, True))
    spread = jnp.array([1e3] * 3 + [1.0] * 3)
    belief = estimate.Gaussian(truth + spread * jax.random.normal(key, (6,)), jnp.diag(spread**2))

    def step(carry, k):
        truth, belief = carry
        t = (k + 1) * STEP
        truth, belief = flow(truth), predict(belief, flow, jnp.asarray(PROCESS))
        seen_by = jnp.asarray(-1)
        nis = jnp.nan
        for i in range(len(STATIONS)):
            error = jnp.sqrt(jnp.diagonal(jnp.asarray(NOISE)))
            draw = jax.random.normal(jax.random.fold_in(jax.random.fold_in(key, k), i), (3,))
            z = measure(i, t, truth) + error * draw
            visible = z[2] > HORIZON
            after, found = update(belief, z, functools.partial(measure, i, t), jnp.asarray(NOISE), residual)
            belief = jax.tree.map(lambda a, b, v=visible: jnp.where(v, a, b), after, belief)
            nis, seen_by = jnp.where(visible, found.nis, nis), jnp.where(visible, i, seen_by)
        error = truth - belief.mean
        size = jnp.sqrt(jnp.trace(belief.covariance[:3, :3]))
        return (truth, belief), (jnp.linalg.norm(error[:3]), size, nis, seen_by)

    return jax.lax.scan(step, (truth, belief), jnp.arange(STEPS))[1]


def main() -> None:
    with jax.enable_x64(True):
        truth = orbits.keplerian_to_cartesian(jnp.array([7.2e6, 0.002, 1.2, 0.3, 0.1, 0.0]))
        for kind in ("ekf", "ukf"):
            error, size, nis, seen_by = jax.jit(functools.partial(follow, kind))(jax.random.key(5), truth)
            looks = np.asarray(seen_by) >= 0
            print(f"{kind}: {looks.sum()} looks; mean NIS {np.nanmean(nis):.2f} (3 if consistent)")
            for k in (0, STEPS // 2, STEPS - 1):
                print(f"  after {(k + 1) * STEP / 60:5.1f} min: {error[k]:8.1f} m off, {size[k]:8.1f} m expected")
            assert error[-1] < 5 * size[-1] < 2000.0


if __name__ == "__main__":
    main()
