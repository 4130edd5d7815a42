"""A factorised space-time transformer over a few tokens a step.

Every block lets the tokens of one step attend to each other, then each token to its own past within a sliding window.
`Backbone.sequence` runs a whole sequence at once; `Backbone.step` runs one further step from the keys and values kept,
at a cost that does not grow with what went before. Both give the same numbers.

Products are computed in the dtype of the weights, which training may lower to bfloat16; means of squares and softmax
keep float32.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from astrojax.compilation import stored, summed
from owm.model.config import ModelConfig


class Norm(eqx.Module):
    """Root-mean-square normalisation over the last axis with a learned gain."""

    gain: Float[Array, "d"]

    def __init__(self, width: int, dtype: jnp.dtype):
        self.gain = jnp.ones(width, dtype)

    def __call__(self, x: Float[Array, "*n d"]) -> Float[Array, "*n d"]:
        x = _wide(x)
        return (x * jax.lax.rsqrt(jnp.mean(x * x, axis=-1, keepdims=True) + 1e-6)).astype(self.gain.dtype) * self.gain


class Linear(eqx.Module):
    """An affine map of the last axis, initialised with variance `scale**2 / inputs` and zero bias."""

    weight: Float[Array, "i o"]
    bias: Float[Array, "o"]

    def __init__(self, inputs: int, outputs: int, dtype: jnp.dtype, *, key: Key[Array, ""], scale: float = 1.0):
        self.weight = jax.random.normal(key, (inputs, outputs), dtype) * (scale / inputs**0.5)
        self.bias = jnp.zeros(outputs, dtype)

    def __call__(self, x: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
        return x.astype(self.weight.dtype) @ self.weight + self.bias


class MLP(eqx.Module):
    """Two affine maps with a gated hidden layer between, whose products of inputs come cheap.

    Source: Shazeer (2020), GLU variants improve transformer, eq. 6 (SwiGLU).
    """

    up: Linear
    down: Linear

    def __init__(
        self, inputs: int, hidden: int, outputs: int, dtype: jnp.dtype, *, key: Key[Array, ""], scale: float = 1.0
    ):
        k_up, k_down = jax.random.split(key)
        self.up = Linear(inputs, 2 * hidden, dtype, key=k_up)
        self.down = Linear(hidden, outputs, dtype, key=k_down, scale=scale)

    def __call__(self, x: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
        gate, value = jnp.split(self.up(x), 2, axis=-1)
        return self.down(jax.nn.silu(gate) * value)


def rotate(x: Float[Array, "... e"], angle: Float[Array, "... e/2"]) -> Float[Array, "... e"]:
    """Turn each pair (i, i + e/2) of the last axis by its angle."""
    half = x.shape[-1] // 2
    cos, sin = stored((jnp.cos(angle).astype(x.dtype), jnp.sin(angle).astype(x.dtype)))
    a, b = x[..., :half], x[..., half:]
    return jnp.concatenate([a * cos - b * sin, a * sin + b * cos], axis=-1)


def rotary_angles(step: Int[Array, "*t"], size: int) -> Float[Array, "*t size/2"]:
    """Return the angles of rotary position embedding: only differences between steps reach an attention score.

    Source: Su et al. (2021), RoFormer, eq. 15 (base 10 000).
    """
    half = size // 2
    frequency = np.float32(10_000.0 ** (-np.arange(half) / half))
    return jnp.asarray(step, jnp.float32)[..., None] * frequency


class SelfAttention(eqx.Module):
    """Multi-head attention of the tokens of a step to each other, in both directions."""

    qkv: Linear
    out: Linear
    heads: int = eqx.field(static=True)

    def __init__(self, width: int, heads: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        self.qkv, self.out = _projections(width, dtype, key)
        self.heads = heads

    def __call__(self, x: Float[Array, "*t n d"], kept: int | None = None) -> Float[Array, "*t kept d"]:
        """Let the first `kept` tokens of a step (all if None) see all of them."""
        q, k, v = _split_heads(self.qkv(x), self.heads)
        q = q[..., :kept, :, :]
        # Written as broadcast products: the token axis is so short that batched matrix products would only cost.
        score = jnp.sum(q[..., :, None, :, :] * k[..., None, :, :, :], axis=-1) * q.shape[-1] ** -0.5
        weight = _softmax(score, True, -2)[..., None]  # (*t, kept, n, h, 1)
        return self.out(_merge_heads(jnp.sum(weight * v[..., None, :, :, :], axis=-3)))


class CausalSelfAttention(eqx.Module):
    """Multi-head attention of each token to itself and its own past, with rotary positions."""

    qkv: Linear
    out: Linear
    heads: int = eqx.field(static=True)

    def __init__(self, width: int, heads: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        self.qkv, self.out = _projections(width, dtype, key)
        self.heads = heads

    def sequence(
        self, x: Float[Array, "T n d"], visible: Bool[Array, "T T"]
    ) -> tuple[Float[Array, "T n d"], tuple[Array, Array]]:
        """Run all steps; also return the rotated keys and the values (T, n, h, e) for later steps."""
        q, k, v = _split_heads(self.qkv(x), self.heads)
        angle = rotary_angles(np.arange(len(x)), q.shape[-1])[:, None, None]
        q, k = rotate(q, angle), rotate(k, angle)
        score = jnp.einsum("tnhe,snhe->nhts", q, k) * q.shape[-1] ** -0.5
        seen = jnp.einsum("nhts,snhe->tnhe", _softmax(score, visible, -1), v)
        return self.out(_merge_heads(seen)), (k, v)

    def step(
        self,
        x: Float[Array, "n d"],
        keys: Float[Array, "e W n h"],
        values: Float[Array, "W e n h"],
        valid: Bool[Array, "W"],
        count: Int[Array, ""],
    ) -> tuple[Float[Array, "n d"], Array, Array]:
        """Run one step whose own key and value join those kept; `valid` already includes it."""
        window = values.shape[0]
        q, k, v = _split_heads(self.qkv(x), self.heads)
        angle = rotary_angles(count, q.shape[-1])
        q, k, v = (jnp.moveaxis(part, -1, 0) for part in (rotate(q, angle), rotate(k, angle), v))  # (e, n, h)
        keys = keys.at[:, count % window].set(k)
        values = values.at[count % window].set(v)
        score = summed(q[:, None] * keys) * q.shape[0] ** -0.5  # (W, n, h)
        weight = _softmax(score, valid[:, None, None], 0)
        seen = summed(weight[:, None] * values)  # (e, n, h)
        return self.out(_merge_heads(jnp.moveaxis(seen, 0, -1))), keys, values


def _projections(width: int, dtype: jnp.dtype, key: Key[Array, ""]) -> tuple[Linear, Linear]:
    """The maps to queries, keys and values, and back from the joined heads."""
    k_qkv, k_out = jax.random.split(key)
    return Linear(width, 3 * width, dtype, key=k_qkv), Linear(width, width, dtype, key=k_out)


def _split_heads(qkv: Float[Array, "*n 3*d"], heads: int) -> tuple[Float[Array, "*n h e"], ...]:
    """Queries, keys and values split into heads."""
    qkv = qkv.reshape(*qkv.shape[:-1], 3, heads, -1)  # (*n, 3 d) -> (*n, 3, h, e)
    return qkv[..., 0, :, :], qkv[..., 1, :, :], qkv[..., 2, :, :]


def _merge_heads(x: Float[Array, "*n h e"]) -> Float[Array, "*n d"]:
    return x.reshape(*x.shape[:-2], -1)  # (*n, h, e) -> (*n, d)


def _wide(x: Array) -> Array:
    """Return the array in float32 at least."""
    return x.astype(jnp.promote_types(x.dtype, jnp.float32))


def _softmax(score: Array, visible: Array | bool, axis: int) -> Array:
    wide = _wide(score)
    return jax.nn.softmax(jnp.where(visible, wide, jnp.finfo(wide.dtype).min), axis=axis).astype(score.dtype)


class KVCache(NamedTuple):
    """Keys and values of the last `W` steps, one array a block; a step is kept in slot `step % W`.

    Laid out for one step's attention as sums of long elementwise products: on the CPU that takes a tenth of the time of
    many small matrix products, and no step moves what earlier ones left.

    Attributes:
        keys: rotated by the step they belong to.
        valid: which slots may be seen.
        count: steps so far.
    """

    keys: tuple[Float[Array, "e W n h"], ...]
    values: tuple[Float[Array, "W e n h"], ...]
    valid: Bool[Array, "W"]
    count: Int[Array, ""]


class Block(eqx.Module):
    """Spatial attention, temporal attention, MLP, each on a normalised residual branch."""

    norm_space: Norm
    norm_time: Norm
    norm_mlp: Norm
    space: SelfAttention
    time: CausalSelfAttention
    mlp: MLP

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_space, k_time, k_mlp = jax.random.split(key, 3)
        self.norm_space, self.norm_time, self.norm_mlp = (Norm(config.width, dtype) for _ in range(3))
        self.space = SelfAttention(config.width, config.heads, dtype, key=k_space)
        self.time = CausalSelfAttention(config.width, config.heads, dtype, key=k_time)
        self.mlp = MLP(config.width, config.mlp_ratio * config.width, config.width, dtype, key=k_mlp)

    def mix_tokens(self, x: Float[Array, "*t n d"], kept: int) -> Float[Array, "*t kept d"]:
        """Let the first `kept` tokens of each step see all of them; the others end here."""
        return x[..., :kept, :] + self.space(self.norm_space(x), kept)

    def sequence(
        self, x: Float[Array, "T n d"], visible: Bool[Array, "T T"], kept: int
    ) -> tuple[Float[Array, "T kept d"], tuple[Array, Array]]:
        """Run all steps; also return the rotated keys and the values (T, kept, h, e) for later steps."""
        x = self.mix_tokens(x, kept)
        seen, kv = self.time.sequence(self.norm_time(x), visible)
        x = x + seen
        return x + self.mlp(self.norm_mlp(x)), kv

    def step(
        self,
        x: Float[Array, "n d"],
        keys: Float[Array, "e W kept h"],
        values: Float[Array, "W e kept h"],
        valid: Bool[Array, "W"],
        count: Int[Array, ""],
    ) -> tuple[Float[Array, "kept d"], Array, Array]:
        """Run one step whose own key and value join the cache; `valid` already includes it."""
        x = self.mix_tokens(x, keys.shape[2])
        seen, keys, values = self.time.step(self.norm_time(x), keys, values, valid, count)
        x = x + seen
        return x + self.mlp(self.norm_mlp(x)), keys, values


class Backbone(eqx.Module):
    """A stack of space-time blocks.

    The last token of a step is the action: it tells the others what is done and nothing is read from it, so it ends in
    the last block once they have seen it.
    """

    blocks: tuple[Block, ...]
    norm: Norm
    window: int = eqx.field(static=True)

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        self.blocks = tuple(Block(config, dtype, key=k) for k in jax.random.split(key, config.blocks))
        self.norm = Norm(config.width, dtype)
        self.window = config.window

    def _kept(self, tokens: int) -> list[int]:
        """How many of a step's tokens leave each block."""
        return [tokens] * (len(self.blocks) - 1) + [tokens - 1]

    def sequence(self, x: Float[Array, "T n d"], valid: Bool[Array, "T"]) -> tuple[Float[Array, "T n-1 d"], KVCache]:
        """Run a whole sequence, causally; steps that are not `valid` are seen by nobody but themselves."""
        steps, tokens, _ = x.shape
        age = np.arange(steps)[:, None] - np.arange(steps)[None, :]
        visible = jnp.asarray(age == 0) | (jnp.asarray((age > 0) & (age < self.window)) & valid[None, :])
        recent = np.arange(max(steps - self.window, 0), steps)

        def slots(part: Array) -> Array:
            return jnp.zeros((self.window, *part.shape[1:]), part.dtype).at[recent % self.window].set(part[recent])

        keys, values = [], []
        for block, kept in zip(self.blocks, self._kept(tokens), strict=True):
            x, (k, v) = block.sequence(x, visible, kept)
            keys.append(jnp.transpose(slots(k), (3, 0, 1, 2)))
            values.append(jnp.transpose(slots(v), (0, 3, 1, 2)))
        return self.norm(x), KVCache(tuple(keys), tuple(values), slots(valid), jnp.asarray(steps, jnp.int32))

    def step(self, x: Float[Array, "n d"], cache: KVCache) -> tuple[Float[Array, "n-1 d"], KVCache]:
        """Run one further step."""
        valid = cache.valid.at[cache.count % self.window].set(True)
        keys, values = [], []
        for block, old_keys, old_values in zip(self.blocks, cache.keys, cache.values, strict=True):
            x, k, v = block.step(x, old_keys, old_values, valid, cache.count)
            keys.append(k)
            values.append(v)
        return self.norm(x), KVCache(tuple(keys), tuple(values), valid, cache.count + 1)
