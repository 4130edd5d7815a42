"""The floor: whatever moves keeps moving, whatever turns keeps turning, actions are ignored."""

from dataclasses import dataclass, field

import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from owm.checkpoint import Contents, fill
from owm.interface import History
from owm.model.config import Timing
from owm.motion.kinematics import Motion, advance, to_motion, to_view
from owm_envs.task.sensors import STATE


@dataclass(frozen=True)
class ConstantVelocity:
    """Constant station-relative velocity and body rate."""

    history_length: int = 8
    dt: float = 0.25
    name: str = field(default="constant velocity", compare=False)
    params: tuple[()] = field(default=(), compare=False)

    def contents(self) -> Contents:
        """What a checkpoint holds of it."""
        config = {"history_length": self.history_length, "dt": self.dt}
        return Contents("constant_velocity", self.name, config, ())

    @classmethod
    def from_contents(cls, contents: Contents) -> "ConstantVelocity":
        """The model that a checkpoint holds. Raises CheckpointError, ValueError: it holds something else."""
        nothing = fill((), {**contents.weights, **contents.statistics})
        return cls(**dict(Timing.model_validate(contents.config, strict=True)), name=contents.name, params=nothing)

    def encode(self, params: tuple[()], history: History) -> Motion:
        """Start from the last measurement."""
        view = history.observation[STATE][-1]
        return to_motion(view, view)

    def step(self, params: tuple[()], key: Key[Array, ""] | None, action: Float[Array, "6"], state: Motion) -> Motion:
        """Coast for one step."""
        return advance(state, jnp.zeros_like(state.anchor[:6]), self.dt)

    def observe(
        self, params: tuple[()], state: Motion, action: Float[Array, "6"], observation: dict[str, Array]
    ) -> Motion:
        """Forget the past."""
        return to_motion(observation[STATE], observation[STATE])

    def decode(self, params: tuple[()], state: Motion) -> dict[str, Array]:
        """Return the view in the station frame."""
        return {"state": to_view(state)}
