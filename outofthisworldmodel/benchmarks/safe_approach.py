"""How safe scripted policies fly: coasts that clear the hull, ways out near it, contact at the standard's rates.

python benchmarks/safe_approach.py                                # 25 flights to each port, some ten minutes
python benchmarks/safe_approach.py --flights 3 --policies dock-safe

Every policy flies the same starts in `iss-numerical` with cooperative noise. The last line is all figures as JSON.
"""

import argparse
import json

from rich.console import Console
from rich.table import Table

from owm.scores.coasting import add_coasts
from owm.scores.docking import evaluation_config, fly_episodes, trials
from owm.scores.flights import score
from owm_envs.field import load_field
from owm_envs.policies import VectorPolicy, make_policy


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=25, help="to each port")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--policies", nargs="+", default=["dock-geodesic", "dock-safe"])
    options = parser.parse_args()
    config = evaluation_config()
    seeds, ports = trials(per_port=options.flights, seed=options.seed)
    console, figures = Console(), {}
    for name in options.policies:
        with console.status(f"{name} flies {len(seeds)} times"):
            flights = fly_episodes(VectorPolicy(make_policy(name, config)), config, seeds, ports, slots=100)
            scores = score(add_coasts(flights, load_field()))
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
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
