"""Speed of the standard LEO force model here, with brahe and, if asked, with the `astrojax` of PyPI, in one run.

Gravity to some degree and order, Harris-Priester drag, solar radiation pressure with a conical shadow, Sun and Moon,
under fixed-step RK4: the same orbits, forces and steps. Ours turns the Earth about the pole of J2000 and so does brahe
(EARTH_ROTATION_ONLY); a row more gives brahe with precession and nutation (FULL_EARTH_ROTATION, its default). Ours is
one compiled program over the batch, with Sun and Moon held over a step and the environment shared by all orbits, which
are of one epoch; brahe (Rust) evaluates everything for each orbit and stage. Ratios carry over between machines,
absolute times do not.

    python benchmarks/forces.py --output forces.json
    python benchmarks/forces.py --peer-python /path/to/venv/bin/python

`--peer-python` is an interpreter in whose environment the other project named astrojax is installed; it runs
`peer_astrojax.py` in a process of its own, after the others.
"""

import argparse
import json
import os
import platform
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

DAY = 61253  # 2026-08-01
MASS, AREA, CD, CR = 1000.0, 10.0, 2.2, 1.3
DEGREES = (5, 20, 70)


def initial_elements(count: int) -> np.ndarray:
    """Low orbits of 500 to 600 km, of all inclinations, spread in node, perigee and phase."""
    rng = np.random.default_rng(0)
    low = [6.878e6, 0.0005, 0.2, 0.0, 0.0, 0.0]
    high = [6.978e6, 0.002, 2.9, 2 * np.pi, 2 * np.pi, 2 * np.pi]
    return rng.uniform(low, high, (count, 6))


def our_program(degree: int, steps: int, dt: float):
    """One program: all orbits through all steps, the environment once a step and shared over the batch."""
    import jax
    import jax.numpy as jnp

    from astrojax import forces, propagate
    from astrojax import time as epochs

    field = forces.gravity_field("EGM2008")
    model = forces.ForceModel(
        (
            forces.PointMass(field.gm),
            forces.SphericalHarmonics(field, degree),
            forces.ThirdBody("sun"),
            forces.ThirdBody("moon"),
            forces.Drag(forces.HarrisPriester()),
            forces.SolarRadiation(),
        )
    )
    craft = forces.Spacecraft(MASS, AREA, CD, AREA, CR)

    def fly(states):
        def step(states, i):
            day, seconds = epochs.normalize_epoch(jnp.asarray(DAY, states.dtype), i * dt)
            # The Earth turns within a step, the rest hardly moves.
            world = model.environment(day, seconds)

            def derivative(t, state):
                return model.derivative(t, state, craft, world._replace(rotation=forces.earth_rotation(day, t)))

            def advance(state):
                return propagate.rk4_step(derivative, seconds, state, jnp.asarray(dt, state.dtype))

            return jax.vmap(advance)(states), None

        return jax.lax.scan(step, states, jnp.arange(steps, dtype=states.dtype))[0]

    return jax.jit(fly)


def brahe_run(states: np.ndarray, degree: int, steps: int, dt: float, frames: str) -> tuple[float, np.ndarray]:
    """Seconds and final states of brahe's numerical propagators with the same forces."""
    import brahe

    value = brahe.ParameterSource.value
    low = brahe.EphemerisSource.LowPrecision
    peers = brahe.ForceModelConfig(
        gravity=brahe.GravityConfiguration(degree=degree, order=degree),
        drag=brahe.DragConfiguration(model=brahe.AtmosphericModel.HARRIS_PRIESTER, area=value(AREA), cd=value(CD)),
        srp=brahe.SolarRadiationPressureConfiguration(
            area=value(AREA), cr=value(CR), eclipse_model=brahe.EclipseModel.CONICAL
        ),
        third_body=[brahe.ThirdBodyConfiguration(body, low) for body in (brahe.ThirdBody.SUN, brahe.ThirdBody.MOON)],
        mass=value(MASS),
        frame_transform=getattr(brahe.FrameTransformationModel, frames),
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


def peer_run(python: Path, states: np.ndarray, degree: int, dtype: str, options: argparse.Namespace) -> dict:
    """What `peer_astrojax.py` reports, run by another interpreter without our paths."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "states.npy", states)
        numbers = {"degree": degree, "steps": options.steps, "dt": options.dt, "repeat": options.repeat, "dtype": dtype}
        command = [str(python), str(Path(__file__).with_name("peer_astrojax.py")), str(Path(folder) / "states.npy")]
        command += [f"--{name}={value}" for name, value in numbers.items()]
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=256, help="orbits in our program")
    parser.add_argument("--peers", type=int, default=64, help="orbits that brahe flies (the first of the same batch)")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--dt", type=float, default=10.0, help="step [s]")
    parser.add_argument("--repeat", type=int, default=5, help="best of this many rounds")
    parser.add_argument("--degrees", type=int, nargs="+", default=list(DEGREES), help="degree and order of gravity")
    parser.add_argument("--peer-python", type=Path, help="interpreter that has the other astrojax (PyPI)")
    parser.add_argument("--output", type=Path, default=Path("forces.json"), help="JSON of the same figures")
    options = parser.parse_args()

    import brahe
    import jax
    import jax.numpy as jnp
    from rich.console import Console
    from rich.table import Table

    from astrojax import orbits

    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())
    rows = []
    with jax.enable_x64(True):
        elements = jnp.asarray(initial_elements(options.batch))
        states = np.asarray(jax.jit(jax.vmap(orbits.keplerian_to_cartesian))(elements))
        for degree in options.degrees:
            peers = {"degree": degree, "program": f"brahe {brahe.__version__} float64"}
            kinds = ((1, "EARTH_ROTATION_ONLY"), (options.peers, "EARTH_ROTATION_ONLY"))
            kinds = (*kinds, (options.peers, "FULL_EARTH_ROTATION"))
            peer_rows = [peers | {"batch": count, "frames": frames, "seconds": []} for count, frames in kinds]
            peer_rows[2]["program"] += ", full frames"
            ours, programs = [], []
            for dtype in ("float64", "float32"):
                for batch in (1, options.batch):
                    start = jnp.asarray(states[:batch], dtype)
                    begin = time.perf_counter()
                    programs.append((our_program(degree, options.steps, options.dt).lower(start).compile(), start))
                    ours.append({"degree": degree, "program": f"astrojax {dtype}", "batch": batch, "seconds": []})
                    ours[-1]["compile_seconds"] = time.perf_counter() - begin
            # Peers and ours take turns, so that a machine that slows down slows both.
            for _ in range(options.repeat):
                for row in peer_rows:
                    flight = states[: row["batch"]], degree, options.steps, options.dt, row["frames"]
                    seconds, end = brahe_run(*flight)
                    row["seconds"].append(seconds)
                    if row["batch"] == options.peers and row["frames"] == "EARTH_ROTATION_ONLY":
                        reference = end
                for row, (program, start) in zip(ours, programs):
                    begin = time.perf_counter()
                    end = program(start).block_until_ready()
                    row["seconds"].append(time.perf_counter() - begin)
                    count = min(row["batch"], options.peers)
                    apart = np.asarray(end, float)[:count, :3] - reference[:count, :3]
                    row["apart_metres"] = float(np.linalg.norm(apart, axis=1).max())
            for dtype in ("float64", "float32") if options.peer_python else ():
                told = peer_run(options.peer_python, states, degree, dtype, options)
                row = {"degree": degree, "program": f"astrojax (PyPI) {told['version']} {dtype}", "batch": len(states)}
                apart = np.asarray(told["end"])[: options.peers] - reference[:, :3]
                row |= {"seconds": told["seconds"], "compile_seconds": told["compile_seconds"]}
                peer_rows.append(row | {"apart_metres": float(np.linalg.norm(apart, axis=1).max())})
            for row in peer_rows + ours:
                row["rate"] = row["batch"] * options.steps / min(row.pop("seconds"))
            for row in peer_rows + ours:
                row["ratio"] = row["rate"] / peer_rows[0 if row["batch"] == 1 else 1]["rate"]
            rows += peer_rows + ours

    flight = options.steps * options.dt
    table = Table(title=f"LEO with drag, sunlight, Sun and Moon, RK4, {options.steps} steps of {options.dt:g} s")
    headings = ("gravity", "program", "batch", "steps/s", "to brahe's", f"apart after {flight:g} s [m]", "compile [s]")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "program" else "right")
    for row in rows:
        table.add_row(
            f"{row['degree']}x{row['degree']}",
            row["program"],
            str(row["batch"]),
            f"{row['rate']:,.0f}",
            f"{row['ratio']:.1f}",
            f"{row['apart_metres']:.1e}" if "apart_metres" in row else "-",
            f"{row['compile_seconds']:.1f}" if "compile_seconds" in row else "-",
        )
    Console().print(table)
    machine = {"python": platform.python_version(), "jax": jax.__version__, "device": jax.devices()[0].platform}
    report = {"machine": machine, "steps": options.steps, "dt_seconds": options.dt, "rows": rows}
    options.output.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
