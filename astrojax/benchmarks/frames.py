"""Speed of GCRF to ITRF for a batch of epochs against ERFA (C) and brahe (Rust), in one process, and how far apart.

All take Earth orientation from C04 or zero, IAU 2006/2000A. ERFA sums the whole series for each epoch, as we do with
`PoleSeries()`; shorter series and a table of the pole are the cheaper choices. Ratios carry over between machines.

    python benchmarks/frames.py --output frames.json
"""

import argparse
import json
import platform
import time
from pathlib import Path

import brahe
import erfa
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from astrojax import frames
from astrojax.constants import TT_MINUS_UTC

DAY = 61253  # 2026-08-01
GEO = 4.2164e7


def program(pole, chunk: int):
    """One program: Earth orientation looked up and the rotation built, `chunk` epochs at a time."""

    def one(args):
        eop, day, seconds = args[0], args[1], args[2]
        return frames.rotation_gcrf_to_itrf(day, seconds, eop.at(day, seconds), pole)

    return jax.jit(lambda eop, d, s: jax.lax.map(lambda x: one((eop, *x)), (d, s), batch_size=chunk))


def by_erfa(day: np.ndarray, seconds: np.ndarray, o) -> np.ndarray:
    tt = 2400000.5 + day, (seconds + TT_MINUS_UTC) / 86400.0
    x, y, s = erfa.xys06a(*tt)
    angle = erfa.era00(2400000.5 + day, (seconds + o.ut1_minus_utc) / 86400.0)
    return erfa.c2tcio(erfa.c2ixys(x + o.dx, y + o.dy, s), angle, erfa.pom00(o.x, o.y, erfa.sp00(*tt)))


def timed(call) -> float:
    begin = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=8192, help="epochs")
    parser.add_argument("--peers", type=int, default=1024, help="epochs that ERFA and brahe take (the first of them)")
    parser.add_argument("--chunk", type=int, default=64, help="epochs at a time, so that the series stays in the cache")
    parser.add_argument("--repeat", type=int, default=5, help="best of this many rounds")
    parser.add_argument("--output", type=Path, default=Path("frames.json"), help="JSON of the same figures")
    options = parser.parse_args()

    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())
    rng = np.random.default_rng(0)
    day = DAY + rng.integers(0, 30, options.batch).astype(float)
    seconds = rng.uniform(0.0, 86400.0, options.batch)
    poles = {
        "whole series": frames.PoleSeries(),
        "300 terms": frames.PoleSeries(300),
        "100 terms": frames.PoleSeries(100),
        "30 terms": frames.PoleSeries(30),
    }
    with jax.enable_x64(True):
        eop = frames.load_eop()
        poles["table of the pole"] = frames.pole_table(DAY - 1, 33)
        looked_up = jax.jit(jax.vmap(eop.at))(jnp.asarray(day[: options.peers]), jnp.asarray(seconds[: options.peers]))
        orientation = frames.EarthOrientation(*(np.asarray(v) for v in looked_up))
        few = day[: options.peers], seconds[: options.peers]
        reference = by_erfa(*few, orientation)
        epochs = [brahe.Epoch.from_mjd(d, brahe.TimeSystem.UTC) + float(s) for d, s in zip(*few)]
        calls = {
            "ERFA": (options.peers, lambda: by_erfa(*few, orientation)),
            f"brahe {brahe.__version__}, no orientation": (
                options.peers,
                lambda: [brahe.rotation_gcrf_to_itrf(epoch) for epoch in epochs],
            ),
        }
        rows = {name: {"program": name, "batch": count, "seconds": []} for name, (count, _) in calls.items()}
        for dtype in ("float64", "float32"):
            for name, pole in poles.items():
                start = eop, jnp.asarray(day, dtype), jnp.asarray(seconds, dtype)
                begin = time.perf_counter()
                run = program(pole, options.chunk).lower(*start).compile()
                name = f"astrojax {dtype}, {name}"
                row = {"program": name, "batch": options.batch, "seconds": []}
                row["compile_seconds"] = time.perf_counter() - begin
                apart = np.asarray(run(*start), float)[: options.peers] - reference
                row["apart_radians"] = float(np.abs(apart).max())
                calls[name] = options.batch, lambda run=run, start=start: run(*start)
                rows[name] = row
        # Peers and ours take turns, so that a machine that slows down slows both.
        for _ in range(options.repeat):
            for name, (_, call) in calls.items():
                rows[name]["seconds"].append(timed(call))

    table = Table(title=f"GCRF to ITRF, {options.batch} epochs, {options.chunk} at a time")
    for heading in ("program", "us each", "ratio to ERFA", "apart from ERFA [rad]", "at GEO [m]", "compile [s]"):
        table.add_column(heading, justify="left" if heading == "program" else "right")
    slowest = min(rows["ERFA"]["seconds"]) / rows["ERFA"]["batch"]
    for row in rows.values():
        row["seconds_each"] = min(row.pop("seconds")) / row["batch"]
        row["ratio"] = slowest / row["seconds_each"]
        apart = row.get("apart_radians")
        table.add_row(
            row["program"],
            f"{row['seconds_each'] * 1e6:.2f}",
            f"{row['ratio']:.1f}",
            "-" if apart is None else f"{apart:.1e}",
            "-" if apart is None else f"{apart * GEO:.1e}",
            f"{row['compile_seconds']:.1f}" if "compile_seconds" in row else "-",
        )
    Console().print(table)
    machine = {"python": platform.python_version(), "jax": jax.__version__, "device": jax.devices()[0].platform}
    report = {"machine": machine, "chunk": options.chunk, "rows": list(rows.values())}
    options.output.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
