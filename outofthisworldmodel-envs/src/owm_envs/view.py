"""The relative view: the 13 numbers by which task, policies and models see a chaser."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

VIEW_SIZE = 13
VIEW_NAMES: tuple[str, ...] = (
    *(f"{part}_{axis}" for part in ("position", "velocity") for axis in "xyz"),
    *(f"attitude_{axis}" for axis in "wxyz"),
    *(f"rate_{axis}" for axis in "xyz"),
)
"""A name for each number of a view, in order."""


class View(NamedTuple):
    """A chaser relative to the station, in parts; leading axes are free.

    `View.of` takes them from an array of 13 numbers, `numbers` puts them back.
    """

    position: Float[Array, "... 3"]
    """m, station frame."""
    velocity: Float[Array, "... 3"]
    """m/s, station frame."""
    attitude: Float[Array, "... 4"]
    """Unit quaternion, scalar first, body to station."""
    rate: Float[Array, "... 3"]
    """rad/s, body axes, relative to the station."""

    @classmethod
    def of(cls, numbers: Float[Array, "... 13"]) -> "View":
        """The parts of 13 numbers; NumPy in, NumPy out."""
        return cls(*(numbers[..., part] for part in VIEW_SLICES))

    def numbers(self) -> Float[Array, "... 13"]:
        """The 13 numbers; NumPy in, NumPy out."""
        if all(isinstance(part, np.ndarray) for part in self):
            return np.concatenate(self, axis=-1)
        import jax.numpy as jnp

        return jnp.concatenate(self, axis=-1)


VIEW_SLICES = View(slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13))
"""Where each part lies, to change it in place: `view.at[VIEW_SLICES.attitude]`."""
