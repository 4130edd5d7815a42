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
from jaxtyping import Array, Bool, Float, Key

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


class Perceptron(eqx.Module):
    """Two affine maps with a gated hidden layer between, whose products of inputs come cheap.

    Source: Shazeer (2020), GLU variants improve transformer, eq. 6 (SwiGLU).
    """

    rise: Linear
    fall: Linear

    def __init__(
        self, inputs: int, hidden: int, outputs: int, dtype: jnp.dtype, *, key: Key[Array, ""], scale: float = 1.0
    ):
        k_rise, k_fall = jax.random.split(key)
        self.rise = Linear(inputs, 2 * hidden, dtype, key=k_rise)
        self.fall = Linear(hidden, outputs, dtype, key=k_fall, scale=scale)

    def __call__(self, x: Float[Array, "*n i"]) -> Float[Array, "*n o"]:
        gate, value = jnp.split(self.rise(x), 2, axis=-1)
        return self.fall(jax.nn.silu(gate) * value)


def rotate_by_age(x: Float[Array, "T n h e"], newest: int) -> Float[Array, "T n h e"]:
    """Apply rotary position embedding along the first axis, whose entry `newest` gets angle zero.

    Only differences of position reach an attention score, so a slot's age serves as its position and no step counter
    is needed. Source: Su et al. (2021), RoFormer, eq. 15 (base 10 000).
    """
    half = x.shape[-1] // 2
    # NumPy: a table of the shapes alone, so it is a constant of the compiled program.
    angle = (np.arange(x.shape[0]) - newest)[:, None] * 10_000.0 ** (-np.arange(half) / half)
    cos, sin = (jnp.asarray(f(angle)[:, None, None], x.dtype) for f in (np.cos, np.sin))
    a, b = x[..., :half], x[..., half:]
    return jnp.concatenate([a * cos - b * sin, a * sin + b * cos], axis=-1)


class Attention(eqx.Module):
    """Multi-head attention; the caller supplies who may see whom."""

    qkv: Linear
    out: Linear
    heads: int = eqx.field(static=True)

    def __init__(self, width: int, heads: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_qkv, k_out = jax.random.split(key)
        self.qkv = Linear(width, 3 * width, dtype, key=k_qkv)
        self.out = Linear(width, width, dtype, key=k_out)
        self.heads = heads

    def project(self, x: Float[Array, "*n d"]) -> tuple[Float[Array, "*n h e"], ...]:
        """Return queries, keys and values split into heads."""
        qkv = self.qkv(x).reshape(*x.shape[:-1], 3, self.heads, -1)  # (*n, 3 d) -> (*n, 3, h, e)
        return qkv[..., 0, :, :], qkv[..., 1, :, :], qkv[..., 2, :, :]

    def merge(self, x: Float[Array, "*n h e"]) -> Float[Array, "*n d"]:
        """Join the heads."""
        return self.out(x.reshape(*x.shape[:-2], -1))  # (*n, h, e) -> (*n, d)


def _wide(x: Array) -> Array:
    """Return the array in float32 at least."""
    return x.astype(jnp.promote_types(x.dtype, jnp.float32))


def _softmax(score: Array, visible: Array | bool, axis: int) -> Array:
    wide = _wide(score)
    return jax.nn.softmax(jnp.where(visible, wide, jnp.finfo(wide.dtype).min), axis=axis).astype(score.dtype)


class Memory(NamedTuple):
    """Keys and values of the last `W` steps, oldest first, one pair a block; preallocated, shifted by every step."""

    keys: Float[Array, "blocks W n h e"]
    values: Float[Array, "blocks W n h e"]
    valid: Bool[Array, "W"]


class Block(eqx.Module):
    """Spatial attention, temporal attention, perceptron, each on a normalised residual branch."""

    norm_space: Norm
    norm_time: Norm
    norm_mlp: Norm
    space: Attention
    time: Attention
    mlp: Perceptron

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_space, k_time, k_mlp = jax.random.split(key, 3)
        self.norm_space, self.norm_time, self.norm_mlp = (Norm(config.width, dtype) for _ in range(3))
        self.space = Attention(config.width, config.heads, dtype, key=k_space)
        self.time = Attention(config.width, config.heads, dtype, key=k_time)
        self.mlp = Perceptron(config.width, config.mlp_ratio * config.width, config.width, dtype, key=k_mlp)

    def mix_tokens(self, x: Float[Array, "*t n d"]) -> Float[Array, "*t n d"]:
        """Let the tokens of each step see each other, in both directions."""
        q, k, v = self.space.project(self.norm_space(x))
        # Written as broadcast products: the token axis is so short that batched matrix products would only cost.
        score = jnp.sum(q[..., :, None, :, :] * k[..., None, :, :, :], axis=-1) * q.shape[-1] ** -0.5
        weight = _softmax(score, True, -2)[..., None]  # (*t, n, m, h, 1)
        return x + self.space.merge(jnp.sum(weight * v[..., None, :, :, :], axis=-3))

    def sequence(
        self, x: Float[Array, "T n d"], visible: Bool[Array, "T T"]
    ) -> tuple[Float[Array, "T n d"], tuple[Array, Array]]:
        """Run all steps; also return the keys (unrotated) and values for later steps."""
        x = self.mix_tokens(x)
        q, k, v = self.time.project(self.norm_time(x))
        score = jnp.einsum("tnhe,snhe->nhts", rotate_by_age(q, 0), rotate_by_age(k, 0)) * q.shape[-1] ** -0.5
        x = x + self.time.merge(jnp.einsum("nhts,snhe->tnhe", _softmax(score, visible, -1), v))
        return x + self.mlp(self.norm_mlp(x)), (k, v)

    def step(
        self, x: Float[Array, "n d"], keys: Float[Array, "W n h e"], values: Float[Array, "W n h e"], valid: Array
    ) -> tuple[Float[Array, "n d"], Array, Array]:
        """Run one step whose own key and value join the memory; `valid` already describes the shifted memory."""
        x = self.mix_tokens(x)
        q, k, v = self.time.project(self.norm_time(x))
        keys = jnp.concatenate([keys[1:], k[None]])
        values = jnp.concatenate([values[1:], v[None]])
        aged = rotate_by_age(keys, keys.shape[0] - 1)
        score = jnp.sum(q * aged, axis=-1) * q.shape[-1] ** -0.5  # (W, n, h)
        weight = _softmax(score, valid[:, None, None], 0)[..., None]
        x = x + self.time.merge(jnp.sum(weight * values, axis=0))
        return x + self.mlp(self.norm_mlp(x)), keys, values


class Backbone(eqx.Module):
    """A stack of space-time blocks."""

    blocks: tuple[Block, ...]
    norm: Norm
    window: int = eqx.field(static=True)

    def __init__(self, config: ModelConfig, dtype: jnp.dtype, *, key: Key[Array, ""]):
        self.blocks = tuple(Block(config, dtype, key=k) for k in jax.random.split(key, config.blocks))
        self.norm = Norm(config.width, dtype)
        self.window = config.window

    def sequence(self, x: Float[Array, "T n d"], valid: Bool[Array, "T"]) -> tuple[Float[Array, "T n d"], Memory]:
        """Run a whole sequence, causally; steps that are not `valid` are seen by nobody but themselves."""
        steps, tokens, _ = x.shape
        age = np.arange(steps)[:, None] - np.arange(steps)[None, :]
        visible = jnp.asarray(age == 0) | (jnp.asarray((age > 0) & (age < self.window)) & valid[None, :])
        pairs = []
        for block in self.blocks:
            x, pair = block.sequence(x, visible)
            pairs.append(pair)
        kept = min(steps, self.window)
        pad = ((0, 0), (self.window - kept, 0), (0, 0), (0, 0), (0, 0))
        shape = (len(pairs), steps, tokens, self.blocks[0].time.heads, -1)
        keys = jnp.stack([k for k, _ in pairs]).reshape(shape)[:, steps - kept :]
        values = jnp.stack([v for _, v in pairs]).reshape(shape)[:, steps - kept :]
        memory = Memory(
            jnp.pad(keys, pad), jnp.pad(values, pad), jnp.pad(valid[steps - kept :], (self.window - kept, 0))
        )
        return self.norm(x), memory

    def step(self, x: Float[Array, "n d"], memory: Memory) -> tuple[Float[Array, "n d"], Memory]:
        """Run one further step."""
        valid = jnp.concatenate([memory.valid[1:], jnp.ones_like(memory.valid[:1])])
        keys, values = [], []
        for i, block in enumerate(self.blocks):
            x, k, v = block.step(x, memory.keys[i], memory.values[i], valid)
            keys.append(k)
            values.append(v)
        return self.norm(x), Memory(jnp.stack(keys), jnp.stack(values), valid)
