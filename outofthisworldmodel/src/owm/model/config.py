"""What shapes a world model: a frozen, validated configuration and its presets."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from owm_envs.config.parts import Frozen

Measurements = Annotated[int, Field(ge=1, le=1024)]
Seconds = Annotated[float, Field(ge=1e-3, le=60.0)]
Layers = Annotated[int, Field(ge=1, le=64)]
Width = Annotated[int, Field(ge=1, le=8192)]
Heads = Annotated[int, Field(ge=1, le=256)]


class Timing(Frozen):
    """How a model without a network counts time."""

    history_length: Measurements
    dt: Seconds


class ModelConfig(Frozen):
    """Static choices; everything that training finds lives in the parameters instead."""

    stream: Literal["kinematic", "adaptive", "latent", "plain"] = "kinematic"
    """How observations become tokens and tokens become predictions: on rigid-body kinematics, on those of a vehicle
    found in its history, all learned, or all learned by perceptrons alone, as published."""
    base_dynamics: Literal["bilinear", "learned", "none"] = "bilinear"
    """What the latent stream adds to the network's prediction: a least-squares map of its features, a quadratic layer
    trained like all other weights, or nothing."""
    backbone: Literal["transformer", "gru", "mlp"] = "transformer"
    """What relates the tokens of a history: attention, or a recurrent or a feed-forward network of the same size."""
    dt: Seconds = 0.25
    """Seconds a step."""
    history_length: Measurements = 8
    """`H`: most measurements a prediction starts from."""
    width: Width = 32
    """Token dimension."""
    blocks: Layers = 1
    """Space-time blocks."""
    heads: Heads = 4
    """Attention heads."""
    window: Annotated[int, Field(ge=1, le=512)] = 8
    """Steps that attention or the feed-forward network reach back, the current one included."""
    mlp_ratio: Annotated[int, Field(ge=1, le=16)] = 2
    """Hidden width of a block's MLP, in token dimensions."""
    head_width: Width = 32
    """Width of the flow head, at most `width`."""
    head_blocks: Layers = 1
    """Residual MLPs in the flow head."""
    head_heads: Annotated[int, Field(ge=0, le=256)] = 0
    """Attention heads with which each of them lets the tokens of a step see each other; with 0 a token is by itself."""
    head: Literal["flow", "velocity", "mean-flow"] = "mean-flow"
    """What the head learns: the plain rectified flow by its clean end or by its velocity, or a mean flow, whose single
    evaluations are samples (`FlowHead`)."""
    head_steps: Annotated[int, Field(ge=1, le=64)] = 1
    """Evaluations of the head that a sample takes."""

    @model_validator(mode="after")
    def _check(self) -> "ModelConfig":
        if self.width % self.heads or (self.width // self.heads) % 2:
            raise ValueError(f"width must be an even multiple of heads, got width={self.width}, heads={self.heads}")
        if self.stream == "latent" and self.width < 10:
            raise ValueError(f"width must be at least 10 for the latent stream, got {self.width}")
        if self.head_width > self.width:
            raise ValueError(f"head_width must not exceed width={self.width}, got {self.head_width}")
        if self.head_heads and self.head_width % self.head_heads:
            raise ValueError(f"head_width must be a multiple of head_heads={self.head_heads}, got {self.head_width}")
        return self


PRESETS: dict[str, ModelConfig] = {
    "nano": ModelConfig(),
    "small": ModelConfig(width=64, blocks=2, window=16, head_width=64),
    "adaptive": ModelConfig(stream="adaptive", history_length=64),
    "latent": ModelConfig(stream="latent", base_dynamics="learned"),
    "paper": ModelConfig(
        stream="plain",
        base_dynamics="none",
        width=128,
        blocks=4,
        heads=8,
        window=32,
        mlp_ratio=4,
        head_width=128,
        head_blocks=2,
        head_heads=4,
        head="velocity",
    ),
}
"""Named sizes; `nano` trains on a laptop, and so do `adaptive`, for vehicles that differ, and `latent`, all learned;
`paper` is the publication's model without images (docs/decisions/paper-preset.md)."""


def preset(name: str) -> ModelConfig:
    """Return a named configuration.

    Raises:
        ValueError: for an unknown name.
    """
    if name not in PRESETS:
        raise ValueError(f"unknown model preset {name!r}, expected one of {', '.join(PRESETS)}")
    return PRESETS[name]
