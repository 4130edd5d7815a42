"""Speed of NRLMSISE-00 over a batch of places and times, against pymsis (Fortran) and brahe (Rust), in one process.

pip install pymsis
python astrojax/benchmarks/density.py --output density.json
"""

import argparse
import json
import time
from pathlib import Path

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pymsis
from rich.console import Console
from rich.table import Table

from astrojax.compilation import compiler_options
from astrojax.forces import atmosphere


def points(count: int) -> dict[str, np.ndarray]:
    """Places from 200 to 900 km, over one day."""
    rng = np.random.default_rng(0)
    return {
        "height": rng.uniform(200e3, 900e3, count),
        "latitude": rng.uniform(-1.5, 1.5, count),
        "longitude": rng.uniform(-3.1, 3.1, count),
        "seconds": rng.uniform(0.0, 86400.0, count),
    }


def best(call, repeat: int) -> float:
    """Shortest of several times [s]."""
    call()
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def ours(at: dict[str, np.ndarray], dtype):
    weather = atmosphere.constant_space_weather(*(jnp.asarray(x, dtype) for x in (150.0, 150.0, 15.0)))

    def density(height, latitude, longitude, seconds):
        return atmosphere.nrlmsise00(height, latitude, longitude, 153, seconds, weather).density_effective

    compiled = jax.jit(jax.vmap(density), compiler_options=compiler_options())
    arguments = [jnp.asarray(value, dtype) for value in at.values()]
    return lambda: jax.block_until_ready(compiled(*arguments))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=16384)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    at = points(options.points)
    degrees = {name: np.degrees(at[name]) for name in ("latitude", "longitude")}
    dates = np.datetime64("2024-06-01") + (at["seconds"] * 1e6).astype("timedelta64[us]")
    weather = (np.full(options.points, 150.0), np.full(options.points, 150.0), np.full((options.points, 7), 15.0))
    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())
    brahe.set_global_space_weather_provider(brahe.StaticSpaceWeatherProvider.from_values(3.0, 15.0, 150.0, 150.0, 100))
    start = brahe.Epoch.from_date(2024, 6, 1, brahe.TimeSystem.UTC)
    epochs = [start + float(s) for s in at["seconds"]]
    places = np.column_stack([degrees["longitude"], degrees["latitude"], at["height"]])

    with jax.enable_x64(True):
        calls = {
            "ours, float64": ours(at, jnp.float64),
            "ours, float32": ours(at, jnp.float32),
            "pymsis (single precision)": lambda: pymsis.calculate(
                dates, degrees["longitude"], degrees["latitude"], at["height"] / 1e3, *weather, version=0
            ),
            "brahe": lambda: [brahe.density_nrlmsise00_geod(e, x) for e, x in zip(epochs, places, strict=True)],
        }
        rates = {name: options.points / best(call, options.repeat) for name, call in calls.items()}
    table = Table("NRLMSISE-00", "densities a second", "ours in float64, times it")
    for name, rate in rates.items():
        table.add_row(name, f"{rate:,.0f}", f"{rates['ours, float64'] / rate:.2f}")
    Console().print(table)
    if options.output:
        options.output.write_text(json.dumps({"points": options.points, "rates": rates}, indent=2) + "\n")


if __name__ == "__main__":
    main()
