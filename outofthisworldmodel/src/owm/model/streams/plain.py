"""The plain stream: a token rolled forward between perceptrons, as published.

What sets it apart from the latent stream: nothing is given of how features lie in the token, of how they change, or of
how large a change is. Source: the paper, sections on the architecture and on training. Left open there and chosen here:
the state is one token, attitude is a rotation matrix, so that a quaternion's sign does not matter, position counts from
the start of the window, and no gradient passes through the flow's target.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from owm.checkpoint import positive
from owm.data.windows import Episodes
from owm.model.config import ModelConfig
from owm.model.streams.latent import SIZES, Latent, features, rms, to_view, units
from owm.model.transformer import MLP
from owm.motion.kinematics import pose
from owm.motion.linear import transitions

_FEATURES = sum(SIZES)


class Statistics(NamedTuple):
    """What is measured on the training episodes once and held fixed.

    Attributes:
        feature_scale: units of the features: m, m/s, none, rad/s.
        action_scale: root mean square of each action component.
    """

    feature_scale: Float[Array, "18"]
    action_scale: Float[Array, "6"]


class PlainStream(eqx.Module):
    """Latent autoregression over one token, its change counted in the token's own units."""

    encoder: MLP
    decoder: MLP
    width: int = eqx.field(static=True)
    token_count: ClassVar[int] = 1

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_encoder, k_decoder = jax.random.split(key)
        self.width = config.width
        self.encoder = MLP(_FEATURES, 2 * config.width, config.width, dtype, key=k_encoder)
        self.decoder = MLP(config.width, 2 * config.width, _FEATURES, dtype, key=k_decoder)

    @property
    def residual_size(self) -> int:
        """The token dimension."""
        return self.width

    @staticmethod
    def fit(episodes: Episodes) -> Statistics:
        """Measure the statistics on training episodes; measurements are used, not the truth."""
        before, _, action = transitions(episodes, 100_000)
        return Statistics(*(jnp.asarray(x, before.dtype) for x in (units(before), rms(action, 0))))

    @staticmethod
    def skeleton(dtype: jnp.dtype) -> Statistics:
        """Return the shapes of the statistics."""
        return Statistics(positive((_FEATURES,), dtype), positive((6,), dtype))

    def follow(
        self,
        statistics: Statistics,
        observation: Float[Array, "T 13"],
        action: Float[Array, "T-1 6"],
        valid: Bool[Array, "T"],
        dt: float,
    ) -> Latent:
        """Encode the measurements of a window, each by itself."""
        anchor = pose(observation[0])
        return jax.vmap(lambda view: self._encode(statistics, view, anchor))(observation)

    def observe(
        self, statistics: Statistics, carry: Latent, action: Float[Array, "6"], view: Float[Array, "13"], dt: float
    ) -> Latent:
        """Encode a new measurement; the anchor stays, because the tokens that attention remembers count from it."""
        return self._encode(statistics, view, carry.anchor)

    def _encode(self, statistics: Statistics, view: Array, anchor: Array) -> Latent:
        return Latent(anchor, self.encoder(features(view, anchor) / statistics.feature_scale)[None])

    def tokens(self, statistics: Statistics, carry: Latent) -> Float[Array, "1 d"]:
        """Return the token."""
        return carry.tokens

    def target(
        self, statistics: Statistics, before: Latent, after: Latent, action: Float[Array, "6"], dt: float
    ) -> Float[Array, "1 d"]:
        """Return the change of the token, not of unit variance; no gradient passes."""
        return jax.lax.stop_gradient(after.tokens - before.tokens)

    def change_loss(
        self, statistics: Statistics, before: Latent, after: Latent, action: Float[Array, "6"], dt: float
    ) -> Float[Array, ""]:
        """Zero: nothing lies under the network."""
        return jnp.zeros((), action.dtype)

    def advance(
        self,
        statistics: Statistics,
        carry: Latent,
        residual: Float[Array, "1 d"],
        action: Float[Array, "6"],
        dt: float,
        *,
        sampled: bool,
    ) -> Latent:
        """Add the predicted change to the token."""
        return carry._replace(tokens=carry.tokens + residual)

    def decode(self, statistics: Statistics, carry: Latent) -> dict[str, Array]:
        """Return the view, its quaternion that of the nearest rotation, on the anchor's side of the sphere."""
        return {"state": to_view(self.decoder(carry.tokens[0]) * statistics.feature_scale, carry.anchor)}

    def decode_loss(self, statistics: Statistics, carry: Latent, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Return the mean square error of the decoded features, in their units."""
        return jnp.mean((self.decoder(carry.tokens[0]) - features(view, carry.anchor) / statistics.feature_scale) ** 2)

    def round_trip_loss(self, statistics: Statistics, carry: Latent, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare an encoded measurement, decoded again, with itself."""
        return self.decode_loss(statistics, carry, view)
