"""A tree of batched arrays as a few matrices: forty small arrays cost more to bring to the host than to compute."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


class Packing:
    """How one compiled program's output tree is packed; learnt when it is traced."""

    def __init__(self):
        self._tree = None
        self._leaves: list[tuple[str, int, int, tuple[int, ...]]] = []

    def pack(self, tree: Any) -> dict[str, jax.Array]:
        """The leaves (B, ...) side by side, a matrix (B, K) for each dtype."""
        leaves, tree_of = jax.tree.flatten(tree)
        columns: dict[str, list[jax.Array]] = {}
        widths: dict[str, int] = {}
        places = []
        for leaf in leaves:
            name, width = leaf.dtype.name, int(np.prod(leaf.shape[1:]))
            start = widths.get(name, 0)
            places.append((name, start, start + width, leaf.shape[1:]))
            widths[name] = start + width
            columns.setdefault(name, []).append(leaf.reshape(leaf.shape[0], width))
        self._tree, self._leaves = tree_of, places  # at once: two threads may trace
        return {name: jnp.concatenate(parts, axis=1) for name, parts in columns.items()}

    def unpack(self, matrices: dict[str, np.ndarray]) -> Any:
        """The tree again, of NumPy views."""
        leaves = []
        for name, start, stop, shape in self._leaves:
            columns = matrices[name][:, start:stop]
            leaves.append(columns.reshape(len(columns), *shape))
        return jax.tree.unflatten(self._tree, leaves)
