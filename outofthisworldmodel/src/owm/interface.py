"""The one interface behind which every world model, learned or not, meets the planner and the scores."""

from typing import Any, NamedTuple, Protocol

from jaxtyping import Array, Bool, Float, Key, PyTree


class History(NamedTuple):
    """The most recent measurements and the actions that joined them, oldest first, right-aligned.

    Early in an episode fewer than `H` measurements exist: the leading ones are then copies of the first and
    `valid` is False there; the last entry is always valid.

    Attributes:
        observation: measured 13-number relative views (position m, velocity m/s in the station frame, scalar-first
            unit quaternion body to station, body rate rad/s), `dt` apart.
        action: body force (N) and torque (N m) held from one measurement to the next: `action[i]` took
            `observation[i]` to `observation[i + 1]`.
        valid: which measurements are real.
    """

    observation: Float[Array, "H 13"]
    action: Float[Array, "H-1 6"]
    valid: Bool[Array, "H"]


class WorldModel(Protocol):
    """A predictor of the relative view under given actions.

    All four functions are pure, written for one example, and take the traced `params` first (weights, or physical
    constants), so that one compiled planner serves every checkpoint. A model's `State` is its own pytree.
    """

    name: str
    """What reports call it."""
    history_length: int
    """`H`, static."""
    dt: float
    """Seconds a step."""
    params: PyTree
    """The values to pass as `params`."""

    def encode(self, params: PyTree, history: History) -> Any:
        """Turn a history into the state from which `step` predicts."""

    def step(self, params: PyTree, key: Key[Array, ""] | None, action: Float[Array, "6"], state: Any) -> Any:
        """Predict one step of `dt` under a held action; `key=None` gives the deterministic prediction."""

    def observe(self, params: PyTree, state: Any, action: Float[Array, "6"], observation: Float[Array, "13"]) -> Any:
        """Advance by one executed action and the measurement that followed it."""

    def decode(self, params: PyTree, state: Any) -> dict[str, Array]:
        """Read a state out as `{stream: value}`; the stream `"state"` is the 13-number view in the station frame."""


def check_complete(model: Any) -> None:
    """Refuse what is no world model.

    Raises:
        TypeError: naming what it lacks of `WorldModel`.
    """
    wanted = ("name", "history_length", "dt", "params", "encode", "step", "observe", "decode")
    if lacking := [part for part in wanted if not hasattr(model, part)]:
        raise TypeError(
            f"the world model {type(model).__name__} lacks {', '.join(lacking)} (see owm.interface.WorldModel)"
        )
