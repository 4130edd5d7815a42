"""A planner that hands over to a classical policy where its sensors or its vehicle are beyond what it can fit."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

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
    fallbacks: tuple[Any, Any]
    velocity: Float[np.ndarray, "B 3"]
    """m/s, station frame, as seen last."""
    measured: Bool[np.ndarray, "B"]
    """Whether that was a measurement, and not an old one."""
    square: Float[np.ndarray, "B 3"]
    """Mean square of its changes."""
    handed: Int[np.ndarray, "B"]
    """Which fallback flies this episode; -1 for none."""


class GuardedPolicy(SlotPolicy):
    """Fly a planner; another policy flies an episode to its end where the planner should not.

    Where the measured velocity jumps by more than `noisiest`, that is `noisy`. Where the fit in flight gave an alarm
    along all three axes of force, or of torque, it is `structured`: one thruster that fails shows along one axis.
    Either begins afresh, since it has commanded nothing so far.

    Args:
        planner: with a learner that has a `health`.
        noisy: flies where sensors are too bad; of the same environment.
        structured: flies where no linear map explains the vehicle; of the same environment.
        noisiest: root mean square of the changes of one axis's measured velocity, m/s.
    """

    def __init__(self, planner: PlannerPolicy, noisy: SlotPolicy, structured: SlotPolicy, noisiest: float = NOISIEST):
        super().__init__(f"{planner.name}, guarded", planner.layout, planner.num_slots)
        self.planner, self.fallbacks, self.noisiest = planner, (noisy, structured), noisiest

    def __repr__(self) -> str:
        return f"GuardedPolicy({self.planner!r}, {', '.join(map(repr, self.fallbacks))})"

    @property
    def health(self) -> Health | None:
        """As the planner's."""
        return None if self._state is None else self.planner.health_of(self._state.planner)

    @property
    def verdict(self) -> list[str]:
        """What each slot does: "docks", "leaves", or what it handed over to."""
        told = self.planner.verdict_of(self._state.planner)
        flown = self._state.handed.tolist()
        return [word if which < 0 else self.fallbacks[which].name for which, word in zip(flown, told, strict=True)]

    def check_ports(self, ports: np.ndarray) -> None:
        """As the planner."""
        self.planner.check_ports(ports)

    def begin(self, count: int) -> GuardedState:
        """Every slot in the planner's hands."""
        nothing = np.zeros((count, 3))
        begun = tuple(each.begin(count) for each in self.fallbacks)
        return GuardedState(
            self.planner.begin(count), begun, nothing, np.zeros(count, bool), nothing, np.full(count, -1)
        )

    def act(
        self, state: GuardedState, observation: dict[str, np.ndarray], slots: Slots
    ) -> tuple[Float[np.ndarray, "B 6"], GuardedState]:
        """The planner's action, or a fallback's."""
        velocity = View.of(self.layout.measured_view(observation)).velocity
        square = _KEEP * state.square + (1 - _KEEP) * (velocity - state.velocity) ** 2
        square = np.where((slots.measured & state.measured)[:, None], square, state.square)
        square = np.where(slots.fresh[:, None], 0, square)
        before = np.where(slots.fresh, -1, state.handed)
        noisy = square.min(axis=1) > self.noisiest**2
        structured = self._structured(state.planner) & ~slots.fresh
        now = np.select([noisy, structured], [0, 1], -1)
        handed = np.where((before < 0) & slots.active, now, before)

        action, planner = self.planner.act(
            state.planner, observation, slots._replace(active=slots.active & (handed < 0))
        )
        fallbacks = list(state.fallbacks)
        for which, policy in enumerate(self.fallbacks):
            flown = handed == which
            if flown.any():
                begun = slots._replace(fresh=slots.fresh | (flown & (before < 0)))
                other, fallbacks[which] = policy.act(fallbacks[which], observation, begun)
                action = np.where(flown[:, None], other, action)
        return action, GuardedState(planner, tuple(fallbacks), velocity, slots.measured, square, handed)

    def _structured(self, planner: Any) -> Bool[np.ndarray, "B"]:
        """Where the fit gave alarms along all three axes of one kind, and the planner has not turned to leave."""
        alarms = np.asarray(self.planner.health_of(planner).alarms).reshape(-1, 2, 3)
        structured = (alarms > 0).all(axis=2).any(axis=1)
        if structured.any():
            structured &= np.array(self.planner.verdict_of(planner)) != "leaves"
        return structured
