"""Speed of our batched LEO propagation against brahe's, in one process, and how far the two end apart.

Both fly the same orbits with J2 to J4, Sun, Moon and Harris-Priester drag under fixed-step RK4, with Earth's
pole held at the inertial z axis (brahe's full precession and nutation, which we don't model, would slow it).
Ours is one compiled program over the whole batch; brahe (Rust) propagates its orbits with its own parallel
call. Ratios carry over between machines, absolute times do not.

    python benchmarks/propagation.py --output propagation.json
"""

import argparse
import json
import platform
import time
from pathlib import Path

import brahe
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from astrojax import forces, orbits, propagate
from astrojax import time as epochs

DAY = 61253  # 2026-08-01
MASS, AREA, CD = 12000.0, 50.0, 2.2
SPACECRAFT = forces.Spacecraft(MASS, AREA, CD)
MODEL = forces.ForceModel(
    (
        forces.PointMass(),
        forces.Zonal(4),
        forces.ThirdBody("sun"),
        forces.ThirdBody("moon"),
        forces.Drag(forces.HarrisPriester()),
    )
)


def initial_elements(count: int) -> np.ndarray:
    """Orbits like the space station's, spread in node, perigee and phase."""
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.0, 2.0 * np.pi, (count, 3))
    fixed = np.broadcast_to([6795e3, 0.0005, np.radians(51.64)], (count, 3))
    return np.concatenate([fixed, spread], axis=1)


def batched_propagation(steps: int, dt: float):
    """One program: all orbits through all steps, Sun and Moon once a step and for each orbit's own epoch."""

    def fly(state, start):
        def step(state, i):
            day, seconds = epochs.normalize_epoch(jnp.asarray(DAY, state.dtype), start + i * dt)
            world = MODEL.environment(day, seconds)
            return propagate.rk4_step(MODEL.derivative, i * dt, state, dt, SPACECRAFT, world), None

        return jax.lax.scan(step, state, jnp.arange(steps, dtype=state.dtype))[0]

    return jax.jit(jax.vmap(fly))


def brahe_run(states: np.ndarray, steps: int, dt: float) -> tuple[float, np.ndarray]:
    """Seconds and final states of brahe's numerical propagators with the same forces."""
    peers = brahe.ForceModelConfig(
        gravity=brahe.GravityConfiguration.earth_zonal(brahe.ZonalHarmonicsDegree.J4),
        drag=brahe.DragConfiguration(
            model=brahe.AtmosphericModel.HARRIS_PRIESTER,
            area=brahe.ParameterSource.value(AREA),
            cd=brahe.ParameterSource.value(CD),
        ),
        third_body=[
            brahe.ThirdBodyConfiguration(body, brahe.EphemerisSource.LowPrecision)
            for body in (brahe.ThirdBody.SUN, brahe.ThirdBody.MOON)
        ],
        mass=brahe.ParameterSource.value(MASS),
        frame_transform=brahe.FrameTransformationModel.EARTH_ROTATION_ONLY,
    )
    config = brahe.NumericalPropagationConfig.with_method(brahe.IntegrationMethod.RK4)
    config = config.with_initial_step(dt).with_max_step(dt)
    epoch = brahe.Epoch.from_mjd(float(DAY), brahe.TimeSystem.UTC)
    propagators = [brahe.NumericalOrbitPropagator(epoch, s, config, peers) for s in states]
    for p in propagators:
        p.set_trajectory_mode(brahe.TrajectoryMode.DISABLED)
    begin = time.perf_counter()
    brahe.par_propagate_to(propagators, epoch + steps * dt)
    return time.perf_counter() - begin, np.array([p.current_state() for p in propagators])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=1024, help="orbits in our program")
    parser.add_argument("--peers", type=int, default=64, help="orbits that brahe flies (the first of the same batch)")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--dt", type=float, default=10.0, help="step [s]")
    parser.add_argument("--repeat", type=int, default=7, help="best of this many rounds")
    parser.add_argument("--output", type=Path, default=Path("propagation.json"), help="JSON of the same figures")
    options = parser.parse_args()

    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())
    oe = initial_elements(options.batch)
    rows = [{"program": f"brahe {brahe.__version__} float64", "batch": options.peers, "seconds": []}]
    programs = []
    with jax.enable_x64(True):
        states = np.asarray(jax.jit(jax.vmap(orbits.keplerian_to_cartesian))(jnp.asarray(oe)))
        for dtype in ("float64", "float32"):
            for batch in (1, options.batch):
                start = jnp.asarray(states[:batch], dtype), jnp.zeros(batch, dtype)
                begin = time.perf_counter()
                program = batched_propagation(options.steps, options.dt).lower(*start).compile()
                compilation = time.perf_counter() - begin
                rows.append({"program": f"astrojax {dtype}", "batch": batch, "seconds": []})
                rows[-1]["compile_seconds"] = compilation
                programs.append((program, start))
        # Peers and ours take turns, so that a machine that slows down slows both.
        for _ in range(options.repeat):
            seconds, reference = brahe_run(states[: options.peers], options.steps, options.dt)
            rows[0]["seconds"].append(seconds)
            for row, (program, start) in zip(rows[1:], programs):
                begin = time.perf_counter()
                end = program(*start).block_until_ready()
                row["seconds"].append(time.perf_counter() - begin)
                count = min(row["batch"], options.peers)
                apart = np.asarray(end, float)[:count, :3] - reference[:count, :3]
                row["apart_metres"] = float(np.linalg.norm(apart, axis=1).max())
    for row in rows:
        row["rate"] = row["batch"] * options.steps / min(row.pop("seconds"))

    flight = options.steps * options.dt
    table = Table(title=f"LEO propagation, RK4, {options.steps} steps of {options.dt:g} s")
    for heading in (
        "program",
        "batch",
        "steps/s",
        "ratio to brahe",
        f"apart after {flight:g} s [m]",
        "compile [s]",
    ):
        table.add_column(heading, justify="left" if heading == "program" else "right")
    for row in rows:
        row["ratio"] = row["rate"] / rows[0]["rate"]
        table.add_row(
            row["program"],
            str(row["batch"]),
            f"{row['rate']:,.0f}",
            f"{row['ratio']:.1f}",
            f"{row['apart_metres']:.1e}" if "apart_metres" in row else "-",
            f"{row['compile_seconds']:.1f}" if "compile_seconds" in row else "-",
        )
    Console().print(table)
    machine = {
        "python": platform.python_version(),
        "jax": jax.__version__,
        "device": jax.devices()[0].platform,
    }
    report = {"machine": machine, "steps": options.steps, "dt_seconds": options.dt, "rows": rows}
    options.output.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
