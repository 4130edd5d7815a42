"""When does a satellite pass over a station, and can it be seen? SGP4, Earth orientation, Sun, shadow.

    python astrojax/examples/stations.py --hours 24 --out .

The picture, drawn with `--out`, needs matplotlib.
"""

import argparse
import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from astrojax import ephemeris, frames, time
from astrojax.orbits import sgp4

TLE = """ISS (ZARYA)
1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927
2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537
"""
STATION = (math.radians(40.43), math.radians(-4.25), 720.0)  # geodetic latitude, longitude [rad], height [m]
LEAST = math.radians(10.0)  # elevation from which a pass counts
DARK = math.radians(-6.0)  # elevation of the Sun below which it is dark at the station


class Sight(NamedTuple):
    """What the station has before it: azimuth and elevation [rad], range [m], sunlit share, Sun's elevation [rad]."""

    azimuth: jax.Array
    elevation: jax.Array
    distance: jax.Array
    sunlit: jax.Array
    sun: jax.Array


class Pass(NamedTuple):
    """Rise, culmination and set [minutes from the elements' epoch], and the sight of each."""

    minutes: tuple[float, float, float]
    sights: tuple[Sight, Sight, Sight]


def sight(satellite: sgp4.Sgp4Satellite, epoch: tuple, orientation: frames.EarthOrientation, minutes) -> Sight:
    """The sight at one instant; TEME to ITRF for the satellite, GCRF to ITRF for the Sun."""
    station = jnp.array(STATION)
    day, seconds = epoch[0], epoch[1] + 60.0 * minutes
    r, _, _ = sgp4.sgp4(satellite, minutes)
    fixed = frames.rotation_teme_to_itrf(day, seconds, orientation) @ r
    # The Sun is known to 0.012 deg: the twenty largest terms of nutation are plenty.
    turn = frames.rotation_gcrf_to_itrf_equinox(day, seconds, orientation, terms=20)
    sun = turn @ ephemeris.sun_position(day, seconds)
    azimuth, elevation, distance = frames.azimuth_elevation_range(station, fixed)
    lit = ephemeris.illumination_conical(fixed, sun)
    return Sight(azimuth, elevation, distance, lit, frames.azimuth_elevation_range(station, sun)[1])


def zeros(g: Callable, times: jax.Array) -> tuple[np.ndarray, np.ndarray]:
    """Where g changes its sign between neighbours of `times`, and whether it rises there: halved forty times."""

    @jax.jit
    def program(times):
        values = jax.vmap(g)(times)

        def halve(_, ends):
            a, b = ends
            middle = 0.5 * (a + b)
            before = jnp.sign(jax.vmap(g)(middle)) == jnp.sign(values[:-1])
            return jnp.where(before, middle, a), jnp.where(before, b, middle)

        a, b = jax.lax.fori_loop(0, 40, halve, (times[:-1], times[1:]))
        return values, 0.5 * (a + b)

    values, where = map(np.asarray, program(times))
    change = np.sign(values[:-1]) != np.sign(values[1:])
    return where[change], values[1:][change] > 0


def passes(see: Callable[[jax.Array], Sight], minutes: np.ndarray, least: float) -> list[Pass]:
    """All passes above an elevation [rad] that begin and end within `minutes`, which are a minute or less apart."""

    def elevation(t):
        return see(t).elevation

    crossings, rising = zeros(lambda t: elevation(t) - least, jnp.asarray(minutes))
    tops, turning = zeros(jax.grad(elevation), jnp.asarray(minutes))
    tops = tops[~turning]
    found = []
    for rise, fall in zip(crossings[rising], crossings[1:][rising[:-1]]):
        top = tops[(rise < tops) & (tops < fall)]
        if len(top):
            found.append((rise, top[0], fall))
    sights = jax.tree.map(np.asarray, jax.jit(jax.vmap(see))(jnp.array(found).reshape(-1)))
    return [
        Pass(when, tuple(jax.tree.map(lambda leaf, i=3 * k + j: float(leaf[i]), sights) for j in range(3)))
        for k, when in enumerate(found)
    ]


def seconds_by_counting(see: Callable, found: list[Pass], least: float) -> float:
    """How far [s] any rise or set is from the second at which plain counting finds it."""

    @jax.jit
    def up(minutes):
        return jax.lax.map(lambda t: see(t).elevation > least, minutes, batch_size=4096)

    worst = 0.0
    for rise, _, fall in (each.minutes for each in found):
        seconds = np.arange(math.floor(60 * rise) - 30, math.ceil(60 * fall) + 30)
        seen = seconds[np.asarray(up(jnp.asarray(np.resize(seconds, 900) / 60.0)))[: len(seconds)]]
        worst = max(worst, seen[0] - 60 * rise, 60 * fall - seen[-1])
    return worst


def draw(see: Callable, found: list[Pass], file: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(subplot_kw={"projection": "polar"}, figsize=(6.0, 5.5), layout="constrained")
    axes.set(
        theta_zero_location="N", theta_direction=-1, rlim=(0, 90), yticks=(30, 60, 80), yticklabels=("60", "30", "10")
    )
    look = jax.jit(jax.vmap(see))
    for each in found:
        times = jnp.linspace(each.minutes[0], each.minutes[2], 200)
        path = jax.tree.map(np.asarray, look(times))
        lit = path.sunlit > 0.5
        height = 90.0 - np.degrees(path.elevation)
        axes.plot(path.azimuth, np.where(lit, height, np.nan), lw=2.5, color="tab:orange")
        axes.plot(path.azimuth, np.where(lit, np.nan, height), lw=1.5, color="0.4")
        axes.annotate(f"{each.minutes[0]:.0f} min", (path.azimuth[0], height[0]), fontsize=8)
    axes.plot([], [], lw=2.5, color="tab:orange", label="sunlit")
    axes.plot([], [], lw=1.5, color="0.4", label="in the Earth's shadow")
    axes.legend(loc="lower left", bbox_to_anchor=(-0.1, -0.08))
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> list[Pass]:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args(arguments)
    with jax.enable_x64(True):
        (satellite,) = sgp4.read_tle(TLE)
        day, seconds = satellite.elements.day, satellite.elements.seconds
        orientation = frames.load_eop().at(day, seconds)
        prepared = jax.jit(sgp4.sgp4_init)(satellite.elements)
        see = functools.partial(sight, prepared, (day, seconds), orientation)
        found = passes(see, np.arange(0.0, 60.0 * options.hours + 0.5, 0.5), LEAST)
        worst = seconds_by_counting(see, found, LEAST)
        if options.out:
            draw(see, found, options.out / "stations.png")
    print(f"{satellite.name}: {len(found)} passes in {options.hours:g} hours")
    print("rise (UTC)           azimuth   culminates  elevation  range    set       sunlit at all three; sky")
    for each in found:
        instants = [time.epoch(day, seconds) + 60.0 * t for t in each.minutes]
        rise, top, fall = (time.epoch_to_iso(instant, 0).rstrip("Z") for instant in instants)
        first, middle, _ = each.sights
        lit = " ".join("yes" if s.sunlit > 0.5 else "no " for s in each.sights)
        print(
            f"{rise}  {math.degrees(first.azimuth):5.0f} deg  {top[11:]}   {math.degrees(middle.elevation):5.1f} deg"
            f"  {1e-3 * middle.distance:5.0f} km  {fall[11:]}  {lit}; {'dark' if middle.sun < DARK else 'bright'}"
        )
    print(f"rises and sets counted second by second differ by at most {worst:.2f} s")
    return found


if __name__ == "__main__":
    main()
