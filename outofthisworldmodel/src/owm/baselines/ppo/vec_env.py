"""The vector environment that PPO trains and is validated in."""

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor, VecNormalize

from owm.baselines.ppo.config import PPOConfig
from owm.baselines.ppo.features import FEATURES, with_field
from owm_envs.field import load_field
from owm_envs.sb3 import make_vec_env


class FieldObservation(VecEnvWrapper):
    """Append the geodesic field's gradient and cost-to-go at the measured position to every observation."""

    def __init__(self, venv: VecEnv):
        self._layout = venv.get_attr("layout")[0]
        self._field = load_field()
        self._ports = np.zeros(venv.num_envs, np.int32)
        size = self._layout.size + FEATURES
        super().__init__(venv, observation_space=spaces.Box(-np.inf, np.inf, (size,), np.float32))

    def _extend(self, observation: np.ndarray, ports: np.ndarray) -> np.ndarray:
        return with_field(self._field, ports, self._layout.measured_view(observation), observation)

    def reset(self) -> np.ndarray:
        observation = self.venv.reset()
        self._ports = np.array([info["port"] for info in self.unwrapped.reset_infos], np.int32)
        return self._extend(observation, self._ports)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        observation, reward, done, infos = self.venv.step_wait()
        ended = np.flatnonzero(done)
        if ended.size:
            last = np.stack([infos[slot]["terminal_observation"] for slot in ended])
            for slot, seen in zip(ended.tolist(), self._extend(last, self._ports[ended])):
                infos[slot]["terminal_observation"] = seen
                self._ports[slot] = self.unwrapped.reset_infos[slot]["port"]
        return self._extend(observation, self._ports), reward, done, infos


def make_env(config: PPOConfig, slots: int, seed: int, *, training: bool) -> VecNormalize:
    """Return the task of the paper's baseline: 1 Hz decisions, its reward and start shell, train ports.

    Args:
        config: names fidelity, noise and what is observed.
        slots: environments side by side.
        seed: of the starts.
        training: whether statistics are updated and rewards normalised.
    """
    venv = VecMonitor(make_vec_env(config.env, slots, seed, noise=config.noise))
    if config.observe_field:
        venv = FieldObservation(venv)
    return VecNormalize(venv, training=training, norm_reward=training and config.normalize_reward, gamma=config.gamma)
