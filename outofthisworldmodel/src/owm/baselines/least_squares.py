"""What a linear fit alone achieves on the analytic kinematics: the bar that a network has to clear."""

from dataclasses import dataclass, field

from jaxtyping import Array, Float, Key

from owm.checkpoint import Contents, dtype_of, fill
from owm.data.windows import Episodes
from owm.interface import History
from owm.model.config import Timing
from owm.motion.kinematics import Motion, to_motion, to_view
from owm.motion.linear import LinearMap, fit_linear_map, linear_advance
from owm_envs.task.sensors import STATE


@dataclass(frozen=True)
class LeastSquares:
    """Increments linear in the action and, if fitted, in position, velocity and products of body rates."""

    params: LinearMap = field(compare=False, repr=False)
    history_length: int = 8
    dt: float = 0.25
    name: str = field(default="least squares", compare=False)

    def contents(self) -> Contents:
        """What a checkpoint holds of it."""
        config = {"history_length": self.history_length, "dt": self.dt}
        return Contents("least_squares", self.name, config, self.params)

    @classmethod
    def from_contents(cls, contents: Contents) -> "LeastSquares":
        """The model that a checkpoint holds. Raises CheckpointError, ValueError: configuration or weights don't fit."""
        timing = Timing.model_validate(contents.config, strict=True)
        fill((), contents.statistics)
        params = fill(LinearMap.skeleton(dtype_of(contents.weights)), contents.weights)
        return cls(params, **dict(timing), name=contents.name)

    def encode(self, params: LinearMap, history: History) -> Motion:
        """Start from the last measurement."""
        view = history.observation[STATE][-1]
        return to_motion(view, view)

    def step(self, params: LinearMap, key: Key[Array, ""] | None, action: Float[Array, "6"], state: Motion) -> Motion:
        """Apply the map for one step; deterministic with or without a key."""
        return linear_advance(params, state, action, self.dt)

    def observe(
        self, params: LinearMap, state: Motion, action: Float[Array, "6"], observation: dict[str, Array]
    ) -> Motion:
        """Forget the past."""
        return to_motion(observation[STATE], observation[STATE])

    def decode(self, params: LinearMap, state: Motion) -> dict[str, Array]:
        """Return the view in the station frame."""
        return {"state": to_view(state)}


def fit_least_squares(episodes: Episodes, *, motion: bool = True, history_length: int = 8) -> LeastSquares:
    """Fit the baseline to training episodes.

    Args:
        episodes: measured transitions; the truth is not used.
        motion: fit orbital and gyroscopic terms too, as the map under the network does; otherwise the action's effect
            alone.
        history_length: `H` to report, so that it takes the same histories as the model beside it.
    """
    name = "least squares" if motion else "least squares, action only"
    return LeastSquares(fit_linear_map(episodes, motion=motion), history_length, episodes.dt, name)
