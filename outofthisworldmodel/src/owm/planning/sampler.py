"""Candidates: action sequences around a plan, with noise that is smooth in time."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from owm.planning.config import Shape
from owm_envs.flags import own_promotion


def interpolation(horizon: int, knots: int) -> Float[np.ndarray, "T N"]:
    """Linear interpolation from knots to steps, rows of unit norm: unit noise at knots stays unit noise."""
    place = np.linspace(0.0, knots - 1.0, horizon)[:, None]
    hat = np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots)))
    return hat / np.linalg.norm(hat, axis=1, keepdims=True)


@own_promotion()
def sample_candidates(
    shape: Shape, sigma: Float[Array, "6"], plan: Float[Array, "T 6"], *, key: Key[Array, ""]
) -> Float[Array, "K T 6"]:
    """Draw candidates around a plan: smooth noise of deviation `sigma`, clipped; the first has none."""
    dtype = plan.dtype
    draws = jax.random.normal(key, (shape.candidates - 1, shape.knots, 6), dtype)
    weights = jnp.asarray(interpolation(shape.horizon, shape.knots), dtype)
    noise = sigma * jnp.einsum("tn,kni->kti", weights, draws)
    return jnp.clip(jnp.concatenate([plan[None], plan + noise]), -1, 1)
