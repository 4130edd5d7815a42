"""How safe policies fly, and what it costs: coasts that clear the hull, ways out near it, contact rates.

python benchmarks/safe_approach.py                                # 25 flights to each port, some 20 minutes
python benchmarks/safe_approach.py --flights 3 --policies dock-safe
python benchmarks/safe_approach.py --pictures docs/results/figures
python benchmarks/safe_approach.py --flights 3 --seed 11 --outages 10         # quiet for 10 s, again and again
python benchmarks/safe_approach.py --flights 2 --condition "force x dead"

Every policy flies the same starts, in `iss-numerical` with cooperative noise unless a condition of
`owm.study.conditions` says otherwise; after a model stands how it is planned
with. The last line is all figures as JSON.
"""

import argparse
import json
from pathlib import Path

from rich.console import Console
from rich.table import Table

from owm.catalogue.policies import load_policy
from owm.report.safety import coast_figure, front_figure
from owm.scores.coasting import add_coasts, coasts_of
from owm.scores.docking import fly_episodes, trials
from owm.scores.flights import score
from owm.scores.outages import Outages
from owm.study.conditions import condition
from owm.study.matrix import planner_of
from owm_envs.field import load_field
from owm_envs.figures import save_figure

POLICIES = ("dock-geodesic", "ekf-mpc", "pretrained, geodesic", "pretrained, safe", "dock-safe")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=25, help="to each port")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--policies", nargs="+", default=POLICIES)
    parser.add_argument("--condition", default="nominal")
    parser.add_argument("--outages", type=float, help="s for which relative navigation is quiet, again and again")
    parser.add_argument("--pictures", type=Path, help="folder to draw into")
    options = parser.parse_args()
    conditions, field = condition(options.condition), load_field()
    told, flown = conditions.told(), conditions.flown()
    seeds, ports = trials(per_port=options.flights, seed=options.seed)
    console, figures, coasts = Console(), {}, {}
    for name in options.policies:
        source, _, planner = name.partition(", ")
        slots = min(100, len(seeds))
        with console.status(f"{name} flies {len(seeds)} times"):
            policy = load_policy(source, told, slots, planner=planner_of(planner or "geodesic"), field=field)
            quiet = Outages(options.outages) if options.outages else conditions.outages
            flights = fly_episodes(policy, flown, seeds, ports, slots=slots, outages=quiet)
            coasts[name] = coasts_of(flights, field)
            scores = score(add_coasts(flights, field))
        figures[name] = {
            "flights": len(seeds),
            "strict": scores["success"]["0.1 m full voided"]["count"],
            "collided": scores["collision"]["count"],
            "IDSS contact": scores["idss"]["count"],
            "far coasts clear": scores["far_safe_share"],
            "way out, near": scores["avoidable_share"],
            "all coasts clear": scores["safe_share"],
            "median time s": scores["median_time"],
            "median delta-v m/s": scores["median_delta_v"],
            "least clearance m": scores["least_clearance"],
        }
    table = Table("", *options.policies)
    for row in figures[options.policies[0]]:
        values = (figures[name][row] for name in options.policies)
        table.add_row(row, *("-" if value is None else f"{value:.4g}" for value in values))
    console.print(table)
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
    print(json.dumps({options.condition: figures}))


if __name__ == "__main__":
    main()
