"""Speed of our batched SGP4 against python-sgp4's `SatrecArray` (C++) and, where installed, `jaxsgp4`.

All fly the same synthetic catalogue: the verification satellites that stay in orbit, with their elements perturbed. The
near-Earth part of it is also timed by itself, in the program made for it. Ratios carry over between machines, absolute
times do not.

    python benchmarks/sgp4_catalogue.py --satellites 30000 --times 10 --output sgp4.json
"""

import argparse
import importlib.resources
import json
import platform
import time
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.table import Table
from sgp4.api import WGS72, Satrec, SatrecArray

from astrojax.orbits.sgp4 import Sgp4Elements, is_deep_space, read_tle, sgp4, sgp4_init, stack_elements


def catalogue(count: int, seed: int = 0) -> Sgp4Elements:
    """`count` sets about those of the verification file, three in four of them near the Earth."""
    text = (importlib.resources.files("sgp4") / "SGP4-VER.TLE").read_text(encoding="ascii")
    elements = stack_elements([s.elements for s in read_tle(text, check=False)])
    rng = np.random.default_rng(seed)
    deep = is_deep_space(elements)
    steady = (elements.e < 0.8) & (elements.mean_motion > 5e-5) & (elements.mean_motion < 1.14e-3)
    near_pick = rng.choice(np.flatnonzero(steady & ~deep), count)
    deep_pick = rng.choice(np.flatnonzero(steady & deep), count)
    pick = np.where(rng.uniform(size=count) < 0.75, near_pick, deep_pick)
    e = jax.tree.map(lambda leaf: leaf[pick], elements)
    turns = {name: rng.uniform(0.0, 2.0 * np.pi, count) for name in ("raan", "argp", "mean_anomaly")}
    inc = np.clip(e.inc + rng.normal(0.0, 0.1, count), 1e-3, 3.1)
    return e._replace(mean_motion=e.mean_motion * rng.uniform(0.99, 1.01, count), inc=inc, **turns)


def satrecs(elements: Sgp4Elements) -> SatrecArray:
    """The same satellites in C++."""
    found = []
    for e in zip(*elements):
        satellite = Satrec()
        angles = (e[6], e[4], e[7], 60.0 * e[2], e[5])
        epoch = e[0] - 33281.0 + e[1] / 86400.0
        satellite.sgp4init(WGS72, "i", 1, epoch, e[8], 0.0, 0.0, e[3], *angles)
        found.append(satellite)
    return SatrecArray(found)


def best(run, repeats: int) -> float:
    """Seconds of the fastest of some runs, the first of which is not counted."""
    run()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def ours(elements: Sgp4Elements, minutes: np.ndarray, deep_space: bool, repeats: int):
    """Seconds to prepare and to fly, and the positions [m], (satellites, times, 3)."""
    init = jax.jit(jax.vmap(lambda e: sgp4_init(e, deep_space=deep_space)))
    fly = jax.jit(jax.vmap(jax.vmap(sgp4, in_axes=(None, 0)), in_axes=(0, None)))
    prepare = best(lambda: jax.block_until_ready(init(elements)), repeats)
    satellites = init(elements)
    seconds = best(lambda: jax.block_until_ready(fly(satellites, minutes)), repeats)
    return prepare, seconds, fly(satellites, minutes)


def theirs(elements: Sgp4Elements, minutes: np.ndarray, repeats: int):
    """Seconds of the C++ code for the same, and what it gives; the epoch is one for all."""
    array = satrecs(elements)
    day, seconds = float(elements.day[0]), float(elements.seconds[0])
    whole, part = np.full(minutes.size, day + 2400000.5), seconds / 86400.0 + minutes / 1440.0
    return best(lambda: array.sgp4(whole, part), repeats), array.sgp4(whole, part)


def rival(elements: Sgp4Elements, minutes: np.ndarray, repeats: int) -> float | None:
    """Seconds of `jaxsgp4` for near-Earth satellites; none where it is not installed or its calls are others."""
    try:
        from jaxsgp4 import sgp4 as other
    except ImportError:
        return None
    try:
        fly = jax.jit(jax.vmap(jax.vmap(other, in_axes=(None, 0)), in_axes=(0, None)))
        return best(lambda: jax.block_until_ready(fly(elements, minutes)), repeats)
    except Exception as error:
        Console().print(f"jaxsgp4 is installed, but could not be called: {error!r}")
        return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--satellites", type=int, default=30000)
    parser.add_argument("--times", type=int, default=10, help="per satellite, over a day")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()

    everything = catalogue(options.satellites)
    # One epoch for all: SatrecArray takes absolute times, ours minutes since each epoch.
    everything = everything._replace(
        day=np.full(options.satellites, 53912.0), seconds=np.full(options.satellites, 43200.0)
    )
    minutes = np.linspace(0.0, 1440.0, options.times)
    near = jax.tree.map(lambda leaf: leaf[~is_deep_space(everything)], everything)

    rows = []
    for name, elements, deep_space in [("whole catalogue", everything, True), ("near Earth", near, False)]:
        cpp, (codes, r, _) = theirs(elements, minutes, options.repeats)
        for x64 in (True, False):
            with jax.enable_x64(x64):
                dtype = np.float64 if x64 else np.float32
                cast = jax.tree.map(lambda leaf, dtype=dtype: leaf.astype(dtype), elements)
                prepare, seconds, (position, _, status) = ours(cast, minutes.astype(dtype), deep_space, options.repeats)
                other = rival(cast, minutes.astype(dtype), options.repeats) if not deep_space else None
            good = (np.asarray(status) == 0) & (codes == 0)
            off = np.linalg.norm(np.asarray(position, float) - 1e3 * r, axis=-1)[good]
            rows.append(
                {
                    "catalogue": name,
                    "dtype": np.dtype(dtype).name,
                    "satellites": len(elements.e),
                    "propagations_per_second": position.shape[0] * position.shape[1] / seconds,
                    "prepared_per_second": len(elements.e) / prepare,
                    "times_sgp4_cpp": cpp / seconds,
                    "times_jaxsgp4": other / seconds if other else None,
                    "apart_median_m": float(np.median(off)),
                    "apart_most_m": float(np.max(off)),
                }
            )

    table = Table(title=f"SGP4, {options.times} times each, {jax.devices()[0].device_kind}")
    for heading in ("catalogue", "dtype", "million/s", "of C++", "of jaxsgp4", "apart, median [m]", "most [m]"):
        table.add_column(heading, justify="right")
    for row in rows:
        other = row["times_jaxsgp4"]
        table.add_row(
            row["catalogue"],
            row["dtype"],
            f"{row['propagations_per_second'] / 1e6:.2f}",
            f"{row['times_sgp4_cpp']:.2f}",
            "-" if other is None else f"{other:.2f}",
            f"{row['apart_median_m']:.2g}",
            f"{row['apart_most_m']:.2g}",
        )
    Console().print(table)
    if options.output:
        found = {"machine": platform.processor(), "device": jax.devices()[0].device_kind, "rows": rows}
        options.output.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
