"""A trained PPO policy as numbers: written, read and flown without Stable-Baselines3, nothing pickled."""

import json
import os
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from owm.baselines.ppo.features import FEATURES, with_field
from owm.checkpoint import CheckpointError, check_finite, write_checkpoint
from owm_envs.config import DockingConfig
from owm_envs.env import DockingEnv
from owm_envs.field import GeodesicField
from owm_envs.policies import SlotPolicy, Slots
from owm_envs.task.sensors import STATE

FORMAT = 1
DECISION = 1.0
"""Seconds that PPO's actions are held, in training and in flight."""
_CLIP = 10.0
_EPSILON = 1e-8
"""As `VecNormalize` has them."""


def save_policy(folder: Path, weights: dict[str, np.ndarray], about: dict[str, Any]) -> None:
    """Write a policy, whole or not at all.

    Args:
        folder: to write or replace.
        weights: `weight.i` (outputs, inputs) and `bias.i` of each layer, `mean` and `variance` of the observation.
        about: JSON-able facts; `observation`, the names of its numbers, and `observe_field` are needed.
    """
    check_finite(weights)
    data = save_tensors({name: np.ascontiguousarray(array, np.float32) for name, array in weights.items()})
    header = {"format": FORMAT, "kind": "ppo", "sha256": sha256(data).hexdigest(), "about": about}
    write_checkpoint(folder, header, {"weights.safetensors": data})


class HeldActions(NamedTuple):
    """What every slot carries from decision to decision: decisions since its episode began, and the action held."""

    age: Int[np.ndarray, "B"]
    action: Float[np.ndarray, "B 6"]


class PPOPolicy(SlotPolicy):
    """Fly a batch of slots with a trained actor's mean action, held for a second.

    Args:
        folder: that `save_policy` wrote.
        config: the environment to fly; its decisions must divide a second.
        num_slots: flights side by side.
        field: the geodesic field, of a policy that observes it.

    Raises:
        CheckpointError: the folder is damaged or of another version.
        ValueError: the environment shows other numbers than the policy learned from, or its decisions don't divide
            a second.
    """

    def __init__(
        self,
        folder: str | os.PathLike,
        config: DockingConfig,
        num_slots: int = 1,
        field: GeodesicField | None = None,
    ):
        self.about, weights = _read(Path(folder))
        self._layers = [(weights[f"weight.{i}"].T, weights[f"bias.{i}"]) for i in range(len(weights) // 2 - 1)]
        self._mean, self._deviation = weights["mean"], np.sqrt(weights["variance"] + _EPSILON)
        layout = DockingEnv(config).layout
        super().__init__("PPO, observing the field" if self.about["observe_field"] else "PPO", layout, num_slots)
        if list(layout.names) != self.about["observation"]:
            raise ValueError(
                f"the policy observes {len(self.about['observation'])} numbers, those of {self.about['env']!r} with "
                f"goal errors; the environment shows {layout.size}"
            )
        if self.about["observe_field"] and field is None:
            raise ValueError("field must be given: the policy observes it")
        self._field = jax.device_put(field) if self.about["observe_field"] else None
        self._hold = round(DECISION / config.decision_dt)
        if self._hold < 1 or abs(self._hold * config.decision_dt - DECISION) > 1e-6:
            raise ValueError(f"decision_dt must divide {DECISION} s, which actions are held; got {config.decision_dt}")
        scaled = replace(layout, normalize=True)
        self._scale = jax.jit(jax.vmap(scaled.observe))

    def begin(self, count: int) -> HeldActions:
        """Nothing decided yet."""
        return HeldActions(np.zeros(count, np.int64), np.zeros((count, 6), np.float32))

    def act(
        self, state: HeldActions, observation: dict[str, np.ndarray], slots: Slots
    ) -> tuple[Float[np.ndarray, "B 6"], HeldActions]:
        """The action held; each slot decides anew when its second is over."""
        age, action = np.where(slots.fresh, 0, state.age), state.action
        due = age % self._hold == 0
        if due.any():
            action = np.where(due[:, None], self.decide(observation[STATE], slots.port), action)
        limit = np.asarray(self.layout.wrench_limit, np.float32)
        return action if self.layout.normalize else action * limit, HeldActions(age + 1, action)

    def decide(self, observation: Float[np.ndarray, "B O"], ports: Int[np.ndarray, "B"]) -> Float[np.ndarray, "B 6"]:
        """The actor's mean, as fractions of the wrench limits."""
        layout, x = self.layout, observation
        if not layout.normalize:
            x = np.asarray(self._scale(x[:, :2], x[:, layout.view], x[:, -12:]))
        if self._field is not None:
            x = with_field(self._field, ports, layout.measured_view(observation), x)
        x = np.clip((x - self._mean) / self._deviation, -_CLIP, _CLIP)
        for weight, bias in self._layers[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self._layers[-1]
        return np.clip(x @ weight + bias, -1.0, 1.0).astype(np.float32)


def _read(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    try:
        header = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        data = (folder / "weights.safetensors").read_bytes()
        if header["format"] != FORMAT or header["kind"] != "ppo":
            raise CheckpointError(
                f"{folder} holds {header['kind']!r} of format {header['format']}, not 'ppo' of {FORMAT}"
            )
        if sha256(data).hexdigest() != header["sha256"]:
            raise CheckpointError(f"{folder / 'weights.safetensors'} does not match config.json")
        about, weights = header["about"], load_tensors(data)
        check_finite(weights)
        size = len(about["observation"]) + FEATURES * about["observe_field"]
        if weights["mean"].shape != (size,) or weights["weight.0"].shape[1] != size:
            raise CheckpointError(f"{folder} observes {size} numbers, its weights {weights['mean'].shape}")
    except CheckpointError:
        raise
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise CheckpointError(f"{folder} is no policy that can be read: {error!r}") from error
    return about, weights
