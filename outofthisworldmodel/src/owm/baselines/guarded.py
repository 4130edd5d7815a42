"""A planner that hands over to the classical stack where measurements are worse than any that it was tried with."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from owm.planning.health import Health
from owm.planning.policy import PlannerPolicy
from owm_envs.config.parts import NOISE_PRESETS
from owm_envs.policies import SlotPolicy, Slots
from owm_envs.view import View

NOISIEST = 3 * np.sqrt(2) * NOISE_PRESETS["noncooperative"].velocity
"""m/s, of the change of velocity from one measurement to the next, along every axis: three times that of the worst
sensors that the planner was tried with. A whole thruster comes to a quarter of it, so no fault is taken for noise."""
_KEEP = 0.9
"""Share of the mean square of such changes that outlives a decision."""


class GuardedState(NamedTuple):
    """What every slot carries."""

    planner: Any
    fallback: Any
    velocity: Float[np.ndarray, "B 3"]
    """m/s, station frame, as seen last."""
    measured: Bool[np.ndarray, "B"]
    """Whether that was a measurement, and not an old one."""
    square: Float[np.ndarray, "B 3"]
    """Mean square of its changes."""
    handed: Bool[np.ndarray, "B"]
    """Whether the fallback flies this episode."""


class GuardedPolicy(SlotPolicy):
    """Fly a planner; where the measured velocity jumps by more than `noisiest`, another policy flies to the end.

    That one begins afresh there, since it has commanded nothing so far.

    Args:
        planner: with a learner that has a `health`.
        fallback: of the same environment.
        noisiest: root mean square of the changes of one axis's measured velocity, m/s.
    """

    def __init__(self, planner: PlannerPolicy, fallback: SlotPolicy, noisiest: float = NOISIEST):
        super().__init__(f"{planner.name}, guarded", planner.layout, planner.num_slots)
        self.planner, self.fallback, self.noisiest = planner, fallback, noisiest

    def __repr__(self) -> str:
        return f"GuardedPolicy({self.planner!r}, {self.fallback!r})"

    @property
    def health(self) -> Health | None:
        """As the planner's."""
        return None if self._state is None else self.planner.health_of(self._state.planner)

    @property
    def verdict(self) -> list[str]:
        """What each slot does: "docks", "leaves", or what it handed over to."""
        told = self.planner.verdict_of(self._state.planner)
        return [self.fallback.name if handed else word for handed, word in zip(self._state.handed, told, strict=True)]

    def check_ports(self, ports: np.ndarray) -> None:
        """As the planner."""
        self.planner.check_ports(ports)

    def begin(self, count: int) -> GuardedState:
        """Every slot in the planner's hands."""
        nothing = np.zeros((count, 3))
        kept = self.planner.begin(count), self.fallback.begin(count)
        never = np.zeros(count, bool)
        return GuardedState(*kept, nothing, never, nothing, never)

    def act(
        self, state: GuardedState, observation: dict[str, np.ndarray], slots: Slots
    ) -> tuple[Float[np.ndarray, "B 6"], GuardedState]:
        """The planner's action, or the fallback's."""
        velocity = View.of(self.layout.measured_view(observation)).velocity
        square = _KEEP * state.square + (1 - _KEEP) * (velocity - state.velocity) ** 2
        square = np.where((slots.measured & state.measured)[:, None], square, state.square)
        square = np.where(slots.fresh[:, None], 0, square)
        noisy = slots.active & (square.min(axis=1) > self.noisiest**2)
        before = state.handed & ~slots.fresh
        handed = before | noisy
        action, planner = self.planner.act(state.planner, observation, slots._replace(active=slots.active & ~handed))
        fallback = state.fallback
        if handed.any():
            begun = slots._replace(fresh=slots.fresh | (handed & ~before))
            other, fallback = self.fallback.act(fallback, observation, begun)
            action = np.where(handed[:, None], other, action)
        return action, GuardedState(planner, fallback, velocity, slots.measured, square, handed)
