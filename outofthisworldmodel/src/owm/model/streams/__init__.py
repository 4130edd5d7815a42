"""Streams: how one kind of observation becomes tokens, and how predicted token residuals become the next observation.

A stream is an `eqx.Module` with the weights that belong to it, its functions pure and for one example. What is rolled
forward is its carry, a pytree of its own type: of one stream a physical motion, of another the tokens themselves
(latent autoregression). Action encoder, backbone, flow head, training and planner are the same for all.
"""

from typing import Any, ClassVar, NamedTuple, Protocol

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from owm.data.windows import Episodes
from owm.model.config import ModelConfig
from owm.model.streams.adaptive import ADAPTIVE
from owm.model.streams.kinematic import KINEMATIC
from owm.model.streams.latent import LatentStream
from owm.model.streams.plain import PlainStream


class Stream(Protocol):
    """What a stream has to offer; `d` is the token dimension, `n` and `r` are its `token_count` and `residual_size`.

    `statistics` is what its `StreamType` measures.
    """

    token_count: ClassVar[int]
    """Tokens a step."""
    residual_size: int
    """Numbers that the flow head predicts for a token."""

    def follow(
        self,
        statistics: Any,
        observation: Float[Array, "T 13"],
        action: Float[Array, "T-1 6"],
        valid: Bool[Array, "T"],
        dt: float,
    ) -> Any:
        """Return the carries of all measurements of a window, stacked; leading ones may be copies, not `valid`."""

    def observe(
        self, statistics: Any, carry: Any, action: Float[Array, "6"], view: Float[Array, "13"], dt: float
    ) -> Any:
        """Return the carry of a view measured after an action from `carry`, whose tokens attention remembers."""

    def tokens(self, statistics: Any, carry: Any) -> Float[Array, "n d"]:
        """Return what the backbone sees of a carry."""

    def target(
        self, statistics: Any, before: Any, after: Any, action: Float[Array, "6"], dt: float
    ) -> Float[Array, "n r"]:
        """Return the residual, of unit variance, with which `advance` leads from a carry to the next measurement."""

    def change_loss(
        self, statistics: Any, before: Any, after: Any, action: Float[Array, "6"], dt: float
    ) -> Float[Array, ""]:
        """Compare a measured step with what the stream by itself predicts of it: trains what lies under the network."""

    def advance(
        self,
        statistics: Any,
        carry: Any,
        residual: Float[Array, "n r"],
        action: Float[Array, "6"],
        dt: float,
        *,
        sampled: bool,
    ) -> Any:
        """Advance the carry by one step under a residual, `sampled` or expected."""

    def decode(self, statistics: Any, carry: Any) -> dict[str, Array]:
        """Read the carry out; the entry `"state"` is the 13-number view in the station frame."""

    def decode_loss(self, statistics: Any, carry: Any, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare a predicted carry with the view measured at its time."""

    def round_trip_loss(self, statistics: Any, carry: Any, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare the carry of a measured view with that view: what encoder and decoder lose between them."""


class StreamType(Protocol):
    """What makes the streams of one name."""

    def __call__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]) -> Stream:
        """Draw the initial weights of one."""

    def fit(self, episodes: Episodes) -> NamedTuple:
        """Measure the statistics on training episodes, held fixed in training.

        One of the fields is `action_scale` (6,), the root mean square of each action component.
        """

    def skeleton(self, dtype: jnp.dtype) -> NamedTuple:
        """Return the shapes of the statistics."""


STREAMS: dict[str, StreamType] = {
    "kinematic": KINEMATIC,
    "adaptive": ADAPTIVE,
    "latent": LatentStream,
    "plain": PlainStream,
}
"""Streams by the name that `ModelConfig.stream` gives."""
