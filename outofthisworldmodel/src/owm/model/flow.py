"""The flow head: what a token will change by, as a distribution, given the backbone's output for it."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from owm.model.config import ModelConfig
from owm.model.transformer import MLP, Linear, Norm, SelfAttention

SAME_LEVEL = 0.6
"""Share of mean-flow draws with both levels equal, which train the instantaneous flow that the others rest on."""


class FlowHead(eqx.Module):
    """Carries a noised, unit-variance residual along a flow towards the clean one, token by token.

    On the straight path `x_tau = (1 - tau) x + tau eps` let `u` be the average velocity with which the flow leads from
    level `tau` to an earlier level `until`. The head predicts `X = x_tau - tau u`, which is

    - for `until = tau` the expected clean residual given `x_tau`: at `tau = 1`, where `x_tau` is pure noise, the
      conditional mean, which is the deterministic prediction;
    - for `until = 0` the end of the flow: at `tau = 1` a sample of the residual, in one evaluation.

    The plain rectified flow ("flow", or "velocity" as published) learns the first only. One step from noise then
    returns the conditional mean whatever `eps` is, and what spread remains is what the head has failed to unlearn.
    The mean flow learns both from the identity between average and instantaneous velocity.

    Predicting `X` rather than a velocity keeps the noise out of a rollout, since residuals are small at 4 Hz. The
    output is an offset and a gain on `x_tau`, so that noise whose size depends on the context costs little width.

    Source: Liu et al. (2023), rectified flow; Geng et al. (2025), Mean flows for one-step generative modeling, eq. 6.
    """

    join: Linear
    mixing: tuple[tuple[Norm, SelfAttention] | None, ...]
    norms: tuple[Norm, ...]
    layers: tuple[MLP, ...]
    out: Linear
    residual: int = eqx.field(static=True)
    plain: bool = eqx.field(static=True)
    velocity: bool = eqx.field(static=True)

    def __init__(self, config: ModelConfig, residual: int, dtype: jnp.dtype, *, key: Key[Array, ""]):
        k_join, k_out, *k_layers = jax.random.split(key, 2 + config.head_blocks)
        width, heads = config.head_width, config.head_heads
        self.join = Linear(config.width + residual + 4, width, dtype, key=k_join)

        def mixing(key: Key[Array, ""]) -> tuple[Norm, SelfAttention] | None:
            return (Norm(width, dtype), SelfAttention(width, heads, dtype, key=key)) if heads else None

        # Where a token's residual depends on those of the others: all of a step are denoised together.
        self.mixing = tuple(mixing(jax.random.fold_in(k, 1)) for k in k_layers)
        self.norms = tuple(Norm(width, dtype) for _ in k_layers)
        self.layers = tuple(MLP(width, 2 * width, width, dtype, key=k) for k in k_layers)
        # Zero at first: an untrained model predicts what its analytic and linear parts predict.
        self.out = Linear(width, 2 * residual, dtype, key=k_out, scale=0.0)
        self.residual = residual
        self.plain = config.head != "mean-flow"
        self.velocity = config.head == "velocity"

    def __call__(
        self, noised: Float[Array, "n r"], tau: Float[Array, ""], until: Float[Array, ""], context: Float[Array, "n d"]
    ) -> Float[Array, "n r"]:
        """Return `X` of a residual noised to level `tau`, given the backbone's output."""
        levels = jnp.stack([tau, tau * tau, until, until * until]).astype(noised.dtype)
        levels = jnp.broadcast_to(levels, (*noised.shape[:-1], 4))
        x = self.join(jnp.concatenate([context, noised, levels], axis=-1))
        for mixing, norm, layer in zip(self.mixing, self.norms, self.layers, strict=True):
            if mixing is not None:
                before, attention = mixing
                x = x + attention(before(x))
            x = x + layer(norm(x))
        offset, gain = jnp.split(self.out(jax.nn.silu(x)), 2, axis=-1)
        out = offset + gain * noised
        return noised - tau * out if self.velocity else out

    def mean(self, context: Float[Array, "n d"]) -> Float[Array, "n r"]:
        """Return the expected residual."""
        one = jnp.ones((), context.dtype)
        return self(jnp.zeros((*context.shape[:-1], self.residual), context.dtype), one, one, context)

    def sample(self, key: Key[Array, ""], context: Float[Array, "n d"], steps: int = 1) -> Float[Array, "n r"]:
        """Draw a residual in `steps` evaluations, evenly spaced from noise to residual."""
        x = jax.random.normal(key, (*context.shape[:-1], self.residual), context.dtype)
        for i in range(steps):
            tau, until = (jnp.asarray(1.0 - j / steps, context.dtype) for j in (i, i + 1))
            clean = self(x, tau, tau if self.plain else until, context)
            x = x + (tau - until) / tau * (clean - x)
        return x

    def loss(
        self,
        residual: Float[Array, "n r"],
        context: Float[Array, "n d"],
        level: Float[Array, "3"],
        noise: Float[Array, "n r"],
    ) -> Float[Array, ""]:
        """Return the square error of `X` against its target on one measured residual.

        With `v = eps - x` the identity `u = v - (tau - until) du/dtau` along the path reads, in terms of `X`,
        `X = until / tau x + (1 - until / tau) X - (tau - until) dX/dtau`; the right-hand side is the target and
        held fixed. For `until = tau` it is `x`: the plain flow's loss.

        Args:
            residual: of unit variance.
            context: the backbone's output.
            level: uniform on [0, 1): two levels, and what decides whether they are to be equal.
            noise: standard normal.
        """
        tau = level[0] if self.plain else jnp.maximum(level[0], level[1])
        noised = (1.0 - tau) * residual + tau * noise
        if self.plain:
            error = self(noised, tau, tau, context) - residual
            # The error of the velocity, (X - x) / tau: the publication's loss.
            return jnp.mean((error / jnp.maximum(tau, 1e-3) if self.velocity else error) ** 2)
        until = jnp.where(level[2] < SAME_LEVEL, tau, jnp.minimum(level[0], level[1]))
        clean, change = jax.jvp(
            lambda x, tau: self(x, tau, until, context), (noised, tau), (noise - residual, jnp.ones_like(tau))
        )
        part = until / jnp.maximum(tau, 1e-6)
        target = part * residual + (1.0 - part) * clean - (tau - until) * change
        return jnp.mean((clean - jax.lax.stop_gradient(target)) ** 2)
