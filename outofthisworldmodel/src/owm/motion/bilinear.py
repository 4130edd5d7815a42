"""One step of a rigid body as a least-squares map of products: of features with the rate and the action.

With attitude as a rotation matrix the motion is nearly bilinear: the matrix turns by its product with the rate, thrust
acts through its product with the force, and gyroscopic torque is a product of rates.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

COLUMNS = 1 + 24 + 9 * 9 + 9 + 8 + 7
"""Inputs of the map: one, features, action, products of matrix with rate and action, of rate with both, pairs once."""
SIGNIFICANT = 5.0
"""Standard errors that a coefficient has to differ from zero by."""


def bilinear_inputs(features: Float[Array, "*n 18"], action: Float[Array, "*n 6"]) -> Float[Array, "*n c"]:
    """Return the columns of the map.

    Args:
        features: position, velocity, rotation matrix, rate, all scaled.
        action: force and torque, scaled.
    """
    both = jnp.concatenate([features, action], axis=-1)
    pairs = both[..., 6:18, None] * both[..., None, 15:24]
    matrix = pairs[..., :9, :].reshape(*both.shape[:-1], 81)
    rate = [pairs[..., 9 + i, i:] for i in range(3)]
    return jnp.concatenate([jnp.ones_like(both[..., :1]), both, matrix, *rate], axis=-1)


def bilinear_change(
    transition: Float[Array, "18 c"], features: Float[Array, "18"], action: Float[Array, "6"]
) -> Float[Array, "18"]:
    """Return the change of the features over one step."""
    return transition @ bilinear_inputs(features, action)


def fit_bilinear_map(
    features: Float[Array, "N 18"], action: Float[Array, "N 6"], change: Float[Array, "N 18"]
) -> tuple[Float[np.ndarray, "18 c"], Float[np.ndarray, "N 18"]]:
    """Fit the map by least squares and drop coefficients that are not significant, a sixth of them at a time.

    What noise alone puts into a coefficient would add up over a rollout: with all columns kept, position errs several
    times as much after 64 steps.

    Returns:
        The map, and what it leaves of `change`.
    """
    rows, outputs = change.shape
    change = np.asarray(change, np.float64)
    parts = np.array_split(np.arange(rows), max(rows // 20_000, 1))
    normal, moment = np.zeros((COLUMNS, COLUMNS)), np.zeros((COLUMNS, outputs))
    for part in parts:
        inputs = np.asarray(bilinear_inputs(features[part], action[part]), np.float64)
        normal += inputs.T @ inputs
        moment += inputs.T @ change[part]
    unit = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-12))
    normal = normal * unit * unit[:, None] + 1e-9 * np.eye(COLUMNS)
    moment *= unit[:, None]
    total = np.sum(change**2, axis=0)
    transition = np.zeros((outputs, COLUMNS))
    for output in range(outputs):
        kept = np.arange(COLUMNS)
        while len(kept):
            inverse = np.linalg.inv(normal[np.ix_(kept, kept)])
            weight = inverse @ moment[kept, output]
            variance = max(total[output] - weight @ moment[kept, output], 1e-12 * total[output]) / rows
            errors = np.abs(weight) / np.sqrt(np.maximum(variance * np.diag(inverse), 1e-300))
            weakest = np.argsort(errors)[: max(len(kept) // 6, 1)]
            weakest = weakest[errors[weakest] < SIGNIFICANT]
            if not len(weakest):
                transition[output, kept] = weight * unit[kept]
                break
            kept = np.delete(kept, weakest)
    left = np.concatenate(
        [change[part] - np.asarray(bilinear_inputs(features[part], action[part])) @ transition.T for part in parts]
    )
    return transition, left
