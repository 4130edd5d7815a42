"""How long one replan of one episode takes, by model: `python benchmarks/replan.py [--repeats 20]`.

Prints a table and the same figures as JSON. Networks carry untrained weights, which take as long as trained
ones. Every model is paired with the constant-velocity one in the same process: the planner's own share, noise
and objective, is the time of that row.
"""

import argparse
import json
import statistics

import jax
import jax.numpy as jnp
import numpy as np

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.exact import ExactDynamics
from owm.model.config import preset
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.planning.policy import PlannerPolicy
from owm_envs.config import load_config
from owm_envs.geodesic import load_field


def untrained(name: str, **changes) -> LearnedWorldModel:
    """A learned model of a preset's size, with random weights and statistics that keep its numbers finite."""
    config = preset(name).model_copy(update=changes)
    shapes = STREAMS[config.stream].skeleton(jnp.float32)
    # Maps are matrices, scales are not.
    numbers = jax.tree.map(lambda x: jnp.full(x.shape, 1e-5 if len(x.shape) == 2 else 1.0, x.dtype), shapes)
    network = Network(config, key=jax.random.key(0))
    return LearnedWorldModel(config, Params(network, numbers), name=f"{config.stream}, {name}")


def measure(model, field, repeats: int) -> dict[str, float | str]:
    """Milliseconds of one replan of one slot, through the policy as it flies."""
    config = load_config(fidelity="iss-numerical", steps_per_action=5, goal_error=False)
    policy = PlannerPolicy(model, field, config)
    observation = np.zeros((1, policy.layout.size), np.float32)
    observation[0, policy.layout.view] = [100.0, 60.0, -50.0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    for _ in range(repeats + 1):
        policy.reset(ports=[0])
        policy.predict(observation)
    first, *rest = policy.seconds
    return {
        "model": model.name,
        "first_s": first,
        "median_ms": 1e3 * statistics.median(rest),
        "best_ms": 1e3 * min(rest),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    repeats = parser.parse_args().repeats
    field = load_field(["harmony_forward"])
    models = [
        ConstantVelocity(),
        ExactDynamics("iss-hcw"),
        ExactDynamics("iss-numerical"),
        untrained("nano"),
        untrained("nano", stream="latent"),
        untrained("small"),
    ]
    rows = [measure(model, field, repeats) for model in models]
    print(f"{'model':36s} {'compile + first, s':>18s} {'median, ms':>11s} {'best, ms':>9s} {'of the first row':>17s}")
    for row in rows:
        ratio = row["best_ms"] / rows[0]["best_ms"]
        print(f"{row['model']:36s} {row['first_s']:18.1f} {row['median_ms']:11.1f} {row['best_ms']:9.1f} {ratio:17.1f}")
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
