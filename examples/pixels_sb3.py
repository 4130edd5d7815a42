"""Train Stable-Baselines3 PPO on pixels for minutes: `python examples/pixels_sb3.py [--observation pixels]`.

With `state+pixels` a `MultiInputPolicy` sees the state part and the frame, with `pixels` a `CnnPolicy` the frame alone.
Frames are small and come once a second, as decisions do; the network is small too, so that two cores suffice. What is
learned in minutes is to brake and to keep the nose on the station, no docking.

Needs `pip install stable-baselines3`.
"""

import argparse
import itertools
import time
from pathlib import Path

import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecMonitor
from torch import nn

from owm_envs.sb3 import make_vec_env

TASK = {
    "ports": ["zvezda_aft"],
    "reset": {"radius_min": 75.0, "radius_max": 100.0, "attitude_error_deg": 0.0, "rate": 0.0},
    "chaser": {"torque_limit": 600.0},
    "reward": {"progress": -50.0, "escape": -20.0},
}


class SmallNet(BaseFeaturesExtractor):
    """Three convolutions for small frames, which PPO's own network for Atari does not take; the state beside them."""

    def __init__(self, space: spaces.Space):
        parts = space.spaces if isinstance(space, spaces.Dict) else {"pixels": space}
        channels, height, width = parts["pixels"].shape  # channels first: Stable-Baselines3 has turned them
        layers, sizes = [], (channels, 16, 32, 32)
        for before, after in itertools.pairwise(sizes):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.ReLU()]
        places = -(-height // 8) * -(-width // 8)
        seen = sizes[-1] * places + sum(part.shape[0] for name, part in parts.items() if name != "pixels")
        super().__init__(space, features_dim=seen)
        self.eye = nn.Sequential(*layers, nn.Flatten())

    def forward(self, observation: torch.Tensor | dict[str, torch.Tensor]) -> torch.Tensor:
        if not isinstance(observation, dict):
            return self.eye(observation)
        return torch.cat([self.eye(observation["pixels"]), observation["state"]], dim=1)


def main() -> None:
    """Train, print how the return goes, save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observation", choices=("state+pixels", "pixels"), default="state+pixels")
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--envs", type=int, default=16)
    parser.add_argument("--size", type=int, default=32, help="rows and columns of a frame")
    parser.add_argument("--horizon", type=float, default=60.0, help="s per episode")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/pixels_sb3"))
    options = parser.parse_args()
    torch.set_num_threads(1)

    camera = {"width": options.size, "height": options.size}
    see = {"observation": options.observation, "camera": camera, "horizon": options.horizon}
    venv = VecMonitor(make_vec_env("iss-hcw", options.envs, seed=options.seed, **TASK, **see))
    steps = min(round(options.horizon), max(2, options.steps // options.envs))
    model = PPO(
        "MultiInputPolicy" if options.observation == "state+pixels" else "CnnPolicy",
        venv,
        n_steps=steps,
        batch_size=max(2, options.envs * steps // 4),
        n_epochs=4,
        learning_rate=5e-4,
        policy_kwargs={"features_extractor_class": SmallNet, "net_arch": [64, 64], "log_std_init": -1.0},
        seed=options.seed,
        device="cpu",
    )
    began = time.perf_counter()
    while model.num_timesteps < options.steps:
        ahead = min(options.steps - model.num_timesteps, 10 * options.envs * steps)
        model.learn(ahead, reset_num_timesteps=False)
        returns = [episode["r"] for episode in model.ep_info_buffer]
        mean = f"{sum(returns) / len(returns):9.2f}" if returns else "none ended"
        print(f"{model.num_timesteps:>9,} steps   {time.perf_counter() - began:7.1f} s   return {mean}", flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / f"{options.observation.replace('+', '_')}.zip"
    model.save(file)
    print(f"saved {file}")


if __name__ == "__main__":
    main()
