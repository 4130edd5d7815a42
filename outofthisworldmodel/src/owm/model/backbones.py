"""What the transformer is compared with: a recurrent and a feed-forward network on the same tokens, of the same size.

Each has the two functions of `owm.model.transformer.Backbone`, so that stream, head, loss and training are the same.
Their hidden layers are as wide as brings their parameters to the number of the transformer's.
"""

from collections.abc import Callable
from typing import Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key, PyTree

from owm.model.config import ModelConfig
from owm.model.transformer import MLP, Backbone, Linear, Norm


class SequenceModel(Protocol):
    """A causal network over the tokens of each step, the last of which is the action's: nothing is read from it."""

    def sequence(self, x: Float[Array, "T n d"], valid: Bool[Array, "T"]) -> tuple[Float[Array, "T n-1 d"], PyTree]:
        """Run a whole sequence; also return the cache for later steps. None sees earlier steps that are not valid."""

    def step(self, x: Float[Array, "n d"], cache: PyTree) -> tuple[Float[Array, "n-1 d"], PyTree]:
        """Run one further step."""


class GatedRecurrent(eqx.Module):
    """One gated recurrent unit; its cache is its hidden state. Source: Cho et al. (2014), eq. 5-8."""

    gates: Linear
    candidate: Linear
    out: Linear
    norm: Norm

    def __init__(self, config: ModelConfig, tokens: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        inputs, outputs = tokens * config.width, (tokens - 1) * config.width
        # 3 h^2 + (3 inputs + 3 + outputs) h + outputs parameters
        hidden = _root(3, 3 * inputs + 3 + outputs, outputs + config.width - _transformer_size(config))
        k_gates, k_candidate, k_out = jax.random.split(key, 3)
        self.gates = Linear(inputs + hidden, 2 * hidden, dtype, key=k_gates)
        self.candidate = Linear(inputs + hidden, hidden, dtype, key=k_candidate)
        self.out = Linear(hidden, outputs, dtype, key=k_out)
        self.norm = Norm(config.width, dtype)

    def sequence(
        self, x: Float[Array, "T n d"], valid: Bool[Array, "T"]
    ) -> tuple[Float[Array, "T n-1 d"], Float[Array, "h"]]:
        """Run a whole sequence from a hidden state of zero, which stays so until the first valid step."""

        def advance(hidden: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
            output, after = self.step(step[0], hidden)
            return jnp.where(step[1], after, hidden), output

        hidden, outputs = jax.lax.scan(advance, jnp.zeros(self.candidate.bias.shape, x.dtype), (x, valid))
        return outputs, hidden

    def step(self, x: Float[Array, "n d"], cache: Float[Array, "h"]) -> tuple[Float[Array, "n-1 d"], Float[Array, "h"]]:
        """Run one further step."""
        inputs = x.reshape(-1)  # (n, d) -> (n d)
        reset, keep = jnp.split(jax.nn.sigmoid(self.gates(jnp.concatenate([inputs, cache]))), 2)
        fresh = jnp.tanh(self.candidate(jnp.concatenate([inputs, reset * cache])))
        hidden = keep * cache + (1.0 - keep) * fresh
        return self.norm(x[:-1] + self.out(hidden).reshape(x[:-1].shape)), hidden


class FeedForward(eqx.Module):
    """A residual MLP on the tokens of the last `window` steps side by side, which are its cache."""

    up: Linear
    norms: tuple[Norm, ...]
    layers: tuple[MLP, ...]
    out: Linear
    norm: Norm
    window: int = eqx.field(static=True)

    def __init__(self, config: ModelConfig, tokens: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        inputs, outputs = config.window * tokens * config.width, (tokens - 1) * config.width
        # 6 blocks h^2 + (inputs + 1 + 6 blocks + outputs) h + outputs parameters
        count = 6 * config.blocks
        hidden = _root(count, inputs + 1 + count + outputs, outputs + config.width - _transformer_size(config))
        k_up, k_out, *k_layers = jax.random.split(key, 2 + config.blocks)
        self.up = Linear(inputs, hidden, dtype, key=k_up)
        self.norms = tuple(Norm(hidden, dtype) for _ in k_layers)
        self.layers = tuple(MLP(hidden, 2 * hidden, hidden, dtype, key=k) for k in k_layers)
        self.out = Linear(hidden, outputs, dtype, key=k_out)
        self.norm = Norm(config.width, dtype)
        self.window = config.window

    def sequence(
        self, x: Float[Array, "T n d"], valid: Bool[Array, "T"]
    ) -> tuple[Float[Array, "T n-1 d"], Float[Array, "W-1 n d"]]:
        """Run a whole sequence; steps that are not valid, or before it, are zeros to later ones."""
        past = jnp.concatenate([jnp.zeros((self.window - 1, *x.shape[1:]), x.dtype), x * valid[:, None, None]])
        recent = past[np.arange(len(x))[:, None] + np.arange(self.window - 1)]  # (T, W-1, n, d)
        outputs = jax.vmap(lambda x, cache: self.step(x, cache)[0])(x, recent)
        return outputs, past[len(x) :]

    def step(
        self, x: Float[Array, "n d"], cache: Float[Array, "W-1 n d"]
    ) -> tuple[Float[Array, "n-1 d"], Float[Array, "W-1 n d"]]:
        """Run one further step."""
        recent = jnp.concatenate([cache, x[None]])
        hidden = self.up(recent.reshape(-1))  # (W, n, d) -> (W n d)
        for norm, layer in zip(self.norms, self.layers, strict=True):
            hidden = hidden + layer(norm(hidden))
        return self.norm(x[:-1] + self.out(jax.nn.silu(hidden)).reshape(x[:-1].shape)), recent[1:]


def _transformer_size(config: ModelConfig) -> int:
    def size(blocks: int) -> int:
        few = config.model_copy(update={"blocks": blocks})
        made = eqx.filter_eval_shape(lambda: Backbone(few, jnp.float32, key=jax.random.key(0)))
        return sum(leaf.size for leaf in jax.tree.leaves(made))

    one, two = size(1), size(2)
    return one + (config.blocks - 1) * (two - one)


def _root(a: float, b: float, c: float) -> int:
    """The positive root of a x^2 + b x + c, to the nearest whole number from one."""
    return max(round((-b + (b * b - 4 * a * c) ** 0.5) / (2 * a)), 1)


BACKBONES: dict[str, Callable[..., SequenceModel]] = {
    "transformer": lambda config, tokens, dtype, *, key: Backbone(config, dtype, key=key),
    "gru": GatedRecurrent,
    "mlp": FeedForward,
}
"""Backbones by the name that `ModelConfig.backbone` gives."""
