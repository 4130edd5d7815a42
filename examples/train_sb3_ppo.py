"""Train a Stable-Baselines3 PPO pilot for minutes: `python examples/train_sb3_ppo.py [--steps N]`.

An easier task than the paper's, so that learning shows on two cores: one port (Zvezda aft), two minutes, starts at
75 to 100 m with the nose on the station, less torque (so that exploring does not tumble the chaser), and a reward with
more weight on progress and less on escape. `BodyAxes` adds the goal error as the chaser sees it, which spares the
network from learning to rotate. It learns to fly to the port, slow down and often to dock; nothing but the collision
charge tells it of the hull, and some flights brush it.

Needs `pip install stable-baselines3 matplotlib`.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor, VecNormalize

from owm_envs.sb3 import make_vec_env
from owm_envs.view import View

EASIER = {
    "ports": ["zvezda_aft"],
    "reset": {"radius_min": 75.0, "radius_max": 100.0, "attitude_error_deg": 0.0, "rate": 0.0},
    "chaser": {"torque_limit": 600.0},
    "reward": {"progress": -50.0, "escape": -20.0},
}


class BodyAxes(VecEnvWrapper):
    """Append the measured position and velocity errors in the chaser's axes, where its thrusters push."""

    def __init__(self, venv):
        self.layout = venv.get_attr("layout")[0]
        size = self.layout.size + 6
        super().__init__(venv, observation_space=spaces.Box(-np.inf, np.inf, (size,), np.float32))

    def extend(self, observation: np.ndarray) -> np.ndarray:
        w, axis = np.split(View.of(observation[..., self.layout.view]).attitude * [1, -1, -1, -1], [1], axis=-1)
        turned = []
        for error in (observation[..., -12:-9], observation[..., -9:-6]):
            once = 2 * np.cross(axis, error)
            turned.append(error + w * once + np.cross(axis, once))
        return np.concatenate([observation, *turned], axis=-1).astype(np.float32)

    def reset(self) -> np.ndarray:
        return self.extend(self.venv.reset())

    def step_wait(self):
        observation, reward, done, infos = self.venv.step_wait()
        for slot in np.flatnonzero(done):
            infos[slot]["terminal_observation"] = self.extend(infos[slot]["terminal_observation"])
        return self.extend(observation), reward, done, infos


class Curve(BaseCallback):
    """Steps, seconds and the mean return of the last hundred episodes, after every rollout."""

    def __init__(self):
        super().__init__()
        self.points: list[tuple[int, float, float]] = []
        self.began = time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.model.ep_info_buffer:
            mean = float(np.mean([episode["r"] for episode in self.model.ep_info_buffer]))
            self.points.append((self.num_timesteps, time.perf_counter() - self.began, mean))
            print(f"{self.num_timesteps:>10,} steps   {self.points[-1][1]:6.1f} s   return {mean:8.2f}", flush=True)


def evaluate(venv: VecNormalize, act) -> dict[str, float]:
    """Fly the first episode of every slot from fixed seeds: mean return, distances [m], shares."""
    venv.seed(10_000)
    observation = venv.reset()
    ended: dict[int, dict] = {}
    while len(ended) < venv.num_envs:
        observation, _, done, infos = venv.step(act(observation))
        for slot in np.flatnonzero(done).tolist():
            ended.setdefault(slot, infos[slot])
    rows = list(ended.values())
    return {
        "return": float(np.mean([row["episode"]["r"] for row in rows])),
        "closest": float(np.median([row["closest_distance"] for row in rows])),
        "final": float(np.median([np.linalg.norm(row["true_goal_error"][:3]) for row in rows])),
        "docked": float(np.mean([row["is_success"] for row in rows])),
        "touched the hull": float(np.mean([row["collided"] for row in rows])),
    }


def report(name: str, figures: dict[str, float]) -> None:
    print(
        f"{name:<12} return {figures['return']:8.2f}   distance to the port: closest {figures['closest']:6.1f} m, "
        f"at the end {figures['final']:6.1f} m (medians)   "
        f"docked {figures['docked']:.0%}   touched the hull {figures['touched the hull']:.0%}"
    )


def plot(curve: Curve, baselines: dict[str, float], after: dict[str, float], file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    steps, seconds, returns = np.array(curve.points).T
    axes.plot(steps, returns, label="PPO while training (exploring)")
    for (name, value), style in zip(baselines.items(), (":", "--")):
        axes.axhline(value, color="0.4", linestyle=style, linewidth=1, label=f"{name}: {value:.1f}")
    # Not a line: the docking bonus of a pilot that no longer explores would squeeze the curve.
    title = f"PPO, {seconds[-1]:.0f} s of training; then, not exploring: {after['return']:.1f}"
    axes.set(xlabel="environment steps", ylabel="episode return", title=title)
    axes.legend()
    figure.savefig(file, dpi=150)


def main() -> None:
    """Train, evaluate before and after on the same starts, save and plot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--env", default="iss-hcw", help="environment id or a TOML file")
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--envs", type=int, default=128)
    parser.add_argument("--horizon", type=float, default=120.0, help="s per episode")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/sb3_ppo"))
    options = parser.parse_args()
    torch.set_num_threads(1)  # a small network gains nothing from more, and they would disturb the simulation
    options.out.mkdir(parents=True, exist_ok=True)
    task = {**EASIER, "horizon": options.horizon}

    venv = VecNormalize(BodyAxes(VecMonitor(make_vec_env(options.env, options.envs, **task))), gamma=0.99)
    steps = max(1, round(options.horizon))  # whole episodes at 1 Hz
    model = PPO(
        "MlpPolicy",
        venv,
        n_steps=steps,
        batch_size=max(2, options.envs * steps // 15),
        n_epochs=8,
        learning_rate=5e-4,
        gamma=0.99,
        policy_kwargs={"log_std_init": -1.0, "net_arch": [64, 64]},
        seed=options.seed,
        device="cpu",  # a small network: faster than on a GPU
    )
    trial = VecNormalize(
        BodyAxes(VecMonitor(make_vec_env(options.env, options.envs, **task))), training=False, norm_reward=False
    )

    def pilot(observation):
        return model.predict(observation, deterministic=True)[0]

    idle = evaluate(trial, lambda observation: np.zeros((len(observation), 6), np.float32))
    report("no thrust", idle)
    trial.obs_rms = venv.obs_rms  # as it learns to normalise, so does the trial
    before = evaluate(trial, pilot)
    report("before", before)
    curve = Curve()
    model.learn(options.steps, callback=curve)

    # The statistics belong to the policy: without them it sees other numbers than it was trained on.
    model.save(options.out / "policy.zip")
    venv.save(str(options.out / "normalize.pkl"))
    trial = VecNormalize.load(str(options.out / "normalize.pkl"), trial.venv)
    trial.training = trial.norm_reward = False
    model = PPO.load(options.out / "policy.zip", device="cpu")
    after = evaluate(trial, pilot)
    report("after", after)
    picture = options.out / "learning_curve.png"
    plot(curve, {"no thrust": idle["return"], "before": before["return"]}, after, picture)
    print(f"saved policy.zip, normalize.pkl and {picture.name} in {options.out}")


if __name__ == "__main__":
    main()
