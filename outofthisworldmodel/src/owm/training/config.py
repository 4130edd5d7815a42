"""How a world model is trained: a frozen, validated configuration and its presets."""

import math
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from owm.model.config import PRESETS as MODELS
from owm.model.config import ModelConfig
from owm_envs.config.parts import Frozen, within
from owm_envs.words import checked_seed

Fraction = Annotated[float, within(0, 1)]
Weight = Annotated[float, within(0, 1e6)]
Size = Annotated[int, Field(gt=0, le=10**6)]
Steps = Annotated[int, Field(gt=0, le=10**9)]
Rollout = Annotated[int, Field(gt=0, le=10**4)]
"""Steps of a rollout: a training step goes through each."""


class TrainConfig(Frozen):
    """Everything a run depends on beside its data; equal configuration and data give equal weights on one machine."""

    model: ModelConfig = ModelConfig()
    """The network to train."""
    steps: Steps = 3000
    """Optimisation steps."""
    epochs: Annotated[float, within(1e-3, 1e6)] | None = None
    """Where given, in place of `steps`: passes over as many windows as the training episodes hold."""
    batch: Size | Literal["auto"] = 32
    """Windows a step; "auto" is the largest power of two whose step fits into `memory_gb`, found before training."""
    memory_gb: Annotated[float, within(1e-3, 1e6)] | None = None
    """What a step of batch="auto" may take; None is nine tenths of the device's memory, where it tells how much."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the network's forward and backward pass; weights, statistics, kinematics and losses are float32."""
    devices: Size | None = None
    """Local devices that share each batch; None is all of them."""
    learning_rate: Annotated[float, within(1e-12, 10)] = 1e-3
    """Peak of AdamW's rate; it rises linearly over `warmup` steps, then falls along a cosine."""
    final_rate: Fraction = 0.01
    """Part of the peak that the rate falls to by the last step; at 1 it does not fall."""
    warmup: Steps = 300
    """Steps of linear warm-up."""
    weight_decay: Annotated[float, within(0, 10)] = 1e-4
    """AdamW's decay."""
    clip: Annotated[float, within(1e-6, 1e6)] = 1.0
    """Largest gradient norm."""
    teacher: Fraction = 0.25
    """Fraction of the run over which the probability of continuing from the measurement falls from one to zero."""
    teacher_epochs: Annotated[float, within(0, 1e6)] | None = None
    """Where given, in place of `teacher`: the same in epochs."""
    rollouts: tuple[tuple[Fraction, Rollout], ...] = ((0.6, 16), (1.0, 32))
    """Rollout lengths `F`, each up to a fraction of the run; a jump by more than a factor of two destabilises."""
    decoded: Rollout | None = None
    """Steps of each rollout whose predictions are compared with measurements, drawn anew for every batch; None is all.
    At most as many as the shortest of `rollouts` has."""
    short_histories: bool = True
    """Whether every other window shows the model only a part of its history, from one measurement, as flights begin."""
    flow_weight: Weight = 1.0
    """Weight of the flow loss."""
    decode_weight: Weight = 1.0
    """Weight of the decode loss."""
    round_trip_weight: Weight = 1.0
    """Weight of the round-trip loss."""
    chunk: Size = 50
    """Steps a compiled call makes, between which progress is reported."""
    save_every: Steps = 500
    """Steps between saves and validations, a multiple of `chunk`."""
    validation_windows: Size = 256
    """Fixed windows of each kind, behaviour and planner-style, that choose the best weights."""
    validation_horizon: Rollout = 64
    """Steps of every validation rollout."""
    keep_checkpoints: Annotated[int, Field(ge=0, le=10**6)] = 20
    """Latest saves whose weights stay under `checkpoints`, to be compared."""
    seed: int = 0
    """Of weights, batches, noise and the choice of validation windows."""

    _seed = field_validator("seed")(partial(checked_seed, bits=32))

    @model_validator(mode="after")
    def _check(self) -> "TrainConfig":
        if self.save_every % self.chunk:
            raise ValueError(f"save_every must be a multiple of chunk={self.chunk}, got {self.save_every}")
        if self.steps % self.chunk:
            raise ValueError(f"steps must be a multiple of chunk={self.chunk}, got {self.steps}")
        ends = [end for end, _ in self.rollouts]
        if not ends or ends != sorted(ends) or ends[-1] != 1.0:
            raise ValueError(f"rollouts must be pairs of rising fractions ending at 1.0, got {self.rollouts}")
        shortest = min(length for _, length in self.rollouts)
        if self.decoded is not None and self.decoded > shortest:
            raise ValueError(f"decoded must be at most {shortest}, the shortest of rollouts, got {self.decoded}")
        return self

    def __repr_args__(self) -> list[tuple[str | None, Any]]:
        named = next((name for name, model in MODELS.items() if model == self.model), self.model)
        return [(name, named if name == "model" else value) for name, value in super().__repr_args__()]

    def settled(self, windows: int, batch: int, devices: int) -> "TrainConfig":
        """Return the same run with epochs counted in steps, and batch and devices as found.

        Args:
            windows: how many of the longest rollout the training episodes hold: an epoch.
            batch: windows a step.
            devices: that share it.
        """
        epoch = windows / batch
        steps, teacher = self.steps, self.teacher
        if self.epochs is not None:
            steps = math.ceil(self.epochs * epoch / self.chunk) * self.chunk
        if self.teacher_epochs is not None:
            teacher = min(self.teacher_epochs * epoch / steps, 1.0)
        found = {"batch": batch, "devices": devices, "steps": steps, "teacher": teacher}
        return self.model_copy(update=found | {"epochs": None, "teacher_epochs": None})

    def rollout_at(self, step: int) -> int:
        """Return the rollout length `F` of a step."""
        return next(length for end, length in self.rollouts if step < end * self.steps or end == 1.0)


PRESETS: dict[str, TrainConfig] = {
    "ci": TrainConfig(steps=400, warmup=50, rollouts=((1.0, 16),), save_every=200, chunk=50, validation_windows=128),
    "nano": TrainConfig(),
    "adaptive": TrainConfig(model=MODELS["adaptive"]),
    "small": TrainConfig(model=MODELS["small"], steps=20_000, rollouts=((0.4, 16), (0.8, 32), (1.0, 64))),
    "latent": TrainConfig(
        model=MODELS["latent"],
        learning_rate=3e-3,
        warmup=100,
        rollouts=((0.4, 4), (0.6, 8), (0.8, 16), (1.0, 32)),
    ),
    "paper": TrainConfig(
        model=MODELS["paper"],
        epochs=16,
        teacher_epochs=4,
        batch="auto",
        precision="bfloat16",
        final_rate=1.0,
        rollouts=((1.0, 64),),
        decoded=16,
        short_histories=False,
        round_trip_weight=0.0,
    ),
}
"""`ci`: about half a minute on two cores; `nano`, `adaptive`, `latent`: minutes; `small`: an hour; `paper`: an
accelerator (not measured). `latent` begins with short rollouts, while the layer under the network is found, and those
are cheap."""


def preset(name: str) -> TrainConfig:
    """Return a named configuration.

    Raises:
        ValueError: for an unknown name.
    """
    if name not in PRESETS:
        raise ValueError(f"unknown training preset {name!r}, expected one of {', '.join(PRESETS)}")
    return PRESETS[name]
