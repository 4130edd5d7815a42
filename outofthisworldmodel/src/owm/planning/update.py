"""The update of a plan: candidates averaged by what they cost, and the next warm start."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def candidate_weights(costs: Float[Array, "K"], temperature: Float[Array, ""]) -> Float[Array, "K"]:
    """Softmax weights of candidates; one whose cost is not finite can never be chosen."""
    costs = jnp.where(jnp.isfinite(costs), costs, jnp.finfo(costs.dtype).max)
    return jax.nn.softmax((jnp.min(costs) - costs) / temperature)


def average(weights: Float[Array, "K"], candidates: Float[Array, "K T 6"]) -> Float[Array, "T 6"]:
    """The weighted mean of candidates."""
    return jnp.einsum("k,kti->ti", weights, candidates)


def shifted(plan: Float[Array, "T 6"], executed: int, then: Float[Array, "6"]) -> Float[Array, "T 6"]:
    """What is left of a plan after its first `executed` steps, continued by one action held."""
    return jnp.concatenate([plan[executed:], jnp.broadcast_to(then, (executed, 6))])
