"""The parts of a configuration: each a frozen table of numbers with units, bounds and the paper's values."""

import datetime
import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from owm_envs.words import short

EARTH_RADIUS = 6_378_137.0
"""m, equatorial."""


def unit(name: str) -> Any:
    """Say in which unit an annotated number is, where `config show` and the JSON schema find it; "1" for none."""
    return Field(json_schema_extra={"unit": name})


def within(least: float, most: float) -> Any:
    """Bound an annotated number, both ends included: by what a vehicle, an orbit or a camera can be.

    Within all of the bounds of a configuration resets and steps come to numbers, in single precision too; a test sees
    to it. The smallest positive ones keep a division from running over.
    """
    return Field(ge=least, le=most, allow_inf_nan=False)


Length = Annotated[float, within(1e-3, 1e6), unit("m")]
Spread = Annotated[float, within(0, 1e6), unit("m")]
Speed = Annotated[float, within(0, 1e3), unit("m/s")]
Turning = Annotated[float, within(0, 100), unit("rad/s")]
Turn = Annotated[float, within(0, math.pi), unit("rad")]
HalfTurn = Annotated[float, within(0, 180), unit("deg")]
Degrees = Annotated[float, within(-3600, 3600), unit("deg")]
Area = Annotated[float, within(0, 1e5), unit("m2")]
Coefficient = Annotated[float, within(0, 10), unit("1")]
Weight = Annotated[float, within(-1e8, 1e8), unit("1")]
Coordinate = Annotated[float, within(-1e6, 1e6)]
Angle = Annotated[float, within(-math.pi, math.pi)]
Share = Annotated[float, within(-10, 10)]
"""Of a command that is delivered; negative if it is turned round."""
Force = Annotated[float, within(1e-3, 1e7), unit("N")]
Torque = Annotated[float, within(1e-3, 1e7), unit("N m")]
Inertia = Annotated[float, within(0.1, 1e10)]
Stops = Annotated[float, within(-30, 30), unit("stops")]
Offset = Annotated[float, within(0, 1e3)]
Eccentricity = Annotated[float, within(-1, 1)]
"""Added to another."""
Delay = Annotated[int, Field(ge=0, le=10_000)]
Time = Annotated[float, within(0, 1e7)]
Factor = Annotated[float, within(1e-3, 1e3)]
Factors = Annotated[tuple[Factor, Factor], unit("1")]
DegreeRange = tuple[Degrees, Degrees]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Box = tuple[Vector3, Vector3]


class Frozen(BaseModel):
    """Immutable, without unknown fields; the text under a field describes it, and `repr` tells what is not default."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _numbers(cls, value: Any, info: ValidationInfo) -> Any:
        """Truth is no number here, as it is to Python; nor is a whole number that is beyond every float."""
        if cls.model_fields[info.field_name].annotation is not bool:
            _refuse_no_numbers(value)
        return value

    def __repr_args__(self) -> list[tuple[str | None, Any]]:
        defaults = {name: field.get_default() for name, field in type(self).model_fields.items()}
        return [(name, value) for name, value in super().__repr_args__() if value != defaults.get(name)]


def _refuse_no_numbers(value: Any) -> None:
    if isinstance(value, list | tuple):
        for each in value:
            _refuse_no_numbers(each)
    elif type(value).__name__ in ("bool", "bool_"):  # NumPy's too
        raise ValueError(f"must be no truth value, got {value}")
    elif isinstance(value, int) and abs(value) >= 2**1000:
        raise ValueError(f"must be less than 2**1000 in size, got {short(value)}")


class BiasConfig(Frozen):
    """Time-correlated sensor error beside the white one: a first-order Gauss-Markov process on each axis.

    Sizes are total root-mean-square errors, stationary from the first observation; all zero for none.
    """

    position: Spread = 0.0
    velocity: Speed = 0.0
    attitude: Turn = 0.0
    rate: Turning = 0.0
    correlation_time: Annotated[float, Field(ge=1e-3, allow_inf_nan=True), unit("s")] = 300.0
    """Time over which the correlation falls to 1/e; inf for a constant bias over the episode."""


class NoiseConfig(Frozen):
    """Sensor noise as total root-mean-square errors: the norm of the error vector (paper, table of noise models)."""

    position: Spread = 0.0
    """Independent of range."""
    position_per_range: Coefficient = 0.0
    """Fraction of the true distance to the station origin, added to `position`."""
    velocity: Speed = 0.0
    attitude: Turn = 0.0
    """Total rotation angle."""
    rate: Turning = 0.0
    bias: BiasConfig = BiasConfig()


NOISE_PRESETS: dict[str, NoiseConfig] = {
    "none": NoiseConfig(),
    "cooperative": NoiseConfig(position=0.05, velocity=0.002, attitude=5e-5, rate=1e-5),
    "noncooperative": NoiseConfig(position_per_range=0.01, velocity=0.03, attitude=5e-5, rate=1e-5),
}


class NavigationConfig(Frozen):
    """What goes wrong with relative navigation, on top of its noise; by default nothing does."""

    outage_duration: Annotated[float, within(1e-2, 1e6), unit("s")] = 10.0
    """Of each time that navigation is quiet."""
    outage_share: Annotated[float, within(0, 0.9), unit("1")] = 0.0
    """Of the time that navigation is quiet; when is drawn for each episode (`task.navigation.is_quiet`)."""
    outlier_share: Annotated[float, within(0, 1), unit("1")] = 0.0
    """Of measurements whose white errors are `outlier_scale` times as large (`task.navigation.outlier_factor`)."""
    outlier_scale: Annotated[float, within(1, 1e3), unit("1")] = 20.0

    @property
    def quiet(self) -> bool:
        """Whether navigation is ever quiet."""
        return self.outage_share > 0

    @property
    def heavy_tailed(self) -> bool:
        """Whether there are outliers."""
        return self.outlier_share > 0


class RewardConfig(Frozen):
    """Weights, pseudo-Huber knees (`delta_*`) and scales (`sigma_*`) of the paper's reward."""

    position: Weight = -0.5
    velocity: Weight = -0.2
    attitude: Weight = -0.2
    rate: Weight = -0.1
    progress: Weight = 0.0
    proximity: Weight = 0.0
    alignment: Weight = 0.0
    effort: Weight = 0.0
    collision: Weight = -1e6
    dock: Weight = 10_000.0
    escape: Weight = -10_000.0
    delta_position: Annotated[float, within(1e-6, 1e6), unit("m")] = 1.0
    sigma_position: Annotated[float, within(1e-6, 1e6), unit("m")] = 225.0
    delta_velocity: Annotated[float, within(1e-6, 1e6), unit("m/s")] = 0.1
    sigma_velocity: Annotated[float, within(1e-6, 1e6), unit("m/s")] = 5.0
    delta_attitude: Annotated[float, within(1e-6, 1e6), unit("rad")] = 0.05
    sigma_attitude: Annotated[float, within(1e-6, 1e6), unit("rad")] = 3.141592653589793
    delta_rate: Annotated[float, within(1e-6, 1e6), unit("rad/s")] = 0.005
    sigma_rate: Annotated[float, within(1e-6, 1e6), unit("rad/s")] = 0.05
    gate_far: Annotated[float, within(0, 1e3), unit("1")] = 0.1
    """Weight of the rotational terms far from the port; 1 at it."""
    gate_distance: Length = 25.0
    sigma_proximity: Length = 1.0
    sigma_alignment: Annotated[float, within(1e-6, 1e6), unit("rad")] = 0.1


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

    radius_min: Annotated[float, within(1e-3, 1e5), unit("m")] = 100.0
    radius_max: Annotated[float, within(1e-3, 1e5), unit("m")] = 225.0
    attitude_error_deg: HalfTurn = 10.0
    """Greatest angle off the nose's direction."""
    speed: Speed = 0.1
    """Greatest station-relative speed."""
    rate: Turning = 0.01
    """Greatest station-relative body rate."""
    epoch_window: Annotated[float, within(0, 10 * 366 * 86_400), unit("s")] = 7 * 86_400.0
    """The start epoch is uniform over this window from the reference epoch."""

    @model_validator(mode="after")
    def _ordered(self):
        if self.radius_max < self.radius_min:
            raise ValueError(f"radius_max ({self.radius_max}) must be at least radius_min ({self.radius_min})")
        return self


class DockingTolerances(Frozen):
    """Docked means all four at once, station-relative."""

    position: Annotated[float, within(1e-6, 1e3), unit("m")] = 0.1
    speed: Annotated[float, within(1e-6, 1e3), unit("m/s")] = 0.5
    attitude_deg: Annotated[float, within(1e-6, 180), unit("deg")] = 5.0
    rate_deg: Annotated[float, within(1e-6, 6000), unit("deg/s")] = 0.5


class ChiefConfig(Frozen):
    """The station's orbit at the reference epoch and its ballistic properties."""

    reference_epoch: str = "2026-08-01T00:00:00Z"
    """UTC, ISO 8601."""
    semi_major_axis: Annotated[float, Field(gt=EARTH_RADIUS, le=1e8, allow_inf_nan=False), unit("m")] = 6_795_000.0
    eccentricity: Annotated[float, Field(ge=0, lt=1), unit("1")] = 0.0005
    inclination_deg: Degrees = 51.64
    raan_deg: Degrees = 0.0
    argument_of_perigee_deg: Degrees = 0.0
    mean_anomaly_deg: Degrees = 0.0
    secular_drift: bool = True
    """Node, perigee and mean anomaly drift at their mean rates under J2 from the reference epoch to an episode's
    start, so that the angle between Sun and orbit changes over the window of epochs."""
    mass: Annotated[float, within(1e3, 1e8), unit("kg")] = 419_700.0
    drag_area: Area = 1500.0
    drag_coefficient: Coefficient = 2.2

    @field_validator("reference_epoch", mode="before")
    @classmethod
    def _a_date(cls, value):
        # An unquoted date in TOML comes as Python's own; without an offset it is UTC.
        told = value
        if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
            value = told = f"{value.isoformat()}T00:00:00Z"
        try:
            given = value if isinstance(value, datetime.datetime) else datetime.datetime.fromisoformat(value)
        except (TypeError, ValueError):
            came = value if isinstance(value, datetime.time) else short(value)
            raise ValueError(f"must be a date and time, such as 2026-08-01T00:00:00Z, got {came}") from None
        if not 1900 <= given.year < 2100:  # where Sun and Moon are known
            raise ValueError(f"must lie from 1900 to 2099, got {told}")
        if isinstance(value, str):
            return value
        given = given.replace(tzinfo=given.tzinfo or datetime.UTC).astimezone(datetime.UTC)
        return given.isoformat().replace("+00:00", "Z")


TurnRate = Annotated[float, within(-360, 360)]
TurnSpeed = Annotated[float, within(0, 360)]


class TargetConfig(Frozen):
    """What flies in the station's place, if it has an attitude of its own or another place to dock at.

    The station frame is then the target's own: views, hull and goals are in its axes.
    """

    rate_deg: Annotated[tuple[TurnRate, TurnRate, TurnRate], unit("deg/s")] = (0.0, 0.0, 0.0)
    """Rate, in its own axes, at which it turns in the frame of the orbit. At an episode's start both frames agree."""
    hold: Annotated[Vector3 | None, unit("m")] = None
    """Where a docking chaser holds, its nose to the origin: the goal in place of every port's. None for the ports."""

    @property
    def turns(self) -> bool:
        """Whether it turns as configured."""
        return any(self.rate_deg)

    @field_validator("hold")
    @classmethod
    def _off_the_origin(cls, value):
        if value is not None and math.hypot(*value) < 1e-3:
            raise ValueError("must be away from the origin, where the nose points")
        return value


Side = Annotated[int, Field(ge=-1, le=1)]
Leak = Annotated[float, within(-1e6, 1e6)]


class FaultConfig(Frozen):
    """What goes wrong with the thrusters in flight, on top of the chaser's own errors; by default nothing does."""

    time: Annotated[float, within(0, 1e7), unit("s")] = 0.0
    """Since the episode's start, when it sets in."""
    thrust_scale: Annotated[tuple[Share, Share, Share, Share, Share, Share], unit("1")] = (1.0,) * 6
    """What is left of each axis of the wrench; 0 for a dead one."""
    one_sided: Annotated[tuple[Side, Side, Side, Side, Side, Side], unit("1")] = (0,) * 6
    """Axes that push one way only: 1 delivers no negative command, -1 no positive one, 0 both."""
    leak: Annotated[tuple[Leak, Leak, Leak, Leak, Leak, Leak], unit("N, N m")] = (0.0,) * 6
    """Delivered whatever is commanded, as by a jet that is stuck open."""
    misalignment: Annotated[tuple[Angle, Angle, Angle], unit("rad")] = (0.0, 0.0, 0.0)
    """Rotation vector by which the wrench is turned besides `chaser.misalignment`."""

    @property
    def active(self) -> bool:
        """Whether anything ever goes wrong."""
        return self.model_copy(update={"time": 0.0}) != FaultConfig()


class FlexibleConfig(Frozen):
    """What swings in or on the chaser, beside the mass and inertia of its rigid part (`task.flexible`)."""

    slosh_mass: Annotated[float, within(0, 1e6), unit("kg")] = 0.0
    """Of fuel that sloshes along each body axis; 0 for none."""
    slosh_frequency: Annotated[float, within(1e-3, 10), unit("Hz")] = 0.3
    """Of the fuel in a tank held fast."""
    slosh_damping: Annotated[float, within(0, 0.1), unit("1")] = 0.01
    """Ratio to the critical one."""
    array_inertia: Annotated[float, within(0, 1e7), unit("kg m2")] = 0.0
    """Of arrays that bend about each body axis; 0 for none."""
    array_frequency: Annotated[float, within(1e-3, 10), unit("Hz")] = 0.2
    """Of arrays on a body held fast."""
    array_damping: Annotated[float, within(0, 0.1), unit("1")] = 0.01
    """Ratio to the critical one."""

    @property
    def active(self) -> bool:
        """Whether anything swings."""
        return self.slosh_mass > 0 or self.array_inertia > 0


class PlumeConfig(Frozen):
    """What jets near the hull push the chaser back with (`task.plume`); by default nothing."""

    strength: Annotated[float, within(0, 10), unit("1")] = 0.0
    """Push over thrust of a jet straight at the hull, at contact; 0 for none."""
    reach: Length = 5.0
    """Clearance at which the push has fallen to a quarter."""


class ChaserConfig(Frozen):
    """The Dragon-class chaser and its thrusters."""

    mass: Annotated[float, within(1, 1e7), unit("kg")] = 12_000.0
    inertia: Annotated[tuple[Inertia, Inertia, Inertia], unit("kg m2")] = (80_000.0, 80_000.0, 50_000.0)
    """Principal moments about the body axes."""
    drag_area: Area = 50.0
    drag_coefficient: Coefficient = 2.2
    radius: Annotated[float, within(1e-3, 1e3), unit("m")] = 2.25
    """Of the bounding sphere."""
    force_limit: Force = 1600.0
    """Per body axis."""
    torque_limit: Torque = 2000.0
    """Per body axis."""
    thrust_scale: Annotated[tuple[Share, Share, Share, Share, Share, Share], unit("1")] = (1.0,) * 6
    """Delivered over commanded wrench, per axis."""
    misalignment: Annotated[tuple[Angle, Angle, Angle], unit("rad")] = (0.0, 0.0, 0.0)
    """Rotation vector from the commanded to the delivered wrench's axes."""
    actuation_delay: Annotated[Delay, unit("steps")] = 0
    """Simulation steps between command and delivery."""
    delay_growth: Annotated[Delay, unit("steps")] = 0
    """Added to the delay as the feed pressure sags, all of it after long thrust (`task.actuators`); 0 for none."""
    sag_time: Annotated[float, within(1e-2, 1e4), unit("s")] = 5.0
    """In which the pressure follows the thrust, by 1 - 1/e."""
    thrusters: Literal["proportional", "on_off"] = "proportional"
    """Whether a wrench is delivered as commanded, or as pulses of whole quanta (`task.actuators`)."""
    thruster_force: Force = 400.0
    """Least force of on-off thrusters along an axis; they deliver whole multiples."""
    thruster_torque: Torque = 500.0
    """Least torque of on-off thrusters about an axis."""
    minimum_on_time: Annotated[float, within(0, 1e3), unit("s")] = 0.05
    """Least length of a pulse of on-off thrusters; rounded up to whole simulation steps, at least one."""
    hysteresis: Annotated[float, within(0, 1), unit("1")] = 0.0
    """Of the valves: share of the limits by which a command must leave what they deliver before they follow."""
    flexible: FlexibleConfig = FlexibleConfig()
    plume: PlumeConfig = PlumeConfig()
    fault: FaultConfig = FaultConfig()

    @model_validator(mode="after")
    def _thrusters_within_limits(self):
        if self.thrusters == "on_off":
            for quantum, limit in (("thruster_force", "force_limit"), ("thruster_torque", "torque_limit")):
                if getattr(self, quantum) > getattr(self, limit):
                    raise ValueError(
                        f"{quantum} ({getattr(self, quantum)}) must be at most {limit} ({getattr(self, limit)})"
                    )
        return self


def low_then_high(value: tuple) -> tuple:
    """A range whose low end comes first; ValueError otherwise."""
    if value[0] > value[1]:
        raise ValueError(f"a range needs its low end first, got {value}")
    return value


class CameraRanges(Frozen):
    """Ranges (low, high) of light and look, drawn as those of `RandomizationConfig`; for environments with pixels."""

    sun_scale: Factors = (1.0, 1.0)
    earthshine_scale: Factors = (1.0, 1.0)
    lamp_scale: Factors = (1.0, 1.0)
    exposure: tuple[Stops, Stops] = (0.0, 0.0)
    """Added to the camera's."""
    offset: Annotated[tuple[Offset, Offset], unit("m")] = (0.0, 0.0)
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
    as the sum of `chaser.actuation_delay`, `chaser.delay_growth` and the longest drawn delay stays the same.
    """

    mass_scale: Factors = (1.0, 1.0)
    inertia_scale: Factors = (1.0, 1.0)
    """Per principal axis."""
    thrust_scale: Annotated[tuple[Share, Share], unit("1")] = (1.0, 1.0)
    """Per axis of the wrench."""
    misalignment_deg: tuple[HalfTurn, HalfTurn] = (0.0, 0.0)
    """Angle by which the delivered wrench is turned, besides `chaser.misalignment`; isotropic axis."""
    actuation_delay: Annotated[tuple[Delay, Delay], unit("steps")] = (0, 0)
    """Whole simulation steps, both ends included."""
    fault_time: Annotated[tuple[Time, Time], unit("s")] = (0.0, 0.0)
    """Added to `chaser.fault.time`."""
    fault_scale: Annotated[tuple[Share, Share], unit("1")] = (1.0, 1.0)
    """What the fault leaves of one axis of force, which is drawn too."""
    fault_misalignment_deg: tuple[HalfTurn, HalfTurn] = (0.0, 0.0)
    """Angle by which the fault turns the wrench, besides `chaser.fault.misalignment`; isotropic axis."""
    target_rate_deg: Annotated[tuple[TurnSpeed, TurnSpeed], unit("deg/s")] = (0.0, 0.0)
    """Added to `target.rate_deg`; isotropic axis."""
    chief_semi_major_axis: Annotated[tuple[Coordinate, Coordinate], unit("m")] = (0.0, 0.0)
    chief_eccentricity: Annotated[tuple[Eccentricity, Eccentricity], unit("1")] = (0.0, 0.0)
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
    def faulty(self) -> bool:
        """Whether a fault is drawn."""
        return self.fault_scale != (1.0, 1.0) or self.fault_misalignment_deg != (0.0, 0.0)

    @property
    def turning(self) -> bool:
        """Whether a rate of the target is drawn."""
        return self.target_rate_deg != (0.0, 0.0)

    @property
    def active(self) -> bool:
        """Whether anything of vehicle, target or orbit is drawn."""
        return self.model_copy(update={"camera": CameraRanges()}) != RandomizationConfig()


class ForceConfig(Frozen):
    """Perturbations of `iss-numerical`."""

    zonal_degree: Literal[0, 2, 3, 4, 5, 6] = 4
    sun: bool = True
    moon: bool = True
    drag: bool = True
