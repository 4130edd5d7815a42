"""A day in low orbit: forces, steps to a tolerance, any time in between, and the node's drift against its formula.

    python astrojax/examples/propagate.py --hours 24 --out .

The picture, drawn with `--out`, needs matplotlib.
"""

import argparse
import functools
import math
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from astrojax import constants, orbits, propagate, time
from astrojax.forces import Drag, ForceModel, HarrisPriester, PointMass, SolarRadiation, Spacecraft, ThirdBody, Zonal

ELEMENTS = (7078e3, 0.001, math.radians(98.2), 0.3, 1.0, 0.0)  # osculating: a [m], e, i, node, perigee, anomaly [rad]
SPACECRAFT = Spacecraft(mass=800.0, drag_area=6.0, srp_area=9.0)
FORCES = (
    PointMass(),
    Zonal(2),
    Zonal(6, coefficients=(0.0, *constants.ZONALS[1:])),  # J3 to J6
    ThirdBody("moon"),
    ThirdBody("sun"),
    Drag(HarrisPriester()),
    SolarRadiation(),
)
MODELS = {
    "all forces": ForceModel(FORCES, np.ones(7)),
    "J2 alone": ForceModel(FORCES, np.array([1.0, 1, 0, 0, 0, 0, 0])),
}
# Weights are numbers: the models share one compiled program.


@functools.partial(jax.jit, static_argnames="max_steps")
def fly(model, day, start, state, end, rtol, max_steps):
    """All steps of a flight between two seconds of a UTC day, or beyond its end."""
    world = functools.partial(model.environment, day)  # Sun and Moon move while it flies
    flight = (model.derivative, start, state, end, SPACECRAFT, world)
    return propagate.trajectory(*flight, rtol=rtol, atol=1e-6, max_steps=max_steps)


@jax.jit
def at(path, t):
    """Positions [m] at times t (N,), and the right ascension of the mean node [rad]."""
    states, inside = jax.vmap(lambda t: propagate.interpolate(path, t))(t)
    mean = jax.vmap(lambda state: orbits.osculating_to_mean(orbits.cartesian_to_keplerian(state)))(states)
    return states[:, :3], mean[:, 3], inside


def draw(hours: np.ndarray, drifts: dict[str, np.ndarray], formula: np.ndarray, file: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(7.0, 5.0), layout="constrained")
    for name, drift in drifts.items():
        above.plot(hours, drift, label=f"flown, {name}")
        below.plot(hours, 1e3 * (drift - formula), label=name)
    above.plot(hours, formula, "k:", label="formula, J2 to first order")
    above.set_ylabel("drift of the node [deg]")
    above.legend()
    below.set(xlabel="hours", ylabel="flown less formula [0.001 deg]")
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args(arguments)
    seconds, room = 3600.0 * options.hours, 64 + int(300 * options.hours)
    with jax.enable_x64(True):
        day, start = time.mjd_from_calendar("2026-08-01T00:00:00Z")
        state = orbits.keplerian_to_cartesian(jnp.array(ELEMENTS))
        runs = [(model, 1e-10) for model in MODELS.values()] + [(MODELS["all forces"], 1e-12)]
        paths = [fly(model, day, start, state, start + seconds, rtol, max_steps=room) for model, rtol in runs]
        assert all(path.status == propagate.SUCCESS for path in paths), "raise max_steps"
        times = jnp.linspace(start, start + seconds, 401)
        positions, nodes, inside = zip(*(at(path, times) for path in paths))
        rate = float(orbits.secular_rates_j2(orbits.osculating_to_mean(jnp.array(ELEMENTS)))[3])
    assert all(map(np.all, inside))
    apart = float(np.linalg.norm(positions[0] - positions[2], axis=1).max())
    print(f"{options.hours:g} hours in {paths[0].steps} steps, and {paths[0].rejected} tried in vain")
    print(f"anywhere in between at most {apart:.2g} m from a flight at a hundredth of the tolerance")

    elapsed = np.asarray(times) - start
    per_day = math.degrees(86400.0)
    print(f"drift of the node: formula     {per_day * rate:.5f} deg a day")
    drifts, ratios = {}, {}
    for name, node in zip(MODELS, nodes):
        drifts[name] = np.unwrap(node)
        slope = np.polyfit(elapsed, drifts[name], 1)[0]
        ratios[name] = float(slope / rate)
        print(f"                   {name:11} {per_day * slope:.5f} deg a day, {100 * (slope / rate - 1):+.3f} %")
    if options.out:
        degrees = {name: np.degrees(drift - drift[0]) for name, drift in drifts.items()}
        draw(elapsed / 3600.0, degrees, np.degrees(rate * elapsed), options.out / "propagate.png")
    return {"apart": apart, **ratios}


if __name__ == "__main__":
    main()
