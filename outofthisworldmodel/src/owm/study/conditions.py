"""What a study changes: the environment that is flown, or the planner's map of it; no policy is told of either."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from owm.scores.docking import evaluation_config
from owm_envs.config import CONFIG_PRESETS, DockingConfig, load_config
from owm_envs.config.parts import NOISE_PRESETS, ChaserConfig
from owm_envs.station import hull_boxes
from owm_envs.words import unknown

Boxes = Float[np.ndarray, "N 2 3"]
_AXIS = np.ones(3) / np.sqrt(3.0)
"""Of shifts and turns: no axis of the station is spared."""
_CHASER, _WHITE = ChaserConfig(), NOISE_PRESETS["cooperative"]


@dataclass(frozen=True)
class Condition:
    """One way to fly the protocol."""

    what: str
    """For tables: what differs from nominal."""
    shell: str = "100-225"
    noise: str = "cooperative"
    """What policies that know a noise model are told."""
    fidelity: str = "iss-numerical"
    known: dict[str, Any] = field(default_factory=dict)
    """Fields of the environment that policies are told."""
    hidden: dict[str, Any] = field(default_factory=dict)
    """Fields of the environment that policies are not told: they are built for the nominal one."""
    map: Callable[[Boxes], Boxes] | None = None
    """From the true hull to the one that the planner's field is made of; the truth keeps its hull."""

    def told(self) -> DockingConfig:
        """The environment that policies are built for."""
        return evaluation_config(self.shell, noise=self.noise, fidelity=self.fidelity, **self.known)

    def flown(self) -> DockingConfig:
        """The environment that they fly."""
        return load_config(self.told(), **self.hidden)

    def map_boxes(self) -> Boxes | None:
        """The planner's hull; None for the true one."""
        return None if self.map is None else self.map(hull_boxes())


def shifted(boxes: Boxes, by: float = 0.3) -> Boxes:
    """Boxes moved `by` metres along (1, 1, 1)."""
    return boxes + by * _AXIS


def turned(boxes: Boxes, by_deg: float = 1.0, piece: float = 4.0) -> Boxes:
    """Boxes turned about (1, 1, 1) through the origin by a small angle.

    Boxes stay parallel to the axes: they are cut into pieces no longer than `piece` metres, whose centres turn; a
    piece's corner is off by at most half its diagonal times the angle.
    """
    pieces = []
    for low, high in boxes:
        count = np.ceil((high - low) / piece).astype(int)
        size = (high - low) / count
        places = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 3)
        pieces.append(np.stack([low + places * size, low + (places + 1) * size], axis=1))
    cut = np.concatenate(pieces)
    centre = cut.mean(axis=1)
    angle = np.radians(by_deg)
    # Rodrigues' formula.
    along = (centre @ _AXIS)[:, None] * _AXIS * (1 - np.cos(angle))
    moved = centre * np.cos(angle) + np.cross(_AXIS, centre) * np.sin(angle) + along
    return cut + (moved - centre)[:, None]


def without_array(boxes: Boxes) -> Boxes:
    """Boxes without the wings of the port-side solar arrays that stand up from the truss."""
    centre = boxes.mean(axis=1)
    return boxes[~((centre[:, 0] > 25.0) & (centre[:, 2] > 6.0))]


def _chaser(what: str, **values: Any) -> Condition:
    return Condition(what, hidden={"chaser": values})


def _failing(what: str, randomization: dict[str, Any] | None = None, **fault: Any) -> Condition:
    """Thrusters fail; there is more time to dock."""
    hidden = {"horizon": 1800.0, "chaser": {"fault": fault}, "randomization": randomization or {}}
    return Condition(what, hidden=hidden)


def _swinging(what: str, **values: Any) -> Condition:
    return Condition(what, hidden={"chaser": {"flexible": values}})


def _dead(*axes: int) -> tuple[float, ...]:
    return tuple(0.0 if i in axes else 1.0 for i in range(6))


def _quiet(seconds: float, share: float = 0.3) -> Condition:
    """Policies see when (`state_valid`)."""
    what = f"no measurement for {seconds:g} s, again and again, {100 * share:g} % of the time"
    return Condition(what, hidden={"navigation": {"outage_duration": seconds, "outage_share": share}})


def _scaled(factor: float) -> tuple[float, ...]:
    return tuple(factor * moment for moment in _CHASER.inertia)


def _turn(by_deg: float) -> tuple[float, ...]:
    return tuple((np.radians(by_deg) * _AXIS).tolist())


_BIAS = {
    "position": _WHITE.position,
    "velocity": _WHITE.velocity,
    "attitude": _WHITE.attitude,
    "rate": _WHITE.rate,
    "correlation_time": 100.0,
}

CONDITIONS: dict[str, Condition] = {
    "nominal": Condition("cooperative noise, starts 100–225 m out"),
    "near": Condition("starts 100–125 m out, the paper's shell for reinforcement learning", shell="100-125"),
    "noncooperative": Condition("noncooperative noise: 1 % of range, 0.03 m/s", noise="noncooperative"),
    "ten times noncooperative": Condition(
        "ten times the noncooperative noise: 10 % of range, 0.3 m/s; policies know of a tenth",
        noise="noncooperative",
        hidden={"noise": {"position_per_range": 0.1, "velocity": 0.3}},
    ),
    "heavy": _chaser("mass +25 %", mass=1.25 * _CHASER.mass),
    "light": _chaser("mass −25 %", mass=0.75 * _CHASER.mass),
    "more inertia": _chaser("inertia +20 % about all axes", inertia=_scaled(1.2)),
    "less inertia": _chaser("inertia −20 % about all axes", inertia=_scaled(0.8)),
    "weak axis": _chaser("70 % thrust along the nose's axis, which brakes", thrust_scale=(1, 1, 0.7, 1, 1, 1)),
    "misaligned": _chaser(
        "thrust and torque turned by 5 deg about body (1, 1, 1)",
        misalignment=_turn(5.0),
    ),
    "on-off": _chaser(
        "on-off thrusters: multiples of 400 N and 500 N m, pulses of 50 ms at least",
        thrusters="on_off",
        thruster_force=400.0,
        minimum_on_time=0.05,
    ),
    "delay": _chaser("thrusters answer five steps of 0.05 s late", actuation_delay=5),
    "biased": Condition(
        "navigation bias as large as the white error (0.05 m, 2 mm/s), correlated over 100 s",
        hidden={"noise": {"bias": _BIAS}},
    ),
    "map shifted": Condition("the planner's hull lies 0.3 m off", map=shifted),
    "map turned": Condition("the planner's hull is turned by 1 deg", map=turned),
    **{f"outages of {seconds:g} s": _quiet(seconds) for seconds in (1.0, 5.0, 10.0, 30.0)},
    "outages of 10 s, a tenth": _quiet(10.0, 0.1),
    "outages of 10 s, half": _quiet(10.0, 0.5),
    "outliers": Condition(
        "5 % of measurements with 20 times the noise",
        hidden={"navigation": {"outlier_share": 0.05, "outlier_scale": 20.0}},
    ),
    "turned by 30 deg": _failing("thrust and torque turned by 30 deg about body (1, 1, 1)", misalignment=_turn(30.0)),
    "turned by 45 deg": _failing("thrust and torque turned by 45 deg about body (1, 1, 1)", misalignment=_turn(45.0)),
    **{
        f"target turns at {rate} deg/s": Condition(
            f"no station, but a ball of 3 m that turns at {rate} deg/s; starts 40–80 m out",
            known=CONFIG_PRESETS["tumbling"] | {"randomization": {"target_rate_deg": (rate, rate)}},
        )
        for rate in (1, 2, 3, 5)
    },
    "tumbling": Condition("starts at up to 60 deg/s", hidden={"reset": {"rate": np.radians(60.0)}}),
    **{
        f"force {name} dead": _failing(f"no force along body {name}, from the start", thrust_scale=_dead(axis))
        for axis, name in enumerate("xyz")
    },
    **{
        f"torque {name} dead": _failing(f"no torque about body {name}, from the start", thrust_scale=_dead(axis))
        for axis, name in enumerate("xyz", 3)
    },
    "forces x and y dead": _failing("no force along body x and y, from the start", thrust_scale=_dead(0, 1)),
    "torque x fails": _failing("no torque about body x from 120 s on", time=120.0, thrust_scale=_dead(3)),
    "one-sided": _failing("no force along negative body y", one_sided=(0, 1, 0, 0, 0, 0)),
    "leak": _failing("a jet stuck open: 400 N along body y, 400 N m about z", leak=(0.0, 400.0, 0.0, 0.0, 0.0, 400.0)),
    "thruster fails": _failing(
        "20 to 90 s into the flight one axis of force falls to 0 to 40 %",
        {"fault_time": (20.0, 90.0), "fault_scale": (0.0, 0.4)},
    ),
    "thrust turns": _failing(
        "20 to 90 s into the flight thrust and torque turn by 10 to 45 deg",
        {"fault_time": (20.0, 90.0), "fault_misalignment_deg": (10.0, 45.0)},
    ),
    "fuel sloshes": _swinging("2.4 t of fuel that sloshes at 0.3 Hz", slosh_mass=2400.0),
    "arrays bend": _swinging(
        "arrays of 20,000 kg m2 that bend at 0.1 Hz", array_inertia=20_000.0, array_frequency=0.1, array_damping=0.005
    ),
    "valves stick": _chaser("valves with a hysteresis of 10 % of the limits", hysteresis=0.1),
    "plume on the hull": _chaser(
        "plumes push back from the hull with 30 % of the thrust at contact, a quarter of it 5 m off",
        plume={"strength": 0.3, "reach": 5.0},
    ),
    "delay grows with thrust": _chaser(
        "a delay of up to 0.5 s as thrust of the last 5 s makes the feed pressure sag", delay_growth=10
    ),
    "map without array": Condition("the planner's hull lacks the port side's upper solar wings", map=without_array),
}
CONDITIONS |= {
    f"{name}, noncooperative": replace(
        CONDITIONS[name], what=f"{CONDITIONS[name].what}, noncooperative noise", noise="noncooperative"
    )
    for name in ("heavy", "weak axis")
}


def condition(name: str) -> Condition:
    """Look a condition up.

    Raises:
        ValueError: it is unknown (naming the nearest).
    """
    if name not in CONDITIONS:
        raise ValueError(unknown("condition", name, CONDITIONS))
    return CONDITIONS[name]
