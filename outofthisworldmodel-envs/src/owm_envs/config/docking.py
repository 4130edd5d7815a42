"""The configuration of a docking environment: frozen, validated, and readable from TOML, JSON or keyword arguments."""

import itertools
import math
import os
import tomllib
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator

from owm_envs.config.camera import CameraConfig, CameraStructure
from owm_envs.config.parts import (
    EARTH_RADIUS,
    NOISE_PRESETS,
    REWARD_PRESETS,
    Box,
    ChaserConfig,
    ChiefConfig,
    DockingTolerances,
    ForceConfig,
    Frozen,
    NavigationConfig,
    NoiseConfig,
    RandomizationConfig,
    ResetConfig,
    RewardConfig,
    TargetConfig,
    unit,
    within,
)
from owm_envs.config.text import mistakes, toml
from owm_envs.files import read_text
from owm_envs.station.hull import load_hull
from owm_envs.station.ports import PORT_NAMES, port_index
from owm_envs.words import short, unknown

Fidelity = Literal["iss", "iss-hcw", "iss-numerical"]
FIDELITIES: tuple[str, ...] = get_args(Fidelity)
Observed = Literal["state", "pixels", "state+pixels"]
OBSERVATIONS: tuple[str, ...] = get_args(Observed)


class Structure(NamedTuple):
    """All of a configuration that its compiled programs depend on: equal structures share programs.

    The rest is numbers, which reach a program as `Params`.
    """

    fidelity: str
    precision: str
    forces: ForceConfig
    goal_error: bool
    scaling: tuple | None
    """With `normalize`: the reference epoch and the wrench limits, by which actions and observations are scaled."""
    steps_per_action: int
    collision_terminates: bool
    on_off: bool
    """Whether thrusters are on-off."""
    longest_delay: int
    """Simulation steps of commands to keep."""
    sagging: bool
    """Whether thrust makes the delay grow."""
    faulty: bool
    """Whether thrusters may fail in flight."""
    sticky: bool
    """Whether valves have hysteresis."""
    flexible: bool
    """Whether something swings in or on the chaser."""
    plume: bool
    """Whether plumes push back from the hull."""
    turning: bool
    """Whether the target turns in the frame of the orbit."""
    randomized: bool
    biased: bool
    """Whether sensors have a time-correlated error."""
    quiet: bool
    """Whether relative navigation goes quiet."""
    heavy_tailed: bool
    """Whether it has outliers."""
    port_slots: int
    """Length of `Params.port_choices`."""
    hull: str | int
    """"iss", or the number of boxes of another hull."""
    obstacles: int
    observation: str
    camera: CameraStructure | None
    """None without pixels."""
    look_randomized: bool
    """Whether light and look are drawn."""


class DockingConfig(Frozen):
    """Everything that defines a docking environment; unknown keys are errors that name the nearest known one."""

    fidelity: Fidelity = "iss-numerical"
    noise: NoiseConfig = NOISE_PRESETS["none"]
    navigation: NavigationConfig = NavigationConfig()
    reward: RewardConfig = REWARD_PRESETS["data"]
    ports: Annotated[tuple[str, ...], Field(min_length=1)] = PORT_NAMES
    """Ports an episode may be assigned, uniformly."""
    observation: Observed = "state"
    """What an adapter shows: the state part, pixels of the `camera`, or a dict of both."""
    goal_error: bool = True
    """Append the 12-number goal-error block to the observation."""
    normalize: bool = False
    """Actions in [-1, 1], scaled observations, epoch as an offset from the reference."""
    precision: Literal["float32", "float64"] = "float64"
    dt: Annotated[float, within(1e-4, 60), unit("s")] = 0.05
    """Simulation step."""
    steps_per_action: Annotated[int, Field(ge=1, le=100_000), unit("steps")] = 1
    """Simulation steps over which an action is held."""
    horizon: Annotated[float, within(1e-4, 1e7), unit("s")] = 360.0
    """Time after which an episode is truncated: at the end of the decision that reaches it, never earlier."""
    escape_radius: Annotated[float, within(1, 1e6), unit("m")] = 750.0
    """Distance from the station origin beyond which an episode ends."""
    collision_terminates: bool = True
    hull: Literal["iss"] | Annotated[tuple[Box, ...], Field(min_length=1), unit("m")] = "iss"
    """Keep-out boxes of the station: (lower, upper) corners in the station frame. `load_config` also takes the path
    of a text file that `owm-envs station import --out` wrote."""
    obstacles: Annotated[tuple[Box, ...], unit("m")] = ()
    """Extra keep-out boxes, in the same form."""
    reset: ResetConfig = ResetConfig()
    docking: DockingTolerances = DockingTolerances()
    chief: ChiefConfig = ChiefConfig()
    target: TargetConfig = TargetConfig()
    chaser: ChaserConfig = ChaserConfig()
    camera: CameraConfig = CameraConfig()
    forces: ForceConfig = ForceConfig()
    randomization: RandomizationConfig = RandomizationConfig()

    @field_validator("noise", mode="before")
    @classmethod
    def _noise_preset(cls, value):
        return _preset(value, NOISE_PRESETS, "noise")

    @field_validator("reward", mode="before")
    @classmethod
    def _reward_preset(cls, value):
        return _preset(value, REWARD_PRESETS, "reward")

    @field_validator("ports")
    @classmethod
    def _known_ports(cls, value):
        for name in value:
            port_index(name)
        return value

    @field_validator("observation", mode="before")
    @classmethod
    def _known_observation(cls, value):
        if value not in OBSERVATIONS:
            raise ValueError(unknown("observation", value, OBSERVATIONS))
        return value

    @field_validator("hull", "obstacles")
    @classmethod
    def _corners_in_order(cls, value):
        for lower, upper in () if value == "iss" else value:
            if not all(low < high for low, high in zip(lower, upper)):
                raise ValueError(f"a box needs its lower corner below its upper one on each axis, got {lower}, {upper}")
        return value

    @model_validator(mode="after")
    def _consistent(self):
        if self.horizon < self.dt * self.steps_per_action:
            raise ValueError("horizon must hold at least one action (dt * steps_per_action)")
        if self.horizon_decisions >= 2**31:
            raise ValueError(f"horizon must hold fewer than 2**31 actions, got {self.horizon_decisions}")
        chief, ranges = self.chief, self.randomization
        low, most = (chief.eccentricity + offset for offset in ranges.chief_eccentricity)
        if not (0 <= low and most < 1):
            raise ValueError(f"chief.eccentricity with its range must stay from 0 to below 1, got {low} to {most}")
        if (least := chief.semi_major_axis + ranges.chief_semi_major_axis[0]) <= EARTH_RADIUS:
            raise ValueError(f"chief.semi_major_axis with its range must stay above {EARTH_RADIUS} m, got {least}")
        if (perigee := least * (1 - most)) <= EARTH_RADIUS:
            raise ValueError(
                f"chief.semi_major_axis and chief.eccentricity with their ranges must keep the perigee above "
                f"{EARTH_RADIUS} m, got {perigee}"
            )
        if not self.has_pixels:
            for name, given in (
                ("camera", self.camera != CameraConfig()),
                ("randomization.camera", ranges.camera.active),
            ):
                if given:
                    raise ValueError(
                        f"{name} has settings, but the observation {self.observation!r} has no pixels: "
                        "ask for observation='pixels' or 'state+pixels'"
                    )
        elif self.own_target:
            raise ValueError("pixels show the station at rest: leave target and randomization.target_rate_deg alone")
        if self.camera.view == "station_top" and self.camera.field_deg is not None:
            raise ValueError("camera.field_deg is of perspective views, and 'station_top' is orthographic")
        return self

    def __repr_args__(self) -> list[tuple[str | None, Any]]:
        short = []
        for name, value in super().__repr_args__():
            many = name in ("hull", "obstacles") and len(value) > 3
            short.append((name, f"{len(value)} boxes" if many else value))
        return short

    @property
    def own_target(self) -> bool:
        """Whether the target is not the station at rest, which is what pictures and datasets are of."""
        return self.target != TargetConfig() or self.randomization.turning

    @property
    def has_pixels(self) -> bool:
        """Whether the observation has pixels."""
        return "pixels" in self.observation

    @property
    def decision_dt(self) -> float:
        """Seconds from one action to the next."""
        return self.dt * self.steps_per_action

    @property
    def horizon_decisions(self) -> int:
        """Decisions until an episode is truncated: the fewest that last at least `horizon`."""
        whole = self.horizon / self.decision_dt
        return math.ceil(whole * (1 - 1e-9))  # 0.3 / 0.1 is not quite 3, nor 360 / 0.05 surely 7200

    @property
    def structure(self) -> Structure:
        """What the compiled programs depend on."""
        chaser, ranges = self.chaser, self.randomization
        bias = self.noise.bias
        return Structure(
            fidelity=self.fidelity,
            precision=self.precision,
            forces=self.forces,
            goal_error=self.goal_error,
            scaling=(self.chief.reference_epoch, chaser.force_limit, chaser.torque_limit) if self.normalize else None,
            steps_per_action=self.steps_per_action,
            collision_terminates=self.collision_terminates,
            on_off=chaser.thrusters == "on_off",
            longest_delay=chaser.actuation_delay + ranges.actuation_delay[1] + chaser.delay_growth,
            sagging=chaser.delay_growth > 0,
            faulty=chaser.fault.active or ranges.faulty,
            sticky=chaser.hysteresis > 0,
            flexible=chaser.flexible.active,
            plume=chaser.plume.strength > 0,
            turning=self.target.turns or ranges.turning,
            randomized=ranges.active,
            biased=any((bias.position, bias.velocity, bias.attitude, bias.rate)),
            quiet=self.navigation.quiet,
            heavy_tailed=self.navigation.heavy_tailed,
            port_slots=max(len(PORT_NAMES), len(self.ports)),
            hull=self.hull if self.hull == "iss" else len(self.hull),
            obstacles=len(self.obstacles),
            observation=self.observation,
            camera=self.camera.structure if self.has_pixels else None,
            look_randomized=ranges.camera.active,
        )

    def to_toml(self, *, notes: bool = False) -> str:
        """The configuration as TOML text that `load_config` reads back; with `notes`, units and bounds as comments."""
        return toml(self, notes=notes)


def ball(radius: float) -> tuple[Box, ...]:
    """Boxes about the origin whose corners lie on a ball of some radius, m: they reach out to 0.8 of it everywhere."""
    shapes = ((0.94, 0.24, 0.24), (0.8, 0.42, 0.42), (0.66, 0.66, 0.36), (0.69, 0.69, 0.22), (0.577, 0.577, 0.577))
    halves = {tuple(radius * side for side in sides) for shape in shapes for sides in itertools.permutations(shape)}
    return tuple((tuple(-side for side in half), half) for half in sorted(halves))


CONFIG_PRESETS: dict[str, dict[str, Any]] = {
    "data": {},
    "rl": {
        "reward": "rl",
        "steps_per_action": 20,
        "collision_terminates": False,
        "reset": {"radius_min": 100.0, "radius_max": 125.0},
    },
    "tumbling": {
        "target": {"hold": (0.0, -7.0, 0.0)},
        "hull": ball(3.0),
        "ports": PORT_NAMES[:1],
        "randomization": {"target_rate_deg": (1.0, 5.0)},
        "chief": {"mass": 8000.0, "drag_area": 30.0},
        "reset": {"radius_min": 40.0, "radius_max": 80.0},
        "horizon": 600.0,
    },
}
"""Named starting points: the paper's data generation, its reinforcement learning set-up, and a satellite that turns at
1 to 5 deg/s about whatever axis, known as a ball of 3 m."""


def load_config(
    config: "DockingConfig | Mapping[str, Any] | str | os.PathLike | None" = None,
    preset: str = "data",
    **overrides: Any,
) -> DockingConfig:
    """Build a configuration from a preset, then a file or mapping, then keyword arguments, later ones winning.

    Args:
        config: a `DockingConfig`, a mapping of its fields, or the path of a TOML file. Where its `hull` is the path of
            a file of boxes, as `owm-envs station import` writes it, that is looked for beside the file.
        preset: a key of `CONFIG_PRESETS`.
        overrides: fields of `DockingConfig`; nested mappings are merged.

    Raises:
        ValueError: a field, preset or port is unknown (naming the nearest) or out of bounds; or the file or mapping
            is for another fidelity than the one named beside it.
        FileNotFoundError: `config` names no file.
        TypeError: `config` is none of these.
    """
    if preset not in CONFIG_PRESETS:
        raise ValueError(unknown("preset", preset, CONFIG_PRESETS))
    values = _expand(CONFIG_PRESETS[preset])
    given: Mapping[str, Any] = {}
    if isinstance(config, DockingConfig):
        if preset != "data":
            raise ValueError(f"preset {preset!r} would change the whole DockingConfig given: pass one or the other")
        values = config.model_dump()
    elif isinstance(config, Mapping):
        given = config
    elif isinstance(config, str | os.PathLike):
        try:
            given = tomllib.loads(read_text(config))
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"config {os.fspath(config)!r} is not valid TOML: {error}") from None
        if _is_path(given.get("hull")):
            given["hull"] = os.path.join(os.path.dirname(os.fspath(config)), given["hull"])
    elif config is not None:
        told = "a DockingConfig, a mapping of its fields, or the path of a TOML file"
        raise TypeError(f"config must be {told}, got {short(config)}")
    if (asked := given.get("fidelity")) != (named := overrides.get("fidelity", asked)) and asked is not None:
        raise ValueError(f"config is for fidelity {asked!r}, not {named!r}: make the environment id that goes with it")
    values = _merge(_merge(values, _expand(given)), _expand(overrides))
    _check_keys(values, DockingConfig, "")
    try:
        return DockingConfig.model_validate(values)
    except ValidationError as error:
        raise ValueError("invalid configuration: " + mistakes(error, DockingConfig)) from None


def _preset(value, presets, kind):
    if isinstance(value, str):
        if value not in presets:
            raise ValueError(unknown(f"{kind} preset", value, presets))
        return presets[value]
    return value


def _expand(values: Mapping[str, Any]) -> dict[str, Any]:
    """Spell named presets out, so that later values change single fields of them."""
    expanded = dict(values)
    for key, presets in (("noise", NOISE_PRESETS), ("reward", REWARD_PRESETS)):
        if key in expanded:
            value = _preset(expanded[key], presets, key)
            expanded[key] = value.model_dump() if isinstance(value, BaseModel) else value
    if _is_path(expanded.get("hull")):
        expanded["hull"] = load_hull(expanded["hull"]).tolist()
    return expanded


def _is_path(hull: Any) -> bool:
    return isinstance(hull, (str, os.PathLike)) and hull != "iss"


def _merge(base: Mapping[str, Any], update: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in update.items():
        old = merged.get(key)
        merged[key] = _merge(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged


def _check_keys(values: Mapping[str, Any], model: type[BaseModel], prefix: str) -> None:
    for key, value in values.items():
        if key not in model.model_fields:
            raise ValueError(unknown("configuration key", prefix + str(key), [prefix + k for k in model.model_fields]))
        nested = model.model_fields[key].annotation
        if isinstance(value, Mapping) and isinstance(nested, type) and issubclass(nested, BaseModel):
            _check_keys(value, nested, f"{prefix}{key}.")
