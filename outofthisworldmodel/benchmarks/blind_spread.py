"""Whether what a predictor says of its own error is right after seconds without a measurement.

python benchmarks/blind_spread.py                      # 2 flights to each port, some minutes

A policy flies nominally. Of windows of its flights each predictor sees what it looks at, then nothing for 1, 5, 10 and
30 s: its samples, rolled on step by step, are scored against what came. The world model is scored against measurements,
whose noise is in its samples, the Kalman filter's covariance against the truth: once with the process noise that it
flies with, once with that of a vehicle which is what it is told. What `online:` fits in flight is the mean alone.
"""

import argparse
import json

import jax
import numpy as np

from owm.baselines.classical import PROCESS_NOISE
from owm.baselines.ekf import ErrorStateEKF
from owm.catalogue.policies import load_model
from owm.catalogue.predictors import sampled_outcome
from owm.data.recordings import recorded
from owm.data.windows import from_episodes
from owm.report.tables import calibration_table
from owm.report.terminal import print_table
from owm.scores.calibration import calibration
from owm.scores.docking import evaluation_config
from owm_envs.env import DockingEnv
from owm_envs.policies import make_policy
from owm_envs.rollout import episodes, rollout
from owm_envs.station import PORTS

SECONDS = (1.0, 5.0, 10.0, 30.0)


def main() -> None:
    """Print a table and the same as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=2, help="to each port")
    parser.add_argument("--policy", default="dock-safe", help="scripted, that flies")
    parser.add_argument("--models", nargs="+", default=["pretrained"], help="world models that draw samples")
    parser.add_argument("--windows", type=int, default=64)
    parser.add_argument("--samples", type=int, default=199)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    config = evaluation_config(fidelity="iss-hcw")
    env = DockingEnv(config)
    ports = np.repeat(np.arange(len(PORTS)), options.flights)
    keys = jax.random.split(jax.random.key(options.seed), len(ports))
    flown = episodes(rollout(env, make_policy(options.policy, env), keys, ports))
    data = from_episodes(recorded(flight, 1) for flight in flown)

    models = {name: load_model(name, config) for name in options.models}
    history = max(model.history_length for model in models.values())
    for name, noise in (("EKF, as it flies", {"process_noise": PROCESS_NOISE}), ("EKF, sure of its vehicle", {})):
        models[name] = ErrorStateEKF(config, history_length=history, **noise)
    horizons = tuple(round(seconds / data.dt) for seconds in SECONDS)
    told = {}
    for name, model in models.items():
        windows = data.windows(history + max(horizons), options.windows, seed=options.seed)
        windows = windows.last(model.history_length + max(horizons))
        scored = {"samples": options.samples, "outcome": sampled_outcome(model), "levels": (0.5, 0.9)}
        told[name] = calibration(model, windows, horizons, seed=options.seed, **scored)
        print_table(calibration_table([told[name]], SECONDS), f"{name}: {len(windows.action)} windows")
    print(json.dumps({name: each.rows() for name, each in told.items()}))


if __name__ == "__main__":
    main()
