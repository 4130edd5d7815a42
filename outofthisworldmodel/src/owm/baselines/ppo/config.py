"""How the reinforcement learning baseline is trained: a frozen configuration and its presets."""

from functools import partial
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from owm_envs.config.parts import Frozen, within
from owm_envs.words import checked_seed

Fraction = Annotated[float, within(1e-6, 1)]
Weight = Annotated[float, within(0, 1e6)]
Size = Annotated[int, Field(gt=0, le=10**6)]


class PPOConfig(Frozen):
    """The paper's table of its PPO baseline; the task is the preset "rl" of `owm_envs`, its reward included."""

    env: Literal["iss", "iss-hcw", "iss-numerical"] = "iss-numerical"
    """Fidelity of the simulation."""
    noise: str = "cooperative"
    """Preset of sensor noise; the paper trains one policy for each."""
    observe_field: bool = False
    """Also observe the geodesic field at the measured position: its gradient and the cost-to-go. Not in the paper."""
    steps: Annotated[int, Field(gt=0, le=10**12)] = 25_000_000
    """Decisions, of 1 s each, of all environments together."""
    envs: Annotated[int, Field(gt=0, le=2**16)] = 32
    """Environments side by side."""
    learning_rate: Annotated[float, within(1e-12, 10)] = 2.2e-4
    """Adam's, constant."""
    gamma: Fraction = 0.997
    """Discount."""
    network: tuple[Annotated[int, Field(gt=0, le=2**14)], ...] = (256, 256, 256)
    """Hidden widths of the actor, and of the critic beside it; tanh between."""
    batch: Annotated[int, Field(gt=0, le=10**9)] = 1024
    """Transitions a gradient step."""
    rollout: Size = 1024
    """Decisions of each environment between updates."""
    gae_lambda: Fraction = 0.945
    """Of the advantage estimate."""
    clip: Annotated[float, within(1e-6, 1e3)] = 0.1
    """Range of the probability ratio."""
    epochs: Size = 20
    """Passes over a rollout."""
    value_weight: Weight = 0.67
    """Weight of the value loss."""
    entropy_weight: Weight = 1e-3
    """Weight of the entropy bonus."""
    target_kl: Annotated[float, within(1e-6, 1e6)] = 0.02
    """An update ends early beyond one and a half times this divergence."""
    normalize_reward: bool = True
    """Divide rewards by the running deviation of the discounted return; the paper does not say."""
    validate_every: Size = 10
    """Rollouts between saves and validations."""
    validation_episodes: Size = 20
    """Fixed starts, spread over the train ports, that choose the best policy."""
    seed: int = 0
    """Of weights, exploration and starts."""

    _seed = field_validator("seed")(partial(checked_seed, bits=32))

    @model_validator(mode="after")
    def _check(self) -> "PPOConfig":
        if self.batch > self.envs * self.rollout:
            raise ValueError(f"batch must not exceed envs * rollout = {self.envs * self.rollout}, got {self.batch}")
        return self


PRESETS: dict[str, PPOConfig] = {
    "paper": PPOConfig(),
    "ci": PPOConfig(
        steps=2048, envs=8, rollout=128, batch=256, epochs=2, network=(32, 32), validate_every=1, validation_episodes=5
    ),
}
"""`paper`: 25 M decisions; `ci`: seconds, only to see it run."""
