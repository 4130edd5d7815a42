"""A trained PPO policy as numbers: written, read and flown without Stable-Baselines3, nothing pickled."""

import os
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from owm.baselines.ppo.features import FEATURES, with_field
from owm.checkpoint import LARGEST, CheckpointError, Contents, Within, fill, read_checkpoint, write_checkpoint
from owm_envs.config import DockingConfig
from owm_envs.config.parts import Frozen
from owm_envs.env import DockingEnv
from owm_envs.field import GeodesicField
from owm_envs.policies import SlotPolicy, Slots
from owm_envs.task.sensors import STATE

ACTIONS = 6
DECISION = 1.0
"""Seconds that PPO's actions are held, in training and in flight."""
_CLIP = 10.0
_EPSILON = 1e-8
"""As `VecNormalize` has them."""


class Observed(Frozen):
    """What a policy looks at."""

    env: str
    """Fidelity of the simulation that it was trained in."""
    observe_field: bool
    """Whether the geodesic field at the measured position too."""
    observation: list[str]
    """Names of the other numbers."""


def save_policy(folder: Path, weights: dict[str, np.ndarray], observed: Observed, about: dict[str, Any]) -> None:
    """Write a policy, whole or not at all.

    Args:
        folder: to write or replace.
        weights: `weight.i` (outputs, inputs) and `bias.i` of each layer, `mean` and `variance` of the observation.
        observed: what it looks at.
        about: JSON-able facts.

    Raises:
        CheckpointError: the weights don't fit together, or a number is not finite.
    """
    weights = {name: np.ascontiguousarray(array, np.float32) for name, array in weights.items()}
    fill(_layout(observed, weights), weights)
    write_checkpoint(folder, Contents("ppo", "PPO", observed.model_dump(), weights), about)


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
        observed, weights = read_checkpoint(folder, read_policy)
        self._layers = [(weights[f"weight.{i}"].T, weights[f"bias.{i}"]) for i in range(len(weights) // 2 - 1)]
        self._mean, self._deviation = weights["mean"], np.sqrt(weights["variance"] + _EPSILON)
        layout = DockingEnv(config).layout
        super().__init__("PPO, observing the field" if observed.observe_field else "PPO", layout, num_slots)
        if list(layout.names) != observed.observation:
            raise ValueError(
                f"the policy observes {len(observed.observation)} numbers, those of {observed.env!r} with "
                f"goal errors; the environment shows {layout.size}"
            )
        if observed.observe_field and field is None:
            raise ValueError("field must be given: the policy observes it")
        self._field = jax.device_put(field) if observed.observe_field else None
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


def read_policy(contents: Contents) -> tuple[Observed, dict[str, np.ndarray]]:
    """What a policy looks at, and its weights. Raises CheckpointError, ValueError: they don't fit together."""
    if contents.kind != "ppo":
        raise CheckpointError(f"expected a policy of kind 'ppo', found {contents.kind!r}")
    observed = Observed.model_validate(contents.config, strict=True)
    fill((), contents.statistics)
    return observed, jax.device_get(fill(_layout(observed, contents.weights), contents.weights))


def _layout(observed: Observed, weights: Mapping[str, Any]) -> dict[str, jax.ShapeDtypeStruct]:
    """What the weights must be: layers as wide as their biases, from the observation to six actions."""
    layers = sum(name.startswith("weight.") for name in weights)
    if not layers:
        raise CheckpointError("weights.safetensors holds no layers")
    inside = [getattr(weights.get(f"bias.{i}"), "shape", ()) for i in range(layers - 1)]
    size = len(observed.observation) + FEATURES * observed.observe_field
    widths = [size, *(shape[0] if shape else 0 for shape in inside), ACTIONS]
    layout: dict[str, jax.ShapeDtypeStruct] = {
        "mean": Within((size,), np.float32, -LARGEST, LARGEST),
        "variance": Within((size,), np.float32, 0.0, LARGEST),
    }
    for i, (inputs, outputs) in enumerate(pairwise(widths)):
        layout[f"weight.{i}"] = jax.ShapeDtypeStruct((outputs, inputs), np.float32)
        layout[f"bias.{i}"] = jax.ShapeDtypeStruct((outputs,), np.float32)
    return layout
