"""The flow-matching head: what a token will change by, given the backbone's output for it."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from owm.model.config import ModelConfig
from owm.model.transformer import Linear, Norm, Perceptron


class FlowHead(eqx.Module):
    """Predicts the clean, unit-variance residual from a noised one (`x0`-parameterisation), token by token.

    On the straight path `x_tau = (1 - tau) x + tau eps` the head is trained with an unweighted square loss on `x`; the
    flow's velocity follows as `(x_tau - x) / tau`. At 4 Hz the residual is small against its noise, and predicting the
    velocity instead would leak that noise into a rollout.

    **What one step from pure noise gives**: at `tau = 1` the input says nothing about `x`, so the trained head returns
    the conditional mean, whatever `eps` is. Samples drawn with a key differ only by what the head has failed to
    unlearn; their spread is not calibrated and shrinks with training.

    Source: rectified flow, Liu et al. (2023); the residual formulation of the paper, its eq. for the flow loss.
    """

    join: Linear
    norms: tuple[Norm, ...]
    layers: tuple[Perceptron, ...]
    out: Linear

    def __init__(self, config: ModelConfig, residual: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_join, k_out, *k_layers = jax.random.split(key, 2 + config.head_blocks)
        width = config.head_width
        self.join = Linear(config.width + residual + 2, width, dtype, key=k_join)
        self.norms = tuple(Norm(width, dtype) for _ in k_layers)
        self.layers = tuple(Perceptron(width, 2 * width, width, dtype, key=k) for k in k_layers)
        # Zero at first: an untrained model predicts what its analytic and linear parts predict.
        self.out = Linear(width, residual, dtype, key=k_out, scale=0.0)

    def __call__(
        self, noised: Float[Array, "n r"], tau: Float[Array, ""], context: Float[Array, "n d"]
    ) -> Float[Array, "n r"]:
        """Return the expected clean residual given the noised one at noise level `tau` and the backbone's output."""
        level = jnp.broadcast_to(jnp.stack([tau, tau * tau]), (*noised.shape[:-1], 2)).astype(noised.dtype)
        x = self.join(jnp.concatenate([context, noised, level], axis=-1))
        for norm, layer in zip(self.norms, self.layers, strict=True):
            x = x + layer(norm(x))
        return self.out(jax.nn.silu(x))

    def sample(self, key: Key[Array, ""] | None, context: Float[Array, "n d"], residual: int) -> Float[Array, "n r"]:
        """Draw a residual in one step from noise; `key=None` starts from zero noise and is deterministic."""
        shape = (*context.shape[:-1], residual)
        noise = jnp.zeros(shape, context.dtype) if key is None else jax.random.normal(key, shape, context.dtype)
        return self(noise, jnp.ones((), context.dtype), context)
