"""The parts of a configuration: each a frozen table of numbers with units, bounds and the paper's values."""

import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

EARTH_RADIUS = 6_378_137.0
"""m, equatorial."""


def unit(name: str) -> Any:
    """Say in which unit an annotated number is, where `config show` and the JSON schema find it; "1" for none."""
    return Field(json_schema_extra={"unit": name})


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
HalfTurn = Annotated[float, Field(ge=0, le=180, allow_inf_nan=False), unit("deg")]
Degrees = Annotated[Finite, unit("deg")]
Number = Annotated[Finite, unit("1")]
Count = Annotated[int, Field(ge=0)]
Vector3 = tuple[Finite, Finite, Finite]
Vector6 = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
Box = tuple[Vector3, Vector3]
Range = tuple[Finite, Finite]
Factors = Annotated[tuple[Positive, Positive], unit("1")]
DegreeRange = Annotated[Range, unit("deg")]


class Frozen(BaseModel):
    """Immutable, without unknown fields; the text under a field describes it, and `repr` tells what is not default."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    def __repr_args__(self) -> list[tuple[str | None, Any]]:
        defaults = {name: field.get_default() for name, field in type(self).model_fields.items()}
        return [(name, value) for name, value in super().__repr_args__() if value != defaults.get(name)]


class BiasConfig(Frozen):
    """Time-correlated sensor error beside the white one: a first-order Gauss-Markov process on each axis.

    Sizes are total root-mean-square errors, stationary from the first observation; all zero for none.
    """

    position: Annotated[NonNegative, unit("m")] = 0.0
    velocity: Annotated[NonNegative, unit("m/s")] = 0.0
    attitude: Annotated[NonNegative, unit("rad")] = 0.0
    rate: Annotated[NonNegative, unit("rad/s")] = 0.0
    correlation_time: Annotated[float, Field(gt=0), unit("s")] = 300.0
    """Time over which the correlation falls to 1/e; inf for a constant bias over the episode."""


class NoiseConfig(Frozen):
    """Sensor noise as total root-mean-square errors: the norm of the error vector (paper, table of noise models)."""

    position: Annotated[NonNegative, unit("m")] = 0.0
    """Independent of range."""
    position_per_range: Annotated[NonNegative, unit("1")] = 0.0
    """Fraction of the true distance to the station origin, added to `position`."""
    velocity: Annotated[NonNegative, unit("m/s")] = 0.0
    attitude: Annotated[NonNegative, unit("rad")] = 0.0
    """Total rotation angle."""
    rate: Annotated[NonNegative, unit("rad/s")] = 0.0
    bias: BiasConfig = BiasConfig()


NOISE_PRESETS: dict[str, NoiseConfig] = {
    "none": NoiseConfig(),
    "cooperative": NoiseConfig(position=0.05, velocity=0.002, attitude=5e-5, rate=1e-5),
    "noncooperative": NoiseConfig(position_per_range=0.01, velocity=0.03, attitude=5e-5, rate=1e-5),
}


class RewardConfig(Frozen):
    """Weights, pseudo-Huber knees (`delta_*`) and scales (`sigma_*`) of the paper's reward."""

    position: Number = -0.5
    velocity: Number = -0.2
    attitude: Number = -0.2
    rate: Number = -0.1
    progress: Number = 0.0
    proximity: Number = 0.0
    alignment: Number = 0.0
    effort: Number = 0.0
    collision: Number = -1e6
    dock: Number = 10_000.0
    escape: Number = -10_000.0
    delta_position: Annotated[Positive, unit("m")] = 1.0
    sigma_position: Annotated[Positive, unit("m")] = 225.0
    delta_velocity: Annotated[Positive, unit("m/s")] = 0.1
    sigma_velocity: Annotated[Positive, unit("m/s")] = 5.0
    delta_attitude: Annotated[Positive, unit("rad")] = 0.05
    sigma_attitude: Annotated[Positive, unit("rad")] = 3.141592653589793
    delta_rate: Annotated[Positive, unit("rad/s")] = 0.005
    sigma_rate: Annotated[Positive, unit("rad/s")] = 0.05
    gate_far: Annotated[NonNegative, unit("1")] = 0.1
    """Weight of the rotational terms far from the port; 1 at it."""
    gate_distance: Annotated[Positive, unit("m")] = 25.0
    sigma_proximity: Annotated[Positive, unit("m")] = 1.0
    sigma_alignment: Annotated[Positive, unit("rad")] = 0.1


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


class ResetConfig(Frozen):
    """Distribution of episode starts: uniform magnitudes, isotropic directions, nose at the station origin."""

    radius_min: Annotated[Positive, unit("m")] = 100.0
    radius_max: Annotated[Positive, unit("m")] = 225.0
    attitude_error_deg: HalfTurn = 10.0
    """Greatest angle off the nose's direction."""
    speed: Annotated[NonNegative, unit("m/s")] = 0.1
    """Greatest station-relative speed."""
    rate: Annotated[NonNegative, unit("rad/s")] = 0.01
    """Greatest station-relative body rate."""
    epoch_window: Annotated[NonNegative, unit("s")] = 7 * 86_400.0
    """The start epoch is uniform over this window from the reference epoch."""

    @model_validator(mode="after")
    def _ordered(self):
        if self.radius_max < self.radius_min:
            raise ValueError(f"radius_max ({self.radius_max}) must be at least radius_min ({self.radius_min})")
        return self


class DockingTolerances(Frozen):
    """Docked means all four at once, station-relative."""

    position: Annotated[Positive, unit("m")] = 0.1
    speed: Annotated[Positive, unit("m/s")] = 0.5
    attitude_deg: Annotated[Positive, unit("deg")] = 5.0
    rate_deg: Annotated[Positive, unit("deg/s")] = 0.5


class ChiefConfig(Frozen):
    """The station's orbit at the reference epoch and its ballistic properties."""

    reference_epoch: str = "2026-08-01T00:00:00Z"
    """UTC, ISO 8601."""
    semi_major_axis: Annotated[float, Field(gt=EARTH_RADIUS, allow_inf_nan=False), unit("m")] = 6_795_000.0
    eccentricity: Annotated[float, Field(ge=0, lt=1), unit("1")] = 0.0005
    inclination_deg: Degrees = 51.64
    raan_deg: Degrees = 0.0
    argument_of_perigee_deg: Degrees = 0.0
    mean_anomaly_deg: Degrees = 0.0
    secular_drift: bool = True
    """Node, perigee and mean anomaly drift at their mean rates under J2 from the reference epoch to an episode's
    start, so that the angle between Sun and orbit changes over the window of epochs."""
    mass: Annotated[Positive, unit("kg")] = 419_700.0
    drag_area: Annotated[NonNegative, unit("m2")] = 1500.0
    drag_coefficient: Annotated[NonNegative, unit("1")] = 2.2

    @field_validator("reference_epoch", mode="before")
    @classmethod
    def _a_date(cls, value):
        # An unquoted date in TOML comes as Python's own; without an offset it is UTC.
        if isinstance(value, datetime.datetime):
            given = value.replace(tzinfo=value.tzinfo or datetime.UTC).astimezone(datetime.UTC)
            return given.isoformat().replace("+00:00", "Z")
        if isinstance(value, datetime.date):
            return f"{value.isoformat()}T00:00:00Z"
        try:
            datetime.datetime.fromisoformat(value)
        except (TypeError, ValueError):
            came = value if isinstance(value, datetime.time) else repr(value)
            raise ValueError(f"must be a date and time, such as 2026-08-01T00:00:00Z, got {came}") from None
        return value


class ChaserConfig(Frozen):
    """The Dragon-class chaser and its thrusters."""

    mass: Annotated[Positive, unit("kg")] = 12_000.0
    inertia: Annotated[tuple[Positive, Positive, Positive], unit("kg m2")] = (80_000.0, 80_000.0, 50_000.0)
    """Principal moments about the body axes."""
    drag_area: Annotated[NonNegative, unit("m2")] = 50.0
    drag_coefficient: Annotated[NonNegative, unit("1")] = 2.2
    radius: Annotated[Positive, unit("m")] = 2.25
    """Of the bounding sphere."""
    force_limit: Annotated[Positive, unit("N")] = 1600.0
    """Per body axis."""
    torque_limit: Annotated[Positive, unit("N m")] = 2000.0
    """Per body axis."""
    thrust_scale: Annotated[Vector6, unit("1")] = (1.0,) * 6
    """Delivered over commanded wrench, per axis."""
    misalignment: Annotated[Vector3, unit("rad")] = (0.0, 0.0, 0.0)
    """Rotation vector from the commanded to the delivered wrench's axes."""
    actuation_delay: Annotated[Count, unit("steps")] = 0
    """Simulation steps between command and delivery."""
    thrusters: Literal["proportional", "on_off"] = "proportional"
    """Whether a wrench is delivered as commanded, or as pulses of whole quanta (`task.actuators`)."""
    thruster_force: Annotated[Positive, unit("N")] = 400.0
    """Least force of on-off thrusters along an axis; they deliver whole multiples."""
    thruster_torque: Annotated[Positive, unit("N m")] = 500.0
    """Least torque of on-off thrusters about an axis."""
    minimum_on_time: Annotated[NonNegative, unit("s")] = 0.05
    """Least length of a pulse of on-off thrusters; rounded up to whole simulation steps, at least one."""

    @model_validator(mode="after")
    def _thrusters_within_limits(self):
        if self.thrusters == "on_off":
            for quantum, limit in (("thruster_force", "force_limit"), ("thruster_torque", "torque_limit")):
                if getattr(self, quantum) > getattr(self, limit):
                    raise ValueError(
                        f"{quantum} ({getattr(self, quantum)}) must be at most {limit} ({getattr(self, limit)})"
                    )
        return self


def low_then_high(value: Range) -> Range:
    """A range whose low end comes first; ValueError otherwise."""
    if value[0] > value[1]:
        raise ValueError(f"a range needs its low end first, got {value}")
    return value


class CameraRanges(Frozen):
    """Ranges (low, high) of light and look, drawn as those of `RandomizationConfig`; for environments with pixels."""

    sun_scale: Factors = (1.0, 1.0)
    earthshine_scale: Factors = (1.0, 1.0)
    lamp_scale: Factors = (1.0, 1.0)
    exposure: Annotated[Range, unit("stops")] = (0.0, 0.0)
    """Added to the camera's."""
    offset: Annotated[tuple[NonNegative, NonNegative], unit("m")] = (0.0, 0.0)
    """Distance by which the camera stands elsewhere; isotropic direction."""
    tilt_deg: tuple[HalfTurn, HalfTurn] = (0.0, 0.0)
    """Angle by which it looks elsewhere; isotropic axis."""
    field_scale: Factors = (1.0, 1.0)
    """Of the field of view."""
    albedo_scale: Factors = (1.0, 1.0)
    """Per material; none throws back more than all light."""

    @field_validator("*")
    @classmethod
    def _low_then_high(cls, value):
        return low_then_high(value)

    @property
    def active(self) -> bool:
        """Whether anything is drawn."""
        return self != CameraRanges()


class RandomizationConfig(Frozen):
    """Ranges (low, high) of what is drawn anew for each episode, uniformly and by itself.

    Factors multiply the configured number, the rest is added to it; a degenerate range draws its one value. While
    every range is at its default nothing is drawn. The numbers are traced: other ranges need no new program, as long
    as the sum of `chaser.actuation_delay` and the longest drawn delay stays the same.
    """

    mass_scale: Factors = (1.0, 1.0)
    inertia_scale: Factors = (1.0, 1.0)
    """Per principal axis."""
    thrust_scale: Annotated[Range, unit("1")] = (1.0, 1.0)
    """Per axis of the wrench."""
    misalignment_deg: tuple[HalfTurn, HalfTurn] = (0.0, 0.0)
    """Angle by which the delivered wrench is turned, besides `chaser.misalignment`; isotropic axis."""
    actuation_delay: Annotated[tuple[Count, Count], unit("steps")] = (0, 0)
    """Whole simulation steps, both ends included."""
    chief_semi_major_axis: Annotated[Range, unit("m")] = (0.0, 0.0)
    chief_eccentricity: Annotated[Range, unit("1")] = (0.0, 0.0)
    chief_inclination_deg: DegreeRange = (0.0, 0.0)
    chief_raan_deg: DegreeRange = (0.0, 0.0)
    chief_argument_of_perigee_deg: DegreeRange = (0.0, 0.0)
    chief_mean_anomaly_deg: DegreeRange = (0.0, 0.0)
    camera: CameraRanges = CameraRanges()

    @field_validator("*")
    @classmethod
    def _low_then_high(cls, value):
        return value if isinstance(value, CameraRanges) else low_then_high(value)

    @property
    def active(self) -> bool:
        """Whether anything of vehicle or orbit is drawn."""
        return self.model_copy(update={"camera": CameraRanges()}) != RandomizationConfig()


class ForceConfig(Frozen):
    """Perturbations of `iss-numerical`."""

    zonal_degree: Literal[0, 2, 3, 4, 5, 6] = 4
    sun: bool = True
    moon: bool = True
    drag: bool = True
