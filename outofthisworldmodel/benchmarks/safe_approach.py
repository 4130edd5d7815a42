"""How safe policies fly, and what it costs: coasts that clear the hull, ways out near it, contact rates.

python benchmarks/safe_approach.py                                # 25 flights to each port, some 20 minutes
python benchmarks/safe_approach.py --flights 3 --policies dock-safe
python benchmarks/safe_approach.py --pictures docs/results/figures
python benchmarks/safe_approach.py --flights 2 --conditions "force x dead" leak "outages of 10 s"

Every policy flies the same starts, in `iss-numerical` with cooperative noise unless a condition of
`owm.study.conditions` says otherwise; after a model stands how it is planned with. Each table is followed by its
figures as JSON.
"""

import argparse
import json
from pathlib import Path

from rich.console import Console
from rich.table import Table

from owm.catalogue.policies import load_policy
from owm.report.safety import coast_figure, front_figure
from owm.scores.coasting import Coasts, add_coasts, coasts_of
from owm.scores.docking import fly_episodes, trials
from owm.scores.flights import score
from owm.study.conditions import Condition, condition
from owm.study.matrix import planner_of
from owm_envs.field import GeodesicField
from owm_envs.figures import save_figure
from owm_envs.policies.geodesic import field_of

POLICIES = ("dock-geodesic", "ekf-mpc", "pretrained, geodesic", "pretrained, safe", "dock-safe")


def fly(
    options: argparse.Namespace, name: str, flown_in: Condition, field: GeodesicField
) -> tuple[dict, Coasts | None]:
    """The figures of one policy under one condition, and its coasts; none beside a target that turns."""
    source, _, planner = name.partition(", ")
    seeds, ports = trials(per_port=options.flights, seed=options.seed)
    slots = min(100, len(seeds))
    told = flown_in.told()
    policy = load_policy(source, told, slots, planner=planner_of(planner or "geodesic"), field=field)
    flights = fly_episodes(policy, flown_in.flown(), seeds, ports, slots=slots)
    still = not told.structure.turning
    scores = score(add_coasts(flights, field) if still else flights)
    figures = {
        "flights": len(seeds),
        "strict": scores["success"]["0.1 m full voided"]["count"],
        "captured": int((flights.outcome == "docked").sum()),
        "collided": scores["collision"]["count"],
        "IDSS contact": scores["idss"]["count"],
        "far coasts clear": scores["far_safe_share"],
        "way out, near": scores["avoidable_share"],
        "all coasts clear": scores["safe_share"],
        "median time s": scores["median_time"],
        "median delta-v m/s": scores["median_delta_v"],
        "least clearance m": scores["least_clearance"],
    }
    return figures, coasts_of(flights, field) if still else None


def main() -> None:
    """Print a table for each condition."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=25, help="to each port")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--policies", nargs="+", default=POLICIES)
    parser.add_argument("--conditions", nargs="+", default=["nominal"])
    parser.add_argument("--pictures", type=Path, help="folder to draw into")
    options = parser.parse_args()
    console = Console()
    for asked in map(condition, options.conditions):
        field, figures, coasts = field_of(asked.told()), {}, {}
        for name in options.policies:
            with console.status(f"{name} flies: {asked.what}"):
                figures[name], coasts[name] = fly(options, name, asked, field)
        table = Table("", *options.policies, title=asked.what)
        for row in figures[options.policies[0]]:
            values = (figures[name][row] for name in options.policies)
            table.add_row(row, *("-" if value is None else f"{value:.4g}" for value in values))
        console.print(table)
        print(json.dumps({asked.what: figures}), flush=True)
    if options.pictures:
        rows = {
            name: {
                "far": row["far coasts clear"],
                "contact": row["IDSS contact"] / row["flights"],
                "time": row["median time s"],
                "delta_v": row["median delta-v m/s"],
            }
            for name, row in figures.items()
        }
        save_figure(front_figure(rows), options.pictures / "safety_front.png", dpi=100)
        save_figure(coast_figure(coasts), options.pictures / "safety_coasts.png", dpi=100)


if __name__ == "__main__":
    main()
