"""Navigation that goes quiet: when, in which flight."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool


class Outages(NamedTuple):
    """Relative navigation is quiet for some seconds, again and again.

    Attributes:
        duration: of each, s.
        share: of the time; what lies between two of them is drawn, exponentially distributed.
    """

    duration: float
    share: float = 0.3

    def measured(self, seed: int, decisions: int, dt: float) -> Bool[np.ndarray, "T"]:
        """Whether there is a measurement at each decision of a flight, the first one included always.

        Args:
            seed: of the flight.
            decisions: how many.
            dt: seconds from one to the next.

        Raises:
            ValueError: the duration is not positive, or the share not between 0 and 1.
        """
        if not (self.duration > 0 and 0 < self.share < 1):
            raise ValueError(f"outages need a positive duration and a share between 0 and 1, got {self}")
        rng = np.random.default_rng([seed, round(1000 * self.duration)])
        seen, at = np.ones(decisions, bool), 0.0
        while at < decisions * dt:
            at += max(rng.exponential(self.duration * (1 - self.share) / self.share), dt)
            seen[round(at / dt) : round((at + self.duration) / dt)] = False
            at += self.duration
        return seen
