"""Which of 30 000 objects come close to each other in the next hours: all against all, in JAX.

Every step, SGP4 places all objects in one program. Sorted along one axis, each is compared with those next to it up to
the distance that two objects can close in a step. Where they move straight on past each other within the threshold,
the pair is kept, and its closest approach is then refined with SGP4 itself.

    python astrojax/examples/conjunction.py --objects 30000 --hours 1 --threshold 2 --out .
"""

import argparse
import functools
import time
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from astrojax.orbits import sgp4

try:
    from rich.progress import track
except ImportError:

    def track(steps, description=""):
        return steps


FASTEST = 16e3  # [m/s], of two objects in orbit about the Earth against each other
KEPT = 4096  # candidates that one step may give
AT_ONCE = 64  # of these, by one distance in the order


def synthetic_catalogue(count: int, seed: int = 0) -> sgp4.Sgp4Elements:
    """Objects as they are about the Earth, roughly: nine in ten low, some half way up, some geostationary."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(3, count, p=[0.9, 0.04, 0.06])
    height = np.choose(kind, [rng.uniform(450e3, 1400e3, count), rng.normal(2.02e7, 3e5, count), 3.579e7 + 0 * kind])
    height = height + np.where(kind == 2, rng.normal(0.0, 3e4, count), 0.0)
    e = np.abs(rng.normal(0.0, np.choose(kind, [2e-3, 5e-3, 5e-4])))
    inc = np.choose(kind, [rng.choice([0.93, 1.24, 1.5, 1.71], count), 0.97 + 0 * e, 0.02 + 0 * e])
    inc = np.abs(inc + rng.normal(0.0, 0.03, count))
    angles = rng.uniform(0.0, 2.0 * np.pi, (3, count))
    mean_motion = np.sqrt(3.986e14 / (6.378e6 + height) ** 3)
    bstar = np.where(kind == 0, 1e-4, 0.0)
    day, seconds = np.full(count, 61253.0), np.zeros(count)
    return sgp4.Sgp4Elements(day, seconds, mean_motion, e, inc, *angles, bstar)


@functools.partial(jax.jit, static_argnames="reach")
def screen(satellites, minutes, step, threshold, reach: float):
    """Pairs (KEPT, 2) that pass within `threshold` [m] in half a `step` [s], when and how near, how many, and how many
    were lost."""
    r, v, status = jax.vmap(sgp4.sgp4, in_axes=(0, None))(satellites, minutes)
    # What has no orbit goes where it meets nothing.
    aside = 1e12 * (1.0 + jnp.arange(len(r), dtype=r.dtype))
    r = jnp.where((status == 0)[:, None], r, aside[:, None])
    order = jnp.argsort(r[:, 2])
    r, v = r[order], v[order]
    count = len(r)
    index = jnp.arange(count)

    def compare(state):
        shift, found, passes, total, lost, _ = state
        other = jnp.minimum(index + shift, count - 1)
        dr, dv = r[other] - r, v[other] - v
        near = (index + shift < count) & (dr[:, 2] < reach)
        speed2 = jnp.sum(dv * dv, axis=1)
        when = -jnp.sum(dr * dv, axis=1) / jnp.where(speed2 > 0.0, speed2, 1.0)
        when = jnp.clip(when, -0.5 * step, 0.5 * step)
        least = dr + when[:, None] * dv
        least = jnp.linalg.norm(least, axis=1)
        hit = near & (least < threshold)
        (at,) = jnp.nonzero(hit, size=AT_ONCE, fill_value=count)
        # In order behind what there is; what does not fit is dropped, but counted.
        slots = jnp.where(at < count, total + jnp.arange(AT_ONCE), KEPT)
        safe = jnp.minimum(at, count - 1)
        pairs = jnp.stack([order[safe], order[other[safe]]], axis=1)
        found = found.at[slots].set(pairs, mode="drop")
        passes = passes.at[slots].set(jnp.stack([when[safe], least[safe]], axis=1), mode="drop")
        fits = jnp.minimum(jnp.sum(hit), AT_ONCE)
        return shift + 1, found, passes, total + fits, lost + jnp.sum(hit) - fits, jnp.any(near)

    start = (1, jnp.zeros((KEPT, 2), order.dtype), jnp.zeros((KEPT, 2), r.dtype), 0, 0, True)
    _, found, passes, total, lost, _ = jax.lax.while_loop(lambda state: state[5] & (state[0] < count), compare, start)
    return found, passes, total, lost + jnp.maximum(total - KEPT, 0)


@jax.jit
@jax.vmap
def refine(first, second, minutes):
    """Time [min] and distance [m] of closest approach, by SGP4 of both, and their speed [m/s] then."""

    def apart(minutes):
        (r1, v1, _), (r2, v2, _) = sgp4.sgp4(first, minutes), sgp4.sgp4(second, minutes)
        return r2 - r1, v2 - v1

    def nearer(_, minutes):
        dr, dv = apart(minutes)
        return minutes - jnp.clip(jnp.dot(dr, dv) / jnp.dot(dv, dv), -10.0, 10.0) / 60.0

    minutes = jax.lax.fori_loop(0, 8, nearer, minutes)
    dr, dv = apart(minutes)
    return minutes, jnp.linalg.norm(dr), jnp.linalg.norm(dv)


def conjunctions(elements: sgp4.Sgp4Elements, hours: float, step: float, threshold: float) -> list[tuple]:
    """(first, second, minutes, distance [m], speed [m/s]) of every approach found, by distance.

    Args:
        elements: a catalogue, all of one epoch.
        hours: from epoch.
        step: [s] between screenings; objects move straight on for half of it.
        threshold: [m]. Candidates are kept to it and to what curvature adds in half a step.
    """
    satellites = jax.jit(jax.vmap(sgp4.sgp4_init))(elements)
    bend = 0.5 * 9.8 * (0.5 * step) ** 2 * 2.0
    wide = threshold + bend
    reach = wide + 0.5 * step * FASTEST
    best: dict[tuple, tuple[float, float]] = {}  # nearest by straight lines, and when
    for minutes in track(np.arange(0.0, 60.0 * hours, step / 60.0), description="screening"):
        found, passes, total, lost = screen(satellites, minutes, step, wide, reach)
        if lost:
            print(f"{lost} candidates at minute {minutes:.1f} did not fit: raise KEPT and AT_ONCE, or ask for less")
        kept = min(int(total), KEPT)
        for (a, b), (dt, least) in zip(np.asarray(found)[:kept].tolist(), np.asarray(passes)[:kept].tolist()):
            key = min(a, b), max(a, b), int(minutes // 20)
            best[key] = min(best.get(key, (np.inf, 0.0)), (least, minutes + dt / 60.0))
    if not best:
        return []
    pairs = np.array([key[:2] for key in best])
    when = np.array([minutes for _, minutes in best.values()])
    size = 1 << (len(when) - 1).bit_length()  # few shapes, few programs
    pad = np.resize(np.arange(len(when)), size)
    each = [jax.tree.map(lambda leaf, k=k: leaf[pairs[pad, k]], satellites) for k in (0, 1)]
    when, distance, speed = (np.asarray(x)[: len(when)] for x in refine(*each, when[pad]))
    rows = sorted(zip(pairs[:, 0], pairs[:, 1], when, distance, speed), key=lambda row: row[3])
    return [row for row in rows if row[3] < threshold and 0.0 <= row[2] <= 60.0 * hours]


def brute_force(elements: sgp4.Sgp4Elements, seconds: int, threshold: float) -> dict[tuple[int, int], float]:
    """The closest approach [m] of each pair that has one within `threshold` [m]: all pairs, every second, no sorting.

    Between the seconds two objects pass each other on straight lines, which is off by some metres at most. Pairs that
    are closest at the first or the last instant are left out: they approach each other before or after.
    """
    satellites = jax.jit(jax.vmap(sgp4.sgp4_init))(elements)
    count = len(elements.e)

    def second(at, kept):
        nearest, found = kept
        r, v, status = jax.vmap(sgp4.sgp4, in_axes=(0, None))(satellites, at / 60.0)
        dr, dv = (tuple(x[:, None] - x for x in rows) for rows in (r.T, v.T))
        speed2 = sum(x * x for x in dv)
        when = -sum(x * u for x, u in zip(dr, dv)) / jnp.where(speed2 > 0.0, speed2, 1.0)
        when = jnp.clip(when, -0.5, 0.5)
        apart = jnp.sqrt(sum((x + when * u) ** 2 for x, u in zip(dr, dv)))
        nearer = (apart < nearest) & (status == 0) & (status == 0)[:, None]
        return jnp.where(nearer, apart, nearest), jnp.where(nearer, at + when, found)

    start = jnp.full((count, count), jnp.inf), jnp.zeros((count, count))
    nearest, found = map(np.asarray, jax.jit(lambda kept: jax.lax.fori_loop(0, seconds + 1, second, kept))(start))
    within = (nearest < threshold) & (found > 0.0) & (found < seconds)
    return {(int(a), int(b)): float(nearest[a, b]) for a, b in np.argwhere(np.triu(within, 1))}


def compare(objects: int, seconds: int, threshold: float) -> tuple[int, int, float]:
    """Approaches that brute force finds, how many screening misses, how far apart their distances [m] are at most."""
    elements = synthetic_catalogue(objects, seed=1)
    screened: dict[tuple[int, int], float] = {}
    # A little wider: what is right at the threshold may be found by one of the two alone.
    for first, second, _, distance, _ in conjunctions(elements, seconds / 3600.0, 8.0, 1.01 * threshold):
        pair = min(int(first), int(second)), max(int(first), int(second))
        screened[pair] = min(float(distance), screened.get(pair, np.inf))
    checked = brute_force(elements, seconds, threshold)
    apart = [abs(screened[pair] - distance) for pair, distance in checked.items() if pair in screened]
    return len(checked), len(checked.keys() - screened.keys()), max(apart, default=0.0)


def draw(rows: list[tuple], threshold: float, file: Path) -> None:
    import matplotlib.pyplot as plt

    distance = np.array([row[3] for row in rows])
    figure, axes = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
    axes.loglog(1e-3 * distance, np.arange(1, len(rows) + 1), "o", ms=3, label="found")
    grid = np.geomspace(distance[0], threshold, 50)
    axes.loglog(1e-3 * grid, len(rows) * (grid / threshold) ** 2, "k-", lw=1, label="square of the distance")
    axes.set(xlabel="closest approach [km]", ylabel="approaches at least as close")
    axes.legend()
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> tuple[list[tuple], int, int, float]:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--objects", type=int, default=30000)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--step", type=float, default=8.0, help="seconds")
    parser.add_argument("--threshold", type=float, default=2.0, help="kilometres")
    parser.add_argument("--checked", type=int, default=400, help="objects of the comparison with brute force")
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args(arguments)
    with jax.enable_x64(True):
        begin = time.perf_counter()
        rows = conjunctions(synthetic_catalogue(options.objects), options.hours, options.step, 1e3 * options.threshold)
        seconds = time.perf_counter() - begin
        checked, missed, apart = compare(options.checked, 300, 200e3)
    print(f"{len(rows)} approaches below {options.threshold:g} km in {seconds:.1f} s, compiling included")
    for first, second, minutes, distance, speed in rows[:10]:
        print(f"{first:6d} {second:6d}  minute {minutes:7.2f}  {distance:8.1f} m  at {1e-3 * speed:6.2f} km/s")
    print(f"brute force, {options.checked} objects for 5 minutes: {checked} approaches below 200 km,")
    print(f"of which screening misses {missed}; distances differ by at most {apart:.1g} m")
    if options.out and rows:
        draw(rows, 1e3 * options.threshold, options.out / "conjunction.png")
    return rows, checked, missed, apart


if __name__ == "__main__":
    main()
