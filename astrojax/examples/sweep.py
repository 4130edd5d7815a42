"""How far does each force move a satellite in a day? Every choice of forces at once, in one compiled program.

    python astrojax/examples/sweep.py --hours 24 --out .

The picture, drawn with `--out`, needs matplotlib.
"""

import argparse
import functools
import itertools
import time as clock
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from astrojax import constants, orbits, propagate, time
from astrojax.forces import (
    Drag,
    ForceModel,
    HarrisPriester,
    PointMass,
    Relativity,
    SolarRadiation,
    Spacecraft,
    ThirdBody,
    Zonal,
)

FORCES = {
    "J2": Zonal(2),
    "J3 to J6": Zonal(6, coefficients=(0.0, *constants.ZONALS[1:])),
    "Moon": ThirdBody("moon"),
    "Sun": ThirdBody("sun"),
    "drag": Drag(HarrisPriester()),
    "sunlight": SolarRadiation(),
    "relativity": Relativity(),
}
ELEMENTS = (6878e3, 0.001, 0.9, 0.3, 1.0, 0.0)  # osculating: a [m], e, i, node, perigee, anomaly [rad]
SPACECRAFT = Spacecraft(mass=800.0, drag_area=6.0, srp_area=9.0)
STEP = 20.0  # [s]


class Sweep(NamedTuple):
    """Which forces acted in each flight (S, F), and where it ended (S, 3) [m]."""

    acted: np.ndarray
    position: np.ndarray


def flight(model: ForceModel, steps: int) -> jax.Array:
    """Inertial position [m] after so many steps under some forces."""
    day, start = time.mjd_from_calendar("2026-08-01T00:00:00Z")
    world = functools.partial(model.environment, day)  # Sun and Moon move while it flies

    def step(state, k):
        return propagate.rk4_step(model.derivative, start + k * STEP, state, STEP, SPACECRAFT, world), None

    return jax.lax.scan(step, orbits.keplerian_to_cartesian(jnp.array(ELEMENTS)), jnp.arange(steps))[0][:3]


def sweep(steps: int) -> Sweep:
    """A flight for each choice of forces, side by side: weights are numbers, so one program serves all."""
    acted = np.array(list(itertools.product((0.0, 1.0), repeat=len(FORCES))))
    weights = jnp.asarray(np.column_stack([np.ones(len(acted)), acted]))  # the central attraction always acts
    forces = (PointMass(), *FORCES.values())
    begin = clock.perf_counter()
    program = jax.jit(jax.vmap(lambda weights: flight(ForceModel(forces, weights), steps))).lower(weights).compile()
    compiled = clock.perf_counter()
    position = program(weights).block_until_ready()
    end = clock.perf_counter()
    (device,) = position.devices()
    print(f"{len(acted)} flights of {steps} steps on {device.device_kind} ({device.platform}), one program:")
    print(f"compiled in {compiled - begin:.1f} s, flown in {end - compiled:.2f} s")
    return Sweep(acted > 0, np.asarray(position))


def displacements(result: Sweep) -> dict[str, tuple[float, float, float]]:
    """How far each force moves the end [m]: least and most over all choices of the others, and with all others."""
    found = {}
    for k, name in enumerate(FORCES):
        on, off = result.position[result.acted[:, k]], result.position[~result.acted[:, k]]
        moved = np.linalg.norm(on - off, axis=1)  # the order of the others is the same in both
        found[name] = float(moved.min()), float(moved.max()), float(moved[-1])
    return found


def without_weights(result: Sweep, steps: int, names: Sequence[str]) -> float:
    """How far [m] a flight of the sweep is from one whose model has these forces alone, and no weights."""
    chosen = np.array([name in names for name in FORCES])
    (row,) = np.flatnonzero((result.acted == chosen).all(axis=1))
    model = ForceModel((PointMass(), *(FORCES[name] for name in FORCES if name in names)))
    alone = jax.jit(lambda model: flight(model, steps))(model)
    return float(np.linalg.norm(alone - result.position[row]))


def draw(found: dict[str, tuple[float, float, float]], hours: float, file: Path) -> None:
    import matplotlib.pyplot as plt

    names = sorted(found, key=lambda name: found[name][2])
    least, most, others = np.array([found[name] for name in names]).T
    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    axes.barh(names, others, color="tab:blue", label="with all the other forces")
    place = np.arange(len(names))
    axes.hlines(place, least, most, color="black", lw=1.2, label="with any choice of them")
    axes.plot(np.stack([least, most]), np.stack([place, place]), "k|")
    axes.set(xscale="log", xlabel=f"displacement after {hours:g} hours [m]")
    axes.legend(loc="lower right")
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> dict[str, tuple[float, float, float]]:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args(arguments)
    steps = round(3600.0 * options.hours / STEP)
    with jax.enable_x64(True):
        result = sweep(steps)
        apart = without_weights(result, steps, ("J2", "relativity"))
    found = displacements(result)
    for name, (least, most, others) in sorted(found.items(), key=lambda row: -row[1][2]):
        print(f"{name:10} {others:12.3f} m with all others, {least:.3f} to {most:.3f} m with any of them")
    print(f"J2 and relativity alone, in a model without weights: {1e6 * apart:.1f} um apart")
    assert apart < 1e-3
    if options.out:
        draw(found, options.hours, options.out / "sweep.png")
    return found


if __name__ == "__main__":
    main()
