"""The planner's numbers: a frozen configuration, split into static and traced."""

from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Array, Float
from pydantic import Field, field_validator, model_validator

from owm_envs.config.parts import Frozen, within
from owm_envs.words import unknown

Objective = Literal["geodesic", "straight", "plain", "safe"]
Weight = Annotated[float, within(0, 1e6)]
Scale = Annotated[float, within(1e-6, 1e6)]
Sigma = Annotated[float, within(1e-6, 10)]
Fraction = Annotated[float, within(0, 1)]
Length = Annotated[int, Field(gt=0, le=10**4)]


class Weights(NamedTuple):
    """Weights and knees of the objective; every leaf is traced. Meanings and units as in `PlannerConfig`."""

    position: Float[Array, ""]
    position_knee: Float[Array, ""]
    velocity: Float[Array, ""]
    attitude: Float[Array, ""]
    rate: Float[Array, ""]
    effort: Float[Array, ""]
    clearance: Float[Array, ""]
    margin: Float[Array, ""]
    collision: Float[Array, ""]
    top_speed: Float[Array, ""]
    braking: Float[Array, ""]
    closing_time: Float[Array, ""]
    crawl: Float[Array, ""]
    crawl_per_clearance: Float[Array, ""]
    top_rate: Float[Array, ""]
    rate_braking: Float[Array, ""]
    turning_time: Float[Array, ""]
    stopping: Float[Array, ""]
    tracking_velocity: Float[Array, ""]
    tracking_position: Float[Array, ""]
    drift: Float[Array, ""]


class Tuning(NamedTuple):
    """Every number of the planner that may be swept without compiling again."""

    weights: Weights
    temperature: Float[Array, ""]
    sigma: Float[Array, "6"]
    """Noise of force and torque, fractions of the limits."""
    sigma_near: Float[Array, ""]
    sigma_distance: Float[Array, ""]
    gain: Float[Array, ""]
    drift_gain: Float[Array, ""]
    limit: Float[Array, "6"]
    """Force and torque limits, N and N m."""


class Shape(NamedTuple):
    """The static part: what the compiled program is shaped by."""

    candidates: int
    horizon: int
    chunk: int
    latency: int
    knots: int
    objective: str


class PlannerConfig(Frozen):
    """Model predictive path integral control as this package flies it.

    Candidates, horizon, chunk and temperature are the paper's; the rest come from prototypes that flew all eight ports
    among an approximate hull. Checked again on the train ports alone, with the station's own hull, `iss-numerical` and
    cooperative noise: perfect dynamics dock at every flight with the defaults, with half and twice the noise, and at
    temperature 0.05; at temperature 1 at four fifths. Chosen again there with a least-squares model, 30 flights from
    other seeds (`trials(TRAIN_PORTS, 6, seed=101)`), full conditions, median time and least clearance: defaults 100 %,
    98 s, 1.44 m; noise halved 87 %, 172 s, 0.65 m, doubled 100 %, 101 s, 1.24 m; velocity weight halved 100 %, 103 s,
    1.02 m, doubled 100 %, 103 s, 1.36 m; braking 0.05 m/s2 100 %, 101 s, 1.42 m, 0.11 m/s2 100 %, 93 s, 1.39 m. The
    defaults stay: only the last is faster, and it takes more of the thrust than an off-nominal chaser has to spare.
    """

    candidates: Annotated[int, Field(gt=0, le=2**20)] = 128
    """K, action sequences a replan; the first is the warm start itself. Source: paper."""
    horizon: Length = 64
    """Model steps a candidate looks ahead. Source: paper."""
    chunk: Length = 8
    """Steps executed open-loop between replans. Source: paper."""
    latency: Annotated[int, Field(ge=0, le=10**4)] = 0
    """Steps from the measurement of a replan to the first action planned from it, less than `chunk`: those before it
    were planned at the last replan, or are zero. With it a flight may take that long to compute a plan."""
    temperature: Scale = 0.3
    """lambda of the softmax over candidates, in units of the cost. Source: paper."""
    knots: Annotated[int, Field(ge=2, le=10**4)] = 9
    """Independent draws along the horizon, joined linearly. Prototype: 4 to 17 make no difference."""
    force_sigma: Sigma = 0.20
    """Noise, fraction of the force limit. Prototype: 0.5 with torque 0.3 never docks."""
    torque_sigma: Sigma = 0.05
    """Noise, fraction of the torque limit. Prototype."""
    sigma_near: Sigma = 0.5
    """Both are scaled by min(1, sigma_near + (1 - sigma_near) d / sigma_distance), d to the goal."""
    sigma_distance: Scale = 10.0
    """m. Prototype."""

    objective: Objective = "geodesic"
    """"geodesic": distance and speed profile along the geodesic field; "straight": the same along the
    straight line; "plain": quadratic in all four errors to the goal, no profile; "safe": errors to the safe approach
    (`owm_envs.policies.guidance`), and what free drifts lack of clearance."""
    position: Weight = 0.9
    """Weight of the (geodesic) distance, 1/m; 1/m2 when plain. Prototype, as all weights."""
    position_knee: Scale = 0.1
    """m; the distance is quadratic below it."""
    velocity: Weight = 3.0
    """Weight of the squared velocity error to the profile, s2/m2."""
    attitude: Weight = 6.0
    """Weight of the angle to the goal attitude, 1/rad; 1/rad2 when plain."""
    rate: Weight = 900.0
    """Weight of the squared rate error to the profile, s2/rad2."""
    effort: Weight = 0.03
    """Weight of the squared wrench in fractions of the limits."""
    clearance: Weight = 30.0
    """Weight of the squared shortfall of hull clearance below `margin`, 1/m2."""
    margin: Weight = 1.0
    """m, between bounding sphere and hull."""
    collision: Weight = 1000.0
    """Cost of touching the hull, times one plus the fraction of the horizon that remains; with 0 and
    clearance 0 the planner is blind to the hull."""
    top_speed: Scale = 4.0
    """m/s; the wanted speed is the least of this and the next three. Prototype, as all of the profile."""
    braking: Scale = 0.08
    """m/s2: sqrt(braking * distance), about two thirds of what the thrusters give (0.133 m/s2 an axis)."""
    closing_time: Scale = 4.0
    """s: distance / closing_time."""
    crawl: Scale = 0.4
    """m/s: crawl + crawl_per_clearance * clearance."""
    crawl_per_clearance: Weight = 0.25
    """1/s."""
    top_rate: Scale = 0.05
    """rad/s; the wanted rate is the least of this, sqrt(rate_braking * angle) and angle / turning_time."""
    rate_braking: Scale = 0.02
    """rad/s2."""
    turning_time: Scale = 5.0
    """s."""
    stopping: Weight = 10.0
    """Weight of the squared speed at the horizon's end beyond what can be braked to rest over the distance that is left
    then, by the acceleration that the model gives the thrusters in any direction, s2/m2; not when plain. On the train
    ports, from other seeds, with 70 % thrust to brake with and a model fitted in flight, it raised the least clearance
    from 0.7 to 1.4 m and cost no time; 3 does as well."""

    tracking_velocity: Weight = 25.0
    """Weight of the squared error to the reference's velocity, s2/m2; only when safe, as the next two. Chosen on 24
    flights of seeds of their own; 8 to 50 do as well."""
    tracking_position: Weight = 1.5
    """Weight of the squared distance from the reference, 1/m2."""
    drift: Weight = 3.0
    """Weight of the metres by which free drifts from a candidate fall short of the clearance that they should keep,
    1/m. With 0 a coast beyond 10 m of the hull is clear in 99.4 % of instants instead of 99.9 %."""

    corrector: bool = True
    """Make what the model keeps getting wrong over its chunks additive accelerations and a drift."""
    gain: Fraction = 0.4
    """Weight of a chunk's error in the mean error of acceleration. Prototype: 0.3 to 0.6 work."""
    drift_gain: Fraction = 0.12
    """The same for the drift of position. Prototype: 0.3 of `gain`."""

    @field_validator("objective", mode="before")
    @classmethod
    def _known_objective(cls, value):
        if value not in get_args(Objective):
            raise ValueError(unknown("objective", value, get_args(Objective)))
        return value

    @model_validator(mode="after")
    def _consistent(self) -> "PlannerConfig":
        if self.chunk > self.horizon:
            raise ValueError(f"chunk must not exceed horizon={self.horizon}, got {self.chunk}")
        if self.latency >= self.chunk:
            raise ValueError(f"latency must be less than chunk={self.chunk}, got {self.latency}")
        if self.knots > self.horizon:
            raise ValueError(f"knots must not exceed horizon={self.horizon}, got {self.knots}")
        return self

    @property
    def shape(self) -> Shape:
        """The static part."""
        return Shape(**{name: getattr(self, name) for name in Shape._fields})

    def tuning(self, wrench_limit: tuple[float, ...], dtype: str = "float32") -> Tuning:
        """The traced part, for a vehicle's force and torque limits (6,) [N, N m]."""
        real = np.dtype(dtype).type
        return Tuning(
            weights=Weights(**{name: real(getattr(self, name)) for name in Weights._fields}),
            temperature=real(self.temperature),
            sigma=np.asarray([self.force_sigma] * 3 + [self.torque_sigma] * 3, real),
            sigma_near=real(self.sigma_near),
            sigma_distance=real(self.sigma_distance),
            gain=real(self.gain if self.corrector else 0),
            drift_gain=real(self.drift_gain if self.corrector else 0),
            limit=np.asarray(wrench_limit, real),
        )
