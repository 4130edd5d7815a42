"""The one interface behind which every world model, learned or not, meets the planner and the scores."""

from typing import Any, NamedTuple, Protocol

import jax
from jaxtyping import Array, Bool, Float, Key, PyTree, Shaped


class History(NamedTuple):
    """The most recent measurements and the actions that joined them, oldest first, right-aligned.

    Early in an episode fewer than `H` measurements exist: the leading ones are then copies of the first and
    `valid` is False there; the last entry is always valid.

    Attributes:
        observation: parts by the names of their sensors, `dt` apart; "state" is the measured relative view, as
            `owm_envs.view.View` takes it apart.
        action: body force (N) and torque (N m) held from one measurement to the next: `action[i]` took
            `observation[i]` to `observation[i + 1]`.
        valid: which measurements are real.
    """

    observation: dict[str, Shaped[Array, "H ..."]]
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
    # `parts`, the names of what it looks at of an observation, is ("state",) unless the model says otherwise; its
    # `precision`, the mode that it runs in, "float32".
    params: PyTree
    """The values to pass as `params`."""

    def encode(self, params: PyTree, history: History) -> Any:
        """Turn a history into the state from which `step` predicts."""

    def step(self, params: PyTree, key: Key[Array, ""] | None, action: Float[Array, "6"], state: Any) -> Any:
        """Predict one step of `dt` under a held action; `key=None` gives the deterministic prediction."""

    def observe(self, params: PyTree, state: Any, action: Float[Array, "6"], observation: dict[str, Array]) -> Any:
        """Advance by one executed action and the observation, by parts, that followed it."""

    def decode(self, params: PyTree, state: Any) -> dict[str, Array]:
        """Read a state out as parts, named as an observation's; "state" is the 13-number view in the station frame."""


def roll_out(
    model: WorldModel,
    params: PyTree,
    state: Any,
    actions: Float[Array, "T 6"],
    *,
    keys: Key[Array, "T"] | None = None,
) -> Float[Array, "T 13"]:
    """Predict the view after each of a sequence of held actions.

    Args:
        state: from `encode`.
        actions: body force (N) and torque (N m), each held for `model.dt`.
        keys: one a step for a sample; the deterministic prediction when None.
    """

    def advance(state: Any, given: tuple[Array | None, Array]) -> tuple[Any, Array]:
        state = model.step(params, *given, state)
        return state, model.decode(params, state)["state"]

    return jax.lax.scan(advance, state, (keys, actions))[1]


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
