"""What tests with and without a browser share: a flight made by hand."""

import dataclasses

import numpy as np
import pytest

from owm_envs.config import load_config
from owm_envs.episode import Episode
from owm_envs.station import goal_poses


@pytest.fixture(scope="session")
def swoop():
    """Makes an episode of `steps` decisions at 4 Hz: it swings into a port, turning about its nose, under full thrust.

    By day: the Sun is up, so that pictures of it show something. Changes are fields of `Episode`.
    """

    def make(steps=120, port=3, **changes):
        t = np.arange(steps + 1) * 0.25
        left = 1 - np.arange(steps + 1) / steps
        goal = goal_poses()[port]
        far = 80 * min(1, steps / 24)  # no farther than a vehicle comes in that time
        position = goal[:3] + far * left[:, None] ** 2 * np.stack([np.cos(t / 9), 0.4 + 0 * t, np.sin(t / 9)], axis=1)
        half = 0.5 * left
        turn = np.stack([np.cos(half), 0 * t, 0 * t, np.sin(half)], axis=1)
        w, x, y, z = goal[3:]
        left_by_goal = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
        attitude = turn @ left_by_goal.T
        velocity = np.gradient(position, 0.25, axis=0)
        rate = np.tile([0.0, 0.0, -1 / t[-1]], (steps + 1, 1))
        true = np.concatenate([position, velocity, attitude, rate], axis=1)
        noise = (
            np.random.default_rng(0).normal(size=true.shape) * np.r_[[0.05] * 3, [0.002] * 3, [2e-5] * 4, [1e-5] * 3]
        )
        action = np.stack([1600 * np.sin(np.arange(steps) / 7 + k) for k in range(6)], axis=1).astype(np.float32)
        last = np.arange(steps) == steps - 1
        episode = Episode(
            observation={"state": (true + noise).astype(np.float32)},
            true_state=true,
            epoch=np.stack([np.full(steps + 1, 61257.0), 74394.0 + t], axis=1),
            action=action,
            reward=np.zeros(steps, np.float32),
            done=last,
            success=last & (changes.get("outcome", 1) == 1),
            port=port,
            goal_pose=goal,
            policy=2,
            outcome=1,
        )
        return dataclasses.replace(episode, **changes)

    return make


@pytest.fixture(scope="session")
def slow_config():
    """Of such an episode."""
    return load_config(fidelity="iss-hcw", steps_per_action=5, noise="cooperative")
