"""How long one replan of one episode takes, by model: `python benchmarks/replan.py [--repeats 1000] [--only NAME]`.

Prints a table and the same figures as JSON. Networks carry untrained weights, which take as long as trained ones. The
first row, constant velocity, is the planner's own share: noise, look-ups, objective. Replans are measured alone and
with one episode to a core side by side, as batches fly; "prepare" is what another hull and port cost: field solved and
planner compiled, both anew.
"""

import argparse
import json
import time

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
from owm_envs.cores import core_count
from owm_envs.field import load_field, solve_field
from owm_envs.station import PORTS, goal_poses, hull_boxes


def untrained(name: str, **changes) -> LearnedWorldModel:
    """A learned model of a preset's size, with random weights and statistics that keep its numbers finite."""
    config = preset(name).model_copy(update=changes)
    shapes = STREAMS[config.stream].skeleton(jnp.float32)
    # Maps are matrices, scales are not.
    numbers = jax.tree.map(lambda x: jnp.full(x.shape, 1e-5 if len(x.shape) == 2 else 1.0, x.dtype), shapes)
    network = Network(config, key=jax.random.key(0))
    return LearnedWorldModel(config, Params(network, numbers), name=f"{config.stream}, {name}")


def replans(model, field, repeats: int, slots: int) -> tuple[list[float], float]:
    """Seconds of each replan, through the policy as it flies, and wall seconds of all but the first."""
    config = load_config(fidelity="iss-numerical", steps_per_action=5, goal_error=False)
    policy = PlannerPolicy(model, field, config, num_slots=slots)
    observation = np.zeros((slots, policy.layout.size), np.float32)
    observation[:, policy.layout.view] = [100.0, 60.0, -50.0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    for replan in range(repeats + 1):
        policy.reset(ports=[0] * slots)
        policy.predict(observation)
        if replan == 0:
            began = time.perf_counter()
    return policy.seconds, time.perf_counter() - began


def measure(model, field, repeats: int) -> dict[str, float | str]:
    """Milliseconds of one replan."""
    (first, *rest), _ = replans(model, field, repeats, 1)
    cores = core_count()
    _, together = replans(model, field, max(repeats // cores, 1), cores)
    return {
        "model": model.name,
        "first_s": first,
        "best_ms": 1e3 * min(rest),
        "median_ms": 1e3 * float(np.median(rest)),
        "p99.9_ms": 1e3 * float(np.quantile(rest, 0.999, method="higher")),
        "side_by_side_ms": 1e3 * together / (max(repeats // cores, 1) * cores),
    }


def prepare(model) -> float:
    """Seconds from another hull to the first plan at one of its ports, nothing cached."""
    jax.clear_caches()
    jax.config.update("jax_enable_compilation_cache", False)
    began = time.perf_counter()
    boxes = hull_boxes() + np.array([0.3, 0.0, 0.0])
    field = jax.device_put(solve_field(boxes, goal_poses()[:1, :3], np.array([PORTS[0].normal])))
    replans(model, field, 0, 1)
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--only", default="", help="measure only models whose name contains this")
    arguments = parser.parse_args()
    field = load_field(["harmony_forward"])
    models = [
        ConstantVelocity(),
        ExactDynamics("iss-hcw"),
        ExactDynamics("iss-numerical"),
        untrained("nano"),
        untrained("nano", stream="latent"),
        untrained("small"),
    ]
    rows = []
    for model in (model for model in models if arguments.only in model.name):
        rows.append(measure(model, field, arguments.repeats))
        row, columns = rows[-1], list(rows[-1])[1:]
        if len(rows) == 1:
            print(f"{'model':36s} " + " ".join(f"{name:>16s}" for name in columns))
        print(f"{row['model']:36s} " + " ".join(f"{row[name]:16.1f}" for name in columns), flush=True)
    prepared = prepare(untrained("nano"))
    print(f"another hull and port, nano: {prepared:.1f} s from nothing to the first plan")
    print(json.dumps({"replan": rows, "prepare_s": prepared, "cores": core_count()}))


if __name__ == "__main__":
    main()
