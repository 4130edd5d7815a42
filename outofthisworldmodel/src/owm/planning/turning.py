"""Any world model before a target that turns: it predicts in the frame of the orbit, and is read in the target's."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PyTree

from owm.interface import History, WorldModel
from owm_envs.dynamics.turning import seen_at_rest, seen_turning
from owm_envs.task.sensors import STATE, TARGET_RATE


class TurningState(NamedTuple):
    """The model's own state, the target's rate (rad/s, its axes), and s since the last measurement of the history."""

    orbit: Any
    rate: Float[Array, "3"]
    elapsed: Float[Array, ""]


@dataclass(frozen=True)
class BeforeTurning:
    """A model that was made for a station at rest, before a target that turns and whose rate is measured.

    At the last measurement of a history both frames agree.
    """

    orbit: WorldModel
    parts: ClassVar[tuple[str, ...]] = (STATE, TARGET_RATE)

    @property
    def name(self) -> str:
        """The model's own."""
        return self.orbit.name

    @property
    def history_length(self) -> int:
        """The model's own."""
        return self.orbit.history_length

    @property
    def dt(self) -> float:
        """Seconds a step."""
        return self.orbit.dt

    @property
    def precision(self) -> str:
        """The mode that the model runs in."""
        return getattr(self.orbit, "precision", "float32")

    @property
    def params(self) -> PyTree:
        """The model's own."""
        return self.orbit.params

    def encode(self, params: PyTree, history: History) -> TurningState:
        """The model's state of a history in the frame of the orbit."""
        views = history.observation[STATE]
        rate = history.observation[TARGET_RATE][-1].astype(views.dtype)
        ages = jnp.asarray(self.dt * np.arange(1 - len(views), 1), views.dtype)
        at_rest = jax.vmap(seen_at_rest, (0, None, 0))(views, rate, ages)
        # Earlier ones than the first are copies of it.
        first = jnp.argmax(history.valid)
        at_rest = jnp.where(history.valid[:, None], at_rest, at_rest[first])
        state = self.orbit.encode(params, history._replace(observation={STATE: at_rest}))
        return TurningState(state, rate, jnp.zeros((), views.dtype))

    def step(
        self, params: PyTree, key: Key[Array, ""] | None, action: Float[Array, "6"], state: TurningState
    ) -> TurningState:
        """One step of the model."""
        orbit = self.orbit.step(params, key, action, state.orbit)
        return state._replace(orbit=orbit, elapsed=state.elapsed + self.dt)

    def observe(
        self, params: PyTree, state: TurningState, action: Float[Array, "6"], observation: dict[str, Array]
    ) -> TurningState:
        """Take in a measurement, in the frame of the orbit."""
        elapsed = state.elapsed + self.dt
        at_rest = seen_at_rest(observation[STATE], state.rate, elapsed)
        orbit = self.orbit.observe(params, state.orbit, action, {STATE: at_rest})
        return state._replace(orbit=orbit, elapsed=elapsed)

    def decode(self, params: PyTree, state: TurningState) -> dict[str, Array]:
        """The view from the target."""
        at_rest = self.orbit.decode(params, state.orbit)[STATE]
        return {STATE: seen_turning(at_rest, state.rate, state.elapsed)}


@jax.jit
def transition_at_rest(
    before: Float[Array, "B 13"], after: Float[Array, "B 13"], rate: Float[Array, "B 3"], dt: float
) -> tuple[Float[Array, "B 13"], Float[Array, "B 13"]]:
    """What views `dt` apart, from targets that turn, are in the frames of their orbits that agree at the later one."""
    return jax.vmap(seen_at_rest, (0, 0, None))(before, rate, -dt), jax.vmap(seen_at_rest)(after, rate)
