"""Learn by sight to look at the station, with Stable-Baselines3 PPO, in minutes: `python examples/pixels_sb3.py`.

The chaser coasts 100 to 140 m off, its nose up to 30 deg beside the station, by day and under a black sky. Once a
second the policy says how fast to pitch and yaw; the vehicle's gyros see to it. The reward is the angle from the nose
to the station, negated; it is told by the state, which a `CnnPolicy` does not see. `--observation state+pixels` shows a
`MultiInputPolicy` both. Frames are small, so that two cores suffice.

Needs `pip install stable-baselines3`.
"""

import argparse
import itertools
import time
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor
from torch import nn

from owm_envs.sb3 import make_vec_env
from owm_envs.view import View

TASK = {
    "ports": ["zvezda_aft"],
    "chief": {"mean_anomaly_deg": 120.0},  # about noon
    "reset": {"radius_min": 100.0, "radius_max": 140.0, "attitude_error_deg": 30.0, "rate": 0.0, "epoch_window": 600.0},
}
FASTEST = np.deg2rad(3.0)  # rad/s


class LookAtStation(VecEnvWrapper):
    """Takes rates about body x and y for a wrench, rewards a nose that points at the station, hides the state."""

    def __init__(self, venv, hide_state: bool):
        self.hide_state = hide_state
        self.layout = venv.get_attr("layout")[0]
        chaser = venv.get_attr("config")[0].chaser
        self.gain = np.array(chaser.inertia) / chaser.torque_limit  # to have the rate within a second
        seen = venv.observation_space["pixels"] if hide_state else venv.observation_space
        super().__init__(venv, observation_space=seen, action_space=spaces.Box(-1, 1, (2,), np.float32))

    def shown(self, observation):
        return observation["pixels"] if self.hide_state else observation

    def reset(self):
        observation = self.venv.reset()
        self.rate = View.of(self.layout.measured_view(observation)).rate
        return self.shown(observation)

    def step_async(self, actions: np.ndarray) -> None:
        asked = FASTEST * np.pad(actions, [(0, 0), (0, 1)])
        torque = np.clip(self.gain * (asked - self.rate), -1, 1)
        self.venv.step_async(np.concatenate([np.zeros_like(torque), torque], axis=-1))

    def step_wait(self):
        observation, _, done, infos = self.venv.step_wait()
        view = self.layout.measured_view(observation)
        self.rate = View.of(view).rate
        for slot in np.flatnonzero(done):
            last = infos[slot]["terminal_observation"]
            view[slot] = self.layout.measured_view(last)
            infos[slot]["terminal_observation"] = self.shown(last)
        return self.shown(observation), -off_nose(View.of(view)), done, infos


def off_nose(view: View) -> np.ndarray:
    """Angle from the body's +z to the station's centre, rad."""
    w, x, y, z = np.moveaxis(view.attitude, -1, 0)
    nose = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    cosine = -np.sum(nose * view.position, axis=-1) / np.linalg.norm(view.position, axis=-1)
    return np.arccos(np.clip(cosine, -1, 1)).astype(np.float32)


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
    parser.add_argument("--observation", choices=("pixels", "state+pixels"), default="pixels")
    parser.add_argument("--steps", type=int, default=60_000)
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--size", type=int, default=32, help="rows and columns of a frame")
    parser.add_argument("--horizon", type=float, default=30.0, help="s per episode")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/pixels_sb3"))
    options = parser.parse_args()
    torch.set_num_threads(1)

    camera = {"width": options.size, "height": options.size, "sky": False}
    see = {"observation": "state+pixels", "camera": camera, "horizon": options.horizon}
    venv = make_vec_env("iss-hcw", options.envs, seed=options.seed, **TASK, **see)
    venv = VecMonitor(LookAtStation(venv, hide_state=options.observation == "pixels"))
    steps = min(round(options.horizon), max(2, options.steps // options.envs))
    model = PPO(
        "CnnPolicy" if options.observation == "pixels" else "MultiInputPolicy",
        venv,
        n_steps=steps,
        batch_size=max(2, options.envs * steps // 4),
        n_epochs=4,
        gamma=0.9,
        learning_rate=5e-4,
        policy_kwargs={"features_extractor_class": SmallNet, "net_arch": [64, 64], "log_std_init": -1.0},
        seed=options.seed,
        device="cpu",
    )
    began = time.perf_counter()
    while model.num_timesteps < options.steps:
        ahead = min(options.steps - model.num_timesteps, 10 * options.envs * steps)
        model.learn(ahead, reset_num_timesteps=False)
        episodes = model.ep_info_buffer
        off = sum(-episode["r"] / episode["l"] for episode in episodes) / len(episodes) if episodes else np.nan
        spent = time.perf_counter() - began
        print(
            f"{model.num_timesteps:>9,} steps   {spent:7.1f} s   off by {np.rad2deg(off):5.1f} deg on average",
            flush=True,
        )
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / f"{options.observation.replace('+', '_')}.zip"
    model.save(file)
    print(f"saved {file}")


if __name__ == "__main__":
    main()
