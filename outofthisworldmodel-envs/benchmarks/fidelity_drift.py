"""How far the three fidelities part in 360 s of drift, and by which term: `python benchmarks/fidelity_drift.py`.

The same starts, drawn as episodes are, drift without thrust under each of the equations of motion; the differences are
between the station-relative views at the end. The second part leaves one term of `iss-numerical` out at a time.
"""

import argparse
import json
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from astrojax.attitude import quat_angle
from owm_envs.config import load_config
from owm_envs.env import DockingEnv
from owm_envs.task.reset import sample_start
from owm_envs.view import View

NO_FORCES = {"zonal_degree": 0, "sun": False, "moon": False, "drag": False}
CIRCULAR = {"eccentricity": 0.0}
CONFIGURATIONS = {
    "iss": {"fidelity": "iss"},
    "iss-hcw": {"fidelity": "iss-hcw"},
    "iss-numerical": {},
    "without J3, J4": {"forces": {"zonal_degree": 2}},
    "without J2 to J4": {"forces": {"zonal_degree": 0}},
    "without Sun": {"forces": {"sun": False}},
    "without Moon": {"forces": {"moon": False}},
    "without drag": {"forces": {"drag": False}},
    "circular": {"chief": CIRCULAR},
    "circular, point mass": {"forces": NO_FORCES, "chief": CIRCULAR},
}
COMPARISONS = (  # label, and the two configurations
    ("iss against iss-numerical", "iss", "iss-numerical"),
    ("iss-hcw against iss-numerical", "iss-hcw", "iss-numerical"),
    ("iss-hcw against a circular point-mass orbit", "iss-hcw", "circular, point mass"),
    ("J2", "without J3, J4", "without J2 to J4"),
    ("J3 and J4", "iss-numerical", "without J3, J4"),
    ("Sun", "iss-numerical", "without Sun"),
    ("Moon", "iss-numerical", "without Moon"),
    ("drag", "iss-numerical", "without drag"),
    ("eccentricity 0.0005", "iss-numerical", "circular"),
)
QUANTITIES = ("position_m", "velocity_m_s", "attitude_deg")
STATISTICS = {"median": 50, "p95": 95, "max": 100}


@partial(jax.jit, static_argnums=0)
def drift(dynamics, params, epochs, views, dt, steps):
    """Relative views (B, 13) after `steps` steps of `dt` seconds without thrust."""

    def one(epoch, view):
        state = dynamics.init(params, epoch, view)
        state = jax.lax.fori_loop(0, steps, lambda _, s: dynamics.step(params, s, jnp.zeros(6), dt), state)
        return dynamics.relative_state(params, state)

    return jax.vmap(one)(epochs, views)


def differences(a, b):
    """Position [m], velocity [m/s] and attitude [deg] apart, each (B,)."""
    a, b = View.of(a), View.of(b)
    angle = jax.vmap(quat_angle)(a.attitude, b.attitude)
    position, velocity = a.position - b.position, a.velocity - b.velocity
    return [np.linalg.norm(position, axis=1), np.linalg.norm(velocity, axis=1), np.degrees(angle)]


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", default="fidelity_drift.json")
    parser.add_argument("--starts", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=360.0, help="of drift")
    parser.add_argument("--dt", type=float, default=0.5, help="step [s]; 0.05 gives the same figures, slower")
    options = parser.parse_args()
    began = time.perf_counter()
    ends = {}
    with jax.enable_x64(True):
        params = DockingEnv(load_config()).default_params()
        draw = jax.vmap(lambda key: sample_start(params, key=key, port=jnp.asarray(-1)))
        starts = jax.jit(draw)(jax.random.split(jax.random.key(0), options.starts))
        for name, overrides in CONFIGURATIONS.items():
            env = DockingEnv(load_config(**overrides))
            dt, steps = jnp.asarray(options.dt), round(options.seconds / options.dt)
            ends[name] = drift(env.dynamics, env.default_params(), starts.epoch, starts.view, dt, steps)
        rows = []
        for label, first, second in COMPARISONS:
            row = {"comparison": label, "between": [first, second]}
            for quantity, values in zip(QUANTITIES, differences(ends[first], ends[second])):
                row[quantity] = {name: float(np.percentile(values, q)) for name, q in STATISTICS.items()}
            rows.append(row)

    shown = f"{options.starts} starts, {options.seconds:g} s of drift: median / 95 % / maximum"
    table = Table("difference of", "position m", "velocity m/s", "attitude deg", title=shown)
    for i, row in enumerate(rows):
        cells = [" / ".join(f"{value:.2g}" for value in row[quantity].values()) for quantity in QUANTITIES]
        table.add_row(row["comparison"], *cells, end_section=i == 2)
    Console(width=112).print(table)
    report = {"starts": options.starts, "seconds": options.seconds, "dt": options.dt, "rows": rows}
    with open(options.json, "w", encoding="utf-8") as file:
        json.dump(report | {"wall_s": time.perf_counter() - began}, file, indent=1)


if __name__ == "__main__":
    main()
