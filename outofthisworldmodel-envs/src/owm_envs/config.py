"""The configuration of a docking environment: frozen, validated, and readable from TOML, JSON or keyword arguments."""

import datetime
import difflib
import os
import tomllib
from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_args

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from owm_envs.station.ports import PORT_NAMES, port_index

Fidelity = Literal["iss", "iss-hcw", "iss-numerical"]
FIDELITIES: tuple[str, ...] = get_args(Fidelity)

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Vector6 = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
Box = tuple[Vector3, Vector3]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class NoiseConfig(_Frozen):
    """Sensor noise as total root-mean-square errors: the norm of the error vector (paper, table of noise models)."""

    position: NonNegative = 0.0
    """m, independent of range."""
    position_per_range: NonNegative = 0.0
    """Fraction of the true distance to the station origin, added to `position`."""
    velocity: NonNegative = 0.0
    """m/s."""
    attitude: NonNegative = 0.0
    """rad, total rotation angle."""
    rate: NonNegative = 0.0
    """rad/s."""


NOISE_PRESETS: dict[str, NoiseConfig] = {
    "none": NoiseConfig(),
    "cooperative": NoiseConfig(position=0.05, velocity=0.002, attitude=5e-5, rate=1e-5),
    "noncooperative": NoiseConfig(position_per_range=0.01, velocity=0.03, attitude=5e-5, rate=1e-5),
}


class RewardConfig(_Frozen):
    """Weights (`w_*`), pseudo-Huber knees (`delta_*`) and scales (`sigma_*`) of the paper's reward, SI units."""

    position: Finite = -0.5
    velocity: Finite = -0.2
    attitude: Finite = -0.2
    rate: Finite = -0.1
    progress: Finite = 0.0
    proximity: Finite = 0.0
    alignment: Finite = 0.0
    effort: Finite = 0.0
    collision: Finite = -1e6
    dock: Finite = 10_000.0
    escape: Finite = -10_000.0
    delta_position: Positive = 1.0
    sigma_position: Positive = 225.0
    delta_velocity: Positive = 0.1
    sigma_velocity: Positive = 5.0
    delta_attitude: Positive = 0.05
    sigma_attitude: Positive = 3.141592653589793
    delta_rate: Positive = 0.005
    sigma_rate: Positive = 0.05
    gate_far: NonNegative = 0.1
    gate_distance: Positive = 25.0
    sigma_proximity: Positive = 1.0
    sigma_alignment: Positive = 0.1


REWARD_PRESETS: dict[str, RewardConfig] = {
    "data": RewardConfig(),
    "rl": RewardConfig(
        position=-0.9,
        velocity=-0.05,
        attitude=-0.2,
        rate=-0.02,
        progress=-2.0,
        proximity=0.5,
        alignment=0.5,
        effort=-0.05,
        collision=-2.0,
        dock=1000.0,
        escape=-1000.0,
        gate_far=0.5,
    ),
}


class ResetConfig(_Frozen):
    """Distribution of episode starts."""

    radius_min: Positive = 100.0
    radius_max: Positive = 225.0
    attitude_error_deg: NonNegative = 10.0
    speed: NonNegative = 0.1
    """m/s, station-relative, upper bound of a uniform magnitude."""
    rate: NonNegative = 0.01
    """rad/s, station-relative, upper bound of a uniform magnitude."""
    epoch_window: NonNegative = 7 * 86_400.0
    """s; the start epoch is uniform over this window from the reference epoch."""

    @model_validator(mode="after")
    def _ordered(self):
        if self.radius_max < self.radius_min:
            raise ValueError(f"radius_max ({self.radius_max}) must be at least radius_min ({self.radius_min})")
        return self


class DockingTolerances(_Frozen):
    """Docked means all four at once, station-relative."""

    position: Positive = 0.1
    speed: Positive = 0.5
    attitude_deg: Positive = 5.0
    rate_deg: Positive = 0.5


class ChiefConfig(_Frozen):
    """The station's orbit at the reference epoch and its ballistic properties."""

    reference_epoch: str = "2026-08-01T00:00:00Z"
    """UTC."""
    semi_major_axis: Positive = 6_795_000.0
    eccentricity: Annotated[float, Field(ge=0, lt=1)] = 0.0005
    inclination_deg: Finite = 51.64
    raan_deg: Finite = 0.0
    argument_of_perigee_deg: Finite = 0.0
    mean_anomaly_deg: Finite = 0.0
    mass: Positive = 419_700.0
    drag_area: NonNegative = 1500.0
    drag_coefficient: NonNegative = 2.2

    @field_validator("reference_epoch")
    @classmethod
    def _a_date(cls, value):
        datetime.datetime.fromisoformat(value)
        return value


class ChaserConfig(_Frozen):
    """The Dragon-class chaser."""

    mass: Positive = 12_000.0
    inertia: tuple[Positive, Positive, Positive] = (80_000.0, 80_000.0, 50_000.0)
    """kg m2, principal, body axes."""
    drag_area: NonNegative = 50.0
    drag_coefficient: NonNegative = 2.2
    radius: Positive = 2.25
    """m, bounding sphere."""
    force_limit: Positive = 1600.0
    """N per body axis."""
    torque_limit: Positive = 2000.0
    """N m per body axis."""
    thrust_scale: Vector6 = (1.0,) * 6
    """Delivered over commanded wrench, per axis."""
    misalignment: Vector3 = (0.0, 0.0, 0.0)
    """rad, rotation vector from the commanded to the delivered wrench's axes."""
    actuation_delay: Annotated[int, Field(ge=0)] = 0
    """Simulation steps between command and delivery."""


class ForceConfig(_Frozen):
    """Perturbations of `iss-numerical`."""

    zonal_degree: Literal[0, 2, 3, 4, 5, 6] = 4
    sun: bool = True
    moon: bool = True
    drag: bool = True


class DockingConfig(_Frozen):
    """Everything that defines a docking environment; unknown keys are errors that name the nearest known one."""

    fidelity: Fidelity = "iss-numerical"
    noise: NoiseConfig = NOISE_PRESETS["none"]
    reward: RewardConfig = REWARD_PRESETS["data"]
    ports: Annotated[tuple[str, ...], Field(min_length=1)] = PORT_NAMES
    """Ports an episode may be assigned, uniformly."""
    goal_error: bool = True
    """Append the 12-number goal-error block to the observation."""
    normalize: bool = False
    """Actions in [-1, 1], scaled observations, epoch as an offset from the reference."""
    precision: Literal["float32", "float64"] = "float64"
    dt: Positive = 0.05
    """s, simulation step."""
    steps_per_action: Annotated[int, Field(ge=1)] = 1
    """Simulation steps over which an action is held."""
    horizon: Positive = 360.0
    """s, after which an episode is truncated."""
    escape_radius: Positive = 750.0
    collision_terminates: bool = True
    obstacles: tuple[Box, ...] = ()
    """Extra keep-out boxes: (lower, upper) corners in the station frame, m."""
    reset: ResetConfig = ResetConfig()
    docking: DockingTolerances = DockingTolerances()
    chief: ChiefConfig = ChiefConfig()
    chaser: ChaserConfig = ChaserConfig()
    forces: ForceConfig = ForceConfig()

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

    @field_validator("obstacles")
    @classmethod
    def _corners_in_order(cls, value):
        for lower, upper in value:
            if not all(low < high for low, high in zip(lower, upper)):
                raise ValueError(f"a box needs its lower corner below its upper one on each axis, got {lower}, {upper}")
        return value

    @model_validator(mode="after")
    def _consistent(self):
        if self.fidelity == "iss-numerical" and self.precision != "float64":
            raise ValueError(
                "precision must be 'float64' for fidelity 'iss-numerical': metres are differences of "
                "Earth-centred positions"
            )
        if self.horizon < self.dt * self.steps_per_action:
            raise ValueError("horizon must hold at least one action (dt * steps_per_action)")
        return self

    @property
    def decision_dt(self) -> float:
        """Seconds from one action to the next."""
        return self.dt * self.steps_per_action

    def to_toml(self) -> str:
        """The configuration as TOML text that `load_config` reads back."""
        return tomli_w.dumps(self.model_dump(mode="json"))


CONFIG_PRESETS: dict[str, dict[str, Any]] = {
    "data": {},
    "rl": {
        "reward": "rl",
        "steps_per_action": 20,
        "collision_terminates": False,
        "reset": {"radius_min": 100.0, "radius_max": 125.0},
    },
}
"""Named starting points: the paper's data generation, and its reinforcement learning set-up."""


def load_config(
    config: "DockingConfig | Mapping[str, Any] | str | os.PathLike | None" = None,
    preset: str = "data",
    **overrides: Any,
) -> DockingConfig:
    """Build a configuration from a preset, then a file or mapping, then keyword arguments, later ones winning.

    Args:
        config: a `DockingConfig`, a mapping of its fields, or the path of a TOML file.
        preset: a key of `CONFIG_PRESETS`.
        overrides: fields of `DockingConfig`; nested mappings are merged.

    Raises:
        ValueError: a field, preset or port is unknown (naming the nearest) or out of bounds; or the file or mapping
            is for another fidelity than the one named beside it.
        FileNotFoundError: `config` names no file.
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
    elif config is not None:
        with open(config, "rb") as file:
            try:
                given = tomllib.load(file)
            except tomllib.TOMLDecodeError as error:
                raise ValueError(f"config {os.fspath(config)!r} is not valid TOML: {error}") from None
    if (asked := given.get("fidelity")) != (named := overrides.get("fidelity", asked)) and asked is not None:
        raise ValueError(f"config is for fidelity {asked!r}, not {named!r}: make the environment id that goes with it")
    values = _merge(_merge(values, _expand(given)), _expand(overrides))
    _check_keys(values, DockingConfig, "")
    try:
        return DockingConfig.model_validate(values)
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc'])) or 'config'}: {e['msg']}" for e in error.errors()]
        raise ValueError("invalid configuration: " + "; ".join(lines)) from None


def unknown(kind: str, name: object, known) -> str:
    """An error message for an unknown name, suggesting the nearest known one."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {kind} {name!r}{hint} Known: {', '.join(known)}."


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
    return expanded


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
