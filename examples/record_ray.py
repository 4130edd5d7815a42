"""Record a dataset in shares on the workers of a Ray cluster, then merge them.

pip install ray
python examples/record_ray.py --recipe quick --shards 8 --out runs/set

Each worker runs the command that any scheduler would run. Called again, it goes on where it was killed: finished shares
are kept, and so are the episodes of the others. The folder must be one that all workers see.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import ray


@ray.remote(max_retries=3)
def record(recipe: str, out: str, shard: str, options: list[str]) -> str:
    """Record a share; gives its folder."""
    folder = f"{out}-{shard.replace('/', '-of-')}"
    command = [sys.executable, "-m", "owm_envs", "generate", "--recipe", recipe, "--shard", shard, "--out", folder]
    subprocess.run([*command, *options], check=True)
    return folder


def main() -> None:
    """Record all shares and merge them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="quick")
    parser.add_argument("--shards", type=int, default=2)
    parser.add_argument("--cores", type=float, default=1, help="of a worker")
    parser.add_argument("--out", type=Path, default=Path("runs/set"))
    options, further = parser.parse_known_args()
    ray.init()
    out, count = str(options.out.absolute()), options.shards
    shares = [
        record.options(num_cpus=options.cores).remote(options.recipe, out, f"{number}/{count}", further)
        for number in range(1, count + 1)
    ]
    subprocess.run([sys.executable, "-m", "owm_envs", "merge", *ray.get(shares), "--out", out], check=True)


if __name__ == "__main__":
    main()
