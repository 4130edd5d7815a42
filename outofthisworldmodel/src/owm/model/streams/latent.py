"""The latent stream: the tokens themselves are rolled forward, between a learned encoder and a learned decoder.

A view becomes four tokens (position, velocity, attitude, rate), the next four follow from them, and only a decoder
turns tokens into a view again. No equation of motion is given. Source: the paper, section on the architecture.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from astrojax.attitude import quat_sign
from owm.checkpoint import LARGEST, Within, positive
from owm.data.windows import Episodes
from owm.model.config import ModelConfig
from owm.model.transformer import MLP, Linear
from owm.motion.bilinear import COLUMNS, bilinear_change, fit_bilinear_map
from owm.motion.kinematics import decode_penalty, pose, quaternion, rotation
from owm.motion.linear import transitions
from owm_envs.view import View

SIZES = (3, 3, 9, 3)
"""Features of a token: position, velocity, rotation matrix, rate."""
_FEATURES = sum(SIZES)
_OWNER = np.repeat(np.arange(len(SIZES)), SIZES)
_FIRST = np.cumsum((0, *SIZES[:-1]))
_MEMBERS = np.eye(len(SIZES))[:, _OWNER]  # (4, 18): which features are a token's
_INPUTS = 1 + _FEATURES + 6  # one, features, action
SECONDS = 10.0
"""The way gone in this time at the root-mean-square speed is the unit of position."""
SPREAD_RATE = 10.0
"""Multiplies the learning rate of trained spreads: Adam moves all weights alike, and these fall a hundredfold."""


class Statistics(NamedTuple):
    """What is measured on the training episodes once and held fixed.

    Attributes:
        feature_scale: units of the four kinds of features: m, m/s, none, rad/s.
        transition: the least-squares map under the network, in scaled features and actions; not read where
            `config.base_dynamics` is another.
        residual_scale: root mean square of a token's change that the map leaves, per component of the token.
        change_scale: the same of the whole change, for models without the map.
        action_scale: root mean square of each action component.
    """

    feature_scale: Float[Array, "4"]
    transition: Float[Array, "18 c"]
    residual_scale: Float[Array, "4"]
    change_scale: Float[Array, "4"]
    action_scale: Float[Array, "6"]


class Latent(NamedTuple):
    """Tokens, and the pose at the start of the window: position counts from there, and orbital terms depend on it."""

    anchor: Float[Array, "7"]
    tokens: Float[Array, "n d"]


def features(view: Float[Array, "13"], anchor: Float[Array, "7"]) -> Float[Array, "18"]:
    """Return position from the anchor, velocity, rotation matrix (station frame) and body rate, SI."""
    position, velocity, attitude, rate = View.of(view)
    return jnp.concatenate([position - anchor[:3], velocity, rotation(attitude).reshape(9), rate])


def to_view(features: Float[Array, "18"], anchor: Float[Array, "7"]) -> Float[Array, "13"]:
    """Undo `features`: the quaternion is that of the nearest rotation, on the anchor's side of the sphere."""
    q = quaternion(features[6:15].reshape(3, 3))
    q = quat_sign(q, anchor[3:]) * q
    return jnp.concatenate([features[:3] + anchor[:3], features[3:6], q, features[15:]])


def rms(x: Array, axis: int | None = None) -> Float[np.ndarray, "..."]:
    """Return the root mean square, which is never zero."""
    return np.maximum(np.sqrt(np.mean(np.square(np.asarray(x, np.float64)), axis=axis)), 1e-9)


def units(views: Float[Array, "N 13"]) -> Float[np.ndarray, "18"]:
    """Return what features are counted in: the way gone in `SECONDS`, m, the speed, m/s, none, the rate, rad/s."""
    _, velocity, _, rate = View.of(views)
    return np.asarray([SECONDS * rms(velocity), rms(velocity), 3**-0.5, rms(rate)])[_OWNER]


def embedding(width: int) -> Float[np.ndarray, "18 4*d"]:
    """Return orthonormal rows that lay each feature out in its token: cosines, without the constant.

    Source: the discrete cosine transform II.
    """
    order = np.concatenate([1 + np.arange(size) for size in SIZES])
    rows = np.sqrt(2 / width) * np.cos(np.pi * np.outer(order, np.arange(width) + 0.5) / width)
    return (_MEMBERS.T[:, :, None] * rows[:, None]).reshape(_FEATURES, -1)


class LatentStream(eqx.Module):
    """Latent autoregression over four tokens.

    Encoder and decoder are MLPs beside a fixed isometry between features and tokens: it keeps a token from
    losing a feature or shrinking, so that latents cannot collapse while targets have a scale that is measured once.
    Velocity and attitude are in the station's axes: in those of the window's first pose, orbital and gyroscopic terms
    would be products of three features, which the map has not.
    A token's next value is its own, plus what a layer of the encoded features gives, plus what the flow head predicts.
    `config.base_dynamics` says which layer: a least-squares map, none, or a trained one that sees every product of two
    of the features and actions, or of one with one, and begins at zero. Nothing tells it which of them matter. It is
    trained on measured steps alone (`change_loss`), a convex problem, because the gradients of rollouts would drown
    theirs.

    Attributes:
        quadratic: the trained layer.
        spread: how much of a token's change it leaves, as a logarithm in tenths: the unit of what the head predicts.
    """

    encoder: MLP
    decoder: MLP
    context: Linear
    quadratic: Float[Array, "625 18"] | None
    spread: Float[Array, "4"] | None
    width: int = eqx.field(static=True)
    base_dynamics: str = eqx.field(static=True)
    token_count: ClassVar[int] = len(SIZES)

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_encoder, k_decoder, k_context = jax.random.split(key, 3)
        self.width, self.base_dynamics = config.width, config.base_dynamics
        hidden, flat = 2 * config.width, len(SIZES) * config.width
        self.encoder = MLP(_FEATURES, hidden, flat, dtype, key=k_encoder, scale=0.0)
        self.decoder = MLP(flat, hidden, _FEATURES, dtype, key=k_decoder, scale=0.0)
        self.context = Linear(3, config.width, dtype, key=k_context, scale=0.1)
        learned = config.base_dynamics == "learned"
        self.quadratic = jnp.zeros((_INPUTS**2, _FEATURES), dtype) if learned else None
        self.spread = jnp.zeros(len(SIZES), dtype) if learned else None

    @property
    def residual_size(self) -> int:
        """The token dimension."""
        return self.width

    @staticmethod
    def fit(episodes: Episodes) -> Statistics:
        """Measure the statistics on training episodes; measurements are used, not the truth."""
        before, after, action = transitions(episodes, 100_000)
        dtype = before.dtype
        scale, action_scale = jnp.asarray(units(before), dtype), jnp.asarray(rms(action, 0), dtype)
        origin = jnp.zeros(7, dtype)
        first, second = (jax.jit(jax.vmap(lambda view: features(view, origin) / scale))(x) for x in (before, after))
        transition, left = fit_bilinear_map(first, action / action_scale, second - first)
        # An isometry spreads the features of a token over all of its components.
        spread = [np.sqrt(np.maximum(_MEMBERS @ np.mean(np.square(x), axis=0), 1e-16)) for x in (left, second - first)]
        residual, change = (jnp.asarray(x, dtype) for x in spread)
        return Statistics(scale[_FIRST], jnp.asarray(transition, dtype), residual, change, action_scale)

    @staticmethod
    def skeleton(dtype: jnp.dtype) -> Statistics:
        """Return the shapes of the statistics."""
        transition = Within((_FEATURES, COLUMNS), dtype, -LARGEST, LARGEST)
        scale = positive((4,), dtype)
        return Statistics(scale, transition, scale, scale, positive((6,), dtype))

    def embed(self, features: Float[Array, "18"]) -> Float[Array, "4 d"]:
        """Lay scaled features out in their tokens, the linear part of the encoder."""
        return (features @ jnp.asarray(embedding(self.width), features.dtype)).reshape(len(SIZES), -1)

    def read(self, tokens: Float[Array, "4 d"]) -> Float[Array, "18"]:
        """Return the scaled features that lie in the tokens, the linear part of the decoder; undoes `embed`."""
        return jnp.asarray(embedding(self.width), tokens.dtype) @ tokens.reshape(-1)

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
        scaled = features(view, anchor) / statistics.feature_scale[_OWNER]
        learned = self._scale(statistics) * self.encoder(scaled).reshape(len(SIZES), -1)
        return Latent(anchor, self.embed(scaled) + learned)

    def tokens(self, statistics: Statistics, carry: Latent) -> Float[Array, "4 d"]:
        """Return the tokens, and where their positions count from."""
        return carry.tokens + self.context(carry.anchor[:3] / statistics.feature_scale[0])

    def _scale(self, statistics: Statistics) -> Float[Array, "4 1"]:
        """Return the size of residuals. All that is learned is counted in it, so that it begins small."""
        scale = statistics.residual_scale if self.base_dynamics == "bilinear" else statistics.change_scale
        if self.spread is not None:
            scale = scale * jax.lax.stop_gradient(jnp.exp(SPREAD_RATE * self.spread))
        return scale[:, None] * self.width**-0.5

    def _change(self, statistics: Statistics, carry: Latent, action: Array) -> Float[Array, "4 d"]:
        """Return the change of the tokens by the layer under the network."""
        if self.base_dynamics == "none":
            return jnp.zeros_like(carry.tokens)
        scaled, action = self.read(carry.tokens), action / statistics.action_scale
        if self.quadratic is not None:
            inputs = jnp.concatenate([jnp.ones_like(scaled[:1]), scaled, action])
            change = (inputs[:, None] * inputs[None, :]).reshape(-1) @ self.quadratic
            return self.embed(statistics.change_scale[_OWNER] * change)
        absolute = scaled.at[:3].add(carry.anchor[:3] / statistics.feature_scale[0])
        return self.embed(bilinear_change(statistics.transition, absolute, action))

    def target(
        self, statistics: Statistics, before: Latent, after: Latent, action: Float[Array, "6"], dt: float
    ) -> Float[Array, "4 d"]:
        """Return the unit-variance residual between encoded measurements.

        No gradient passes: the encoder is to serve prediction and decoder, not to make its own targets easy.
        """
        change = after.tokens - before.tokens - self._change(statistics, before, action)
        return jax.lax.stop_gradient(change / self._scale(statistics))

    def change_loss(
        self, statistics: Statistics, before: Latent, after: Latent, action: Float[Array, "6"], dt: float
    ) -> Float[Array, ""]:
        """Return the negative log density of a measured change, normal about the trained layer's, but for a constant.

        Zero without such a layer.
        """
        if self.quadratic is None:
            return jnp.zeros((), action.dtype)
        before, after = jax.lax.stop_gradient((before, after))
        left = self.read(after.tokens - before.tokens - self._change(statistics, before, action))
        square = jnp.asarray(_MEMBERS, left.dtype) @ left**2 / statistics.change_scale**2
        return jnp.mean(0.5 * square * jnp.exp(-2.0 * SPREAD_RATE * self.spread) + SPREAD_RATE * self.spread)

    def advance(
        self,
        statistics: Statistics,
        carry: Latent,
        residual: Float[Array, "4 d"],
        action: Float[Array, "6"],
        dt: float,
        *,
        sampled: bool,
    ) -> Latent:
        """Add the layer's change and the predicted residual to the tokens."""
        layer = jax.lax.stop_gradient(self)
        change = layer._change(statistics, carry, action) + self._scale(statistics) * residual
        return carry._replace(tokens=carry.tokens + change)

    def decoded(self, statistics: Statistics, carry: Latent) -> Float[Array, "18"]:
        """Return the features that the tokens stand for, SI; their rotation matrix is one only nearly."""
        learned = self._scale(statistics)[_OWNER, 0] * self.decoder(carry.tokens.reshape(-1))
        return (self.read(carry.tokens) + learned) * statistics.feature_scale[_OWNER]

    def decode(self, statistics: Statistics, carry: Latent) -> dict[str, Array]:
        """Return the view, its quaternion that of the nearest rotation, on the anchor's side of the sphere."""
        return {"state": to_view(self.decoded(statistics, carry), carry.anchor)}

    def decode_loss(self, statistics: Statistics, carry: Latent, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare decoded features with those of the measurement."""
        error = self.decoded(statistics, carry) - features(view, carry.anchor)
        # Half the squared difference of two rotation matrices is the squared angle, as motions are compared.
        weight = jnp.asarray(_MEMBERS * np.asarray([1.0, 1.0, 0.5, 1.0])[:, None], error.dtype)
        return decode_penalty(weight @ error**2)

    def round_trip_loss(self, statistics: Statistics, carry: Latent, view: Float[Array, "13"]) -> Float[Array, ""]:
        """Compare an encoded measurement, decoded again, with itself."""
        return self.decode_loss(statistics, carry, view)
