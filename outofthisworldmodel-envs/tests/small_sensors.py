"""Two small sensors for the tests: a range finder that is slow and may miss, and a picture."""

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp

from owm_envs.task.sensors import Measurement

CONFIG = {"fidelity": "iss", "noise": "cooperative", "horizon": 0.5, "ports": ["zvezda_aft", "unity_nadir"]}
LIMIT = 150.0
"""m. Starts are 100 to 200 m away: some are measured, some are not."""


@dataclass(frozen=True)
class RangeFinder:
    """Distance to the station's origin, m, up to a limit, every other decision."""

    spread: float = 0.1
    limit: float = LIMIT
    name: str = "range"
    shape: tuple[int, ...] = ()
    dtype: str = "float32"
    every: int = 2
    may_miss: bool = True

    def measure(self, key, truth):
        """Measure."""
        distance = jnp.linalg.norm(truth.view.position)
        return Measurement((distance + self.spread * jax.random.normal(key)).astype(jnp.float32), distance < self.limit)


@dataclass(frozen=True)
class Patch:
    """A picture of 2 by 3 pixels: the port's index and the decisions so far."""

    name: str = "patch"
    shape: tuple[int, ...] = (2, 3)
    dtype: str = "uint8"
    every: int = 1
    may_miss: ClassVar[bool] = False

    def measure(self, key, truth):
        """Measure."""
        return jnp.stack([jnp.full(3, truth.port), jnp.full(3, truth.count)]).astype(jnp.uint8)


SENSORS = (RangeFinder(), Patch())
PARTS = {"state": (25,), "range": (1,), "range_valid": (1,), "patch": (2, 3)}
