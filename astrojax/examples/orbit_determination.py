"""Where is the satellite? A few passes over two stations, seen as range, azimuth and elevation, filtered.

    python astrojax/examples/orbit_determination.py --runs 20 --out .

A truth is flown with the Dormand-Prince integrator, jostled and measured with noise, and followed by an extended and an
unscented Kalman filter that start a kilometre and a metre a second off on each axis. Both use the same two functions:
one that propagates, one that measures. Many such runs tell whether the errors are as large as the filters believe.
"""

import argparse
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from astrojax import estimate, forces, orbits, propagate
from astrojax.constants import OMEGA_EARTH

STEP = 30.0  # [s]
STATIONS = np.radians([(40.0, -4.0), (-33.0, 149.0)])  # geocentric latitude, longitude
ELEMENTS = (7.2e6, 0.002, 1.2, 6.0, 0.1, 0.4)  # a [m], e, i, node, perigee, anomaly [rad]
NOISE = np.array([20.0, 2e-4, 2e-4])  # range [m], azimuth and elevation [rad], one standard deviation each
PROCESS = np.array([1e-2] * 3 + [1e-5] * 3)  # what no force explains in a step [m, m/s]
SPREAD = np.array([1e3] * 3 + [1.0] * 3)  # of the first belief [m, m/s]
HORIZON = np.radians(5.0)


class Errors(NamedTuple):
    """By run and step: position error and what the filter expects of it [m], NEES, NIS, station (-1: none)."""

    error: np.ndarray
    expected: np.ndarray
    nees: np.ndarray
    nis: np.ndarray
    seen_by: np.ndarray


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


def follow(kind: str, steps: int, key: jax.Array) -> Errors:
    """One run: a truth with noise of its own, and a filter from a false start."""
    predict, update = (getattr(estimate, f"{kind}_{step}") for step in ("predict", "update"))
    residual = estimate.wrapped((False, True, True))
    spread, process, noise = map(jnp.asarray, (SPREAD, PROCESS, NOISE))
    truth = orbits.keplerian_to_cartesian(jnp.array(ELEMENTS))
    first, key = jax.random.split(key)
    belief = estimate.Gaussian(truth + spread * jax.random.normal(first, (6,)), jnp.diag(spread**2))

    def step(carry, k):
        truth, belief = carry
        t = (k + 1) * STEP
        jostle, *draws = jax.random.split(jax.random.fold_in(key, k), 1 + len(STATIONS))
        truth = flow(truth) + process * jax.random.normal(jostle, (6,))
        belief = predict(belief, flow, jnp.diag(process**2))

        def look(carry, station):
            belief, i, draw = carry[0], *station
            z = measure(i, t, truth) + noise * jax.random.normal(draw, (3,))
            after, found = update(belief, z, functools.partial(measure, i, t), jnp.diag(noise**2), residual)
            seen = (after, found.nis, i)
            return jax.tree.map(lambda a, b: jnp.where(z[2] > HORIZON, a, b), seen, carry), None

        stations = jnp.arange(len(STATIONS)), jnp.stack(draws)
        (belief, nis, seen_by), _ = jax.lax.scan(look, (belief, jnp.nan, -1), stations)
        error = truth - belief.mean
        expected = jnp.sqrt(jnp.trace(belief.covariance[:3, :3]))
        nees = estimate.normalized_square(error, belief.covariance)
        return (truth, belief), Errors(jnp.linalg.norm(error[:3]), expected, nees, nis, seen_by)

    return jax.lax.scan(step, (truth, belief), jnp.arange(steps))[1]


def draw(found: dict[str, Errors], file: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(7.5, 5.5), layout="constrained")
    for (kind, runs), color in zip(found.items(), ("tab:blue", "tab:orange")):
        minutes = STEP / 60.0 * np.arange(1, runs.error.shape[1] + 1)
        above.semilogy(minutes, np.sqrt(np.mean(runs.error**2, axis=0)), color=color, label=f"{kind}: error")
        above.semilogy(minutes, np.sqrt(np.mean(runs.expected**2, axis=0)), ":", color=color, label=f"{kind}: expected")
        below.plot(minutes, runs.nees.mean(axis=0), color=color, label=kind)
    for start in minutes[(runs.seen_by >= 0).any(axis=0)]:
        above.axvspan(start - STEP / 60.0, start, color="0.92", lw=0)
    count = len(runs.nees)
    away = 1.96 * np.sqrt(2.0 * 6.0 / count)
    below.axhspan(6.0 - away, 6.0 + away, color="0.9", label=f"95 % of means of {count} consistent runs")
    above.set_ylabel("position, root mean square [m]")
    below.set(xlabel="minutes", ylabel="mean NEES", ylim=(0.0, 15.0))
    above.legend(fontsize=8)
    below.legend(fontsize=8)
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> dict[str, Errors]:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--steps", type=int, default=400, help="of half a minute")
    parser.add_argument("--filters", nargs="+", default=["ekf", "ukf"], choices=["ekf", "ukf"])
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args(arguments)
    found = {}
    with jax.enable_x64(True):
        keys = jax.random.split(jax.random.key(5), options.runs)
        for kind in options.filters:
            runs = jax.jit(jax.vmap(functools.partial(follow, kind, options.steps)))(keys)
            found[kind] = runs = jax.tree.map(np.asarray, runs)
            looks = (runs.seen_by >= 0).sum() / options.runs
            print(f"{kind}: {options.runs} runs of {looks:.0f} looks; if consistent, NIS is 3 and NEES 6 in the mean")
            print(f"  mean NIS {np.nanmean(runs.nis):.2f}, mean NEES {runs.nees.mean():.2f}")
            for k in (0, options.steps // 2, options.steps - 1):
                error, expected = (np.sqrt(np.mean(x[:, k] ** 2)) for x in (runs.error, runs.expected))
                print(f"  after {(k + 1) * STEP / 60:5.1f} min: {error:8.1f} m off, {expected:8.1f} m expected")
    if options.out:
        draw(found, options.out / "orbit_determination.png")
    return found


if __name__ == "__main__":
    main()
