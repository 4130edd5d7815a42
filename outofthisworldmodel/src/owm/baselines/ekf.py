"""An error-state extended Kalman filter on the equations of motion: what a navigation engineer would predict with.

The error has the 12 components of `view_error`: position m and velocity m/s in the station frame, a rotation vector rad
and a rate rad/s in body axes; attitude is corrected multiplicatively. Source: Markley and Crassidis (2014),
Fundamentals of Spacecraft Attitude Determination and Control, sec. 6.2. The filter is `astrojax.estimate`'s.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from astrojax.estimate import Gaussian, ekf_predict, joseph_update, normalized_square
from owm.baselines.exact import ExactDynamics, ExactParams
from owm.interface import History
from owm.motion.kinematics import displaced, view_error
from owm_envs.config import DockingConfig, Fidelity, load_config
from owm_envs.config.params import NoiseParams, params_from_config
from owm_envs.task.sensors import STATE
from owm_envs.view import View

HELD_COMMANDS = (5e-5, 5e-6, 2e-6, 1e-7)
"""Errors of a 0.25 s step whose command is held, per axis: position m, velocity m/s, attitude rad, rate rad/s; at least
what a step of `iss-hcw` makes of a noiseless start, and what rounding to float32 leaves."""
RECORDED_COMMANDS = (3.5e-4, 2.5e-5, 8e-5, 2e-6)
"""The same where the step is given the mean of five commands of a recording, 30 % of them random at 20 Hz."""
_ROUNDING = (1e-5, 1e-6, 1e-6, 1e-7)


class Belief(NamedTuple):
    """A Gaussian about a view.

    Attributes:
        view: the mean.
        covariance: of the 12 errors of the truth from it.
    """

    view: Float[Array, "13"]
    covariance: Float[Array, "12 12"]


class FilterParams(NamedTuple):
    """What the filter is told.

    Attributes:
        process: physical constants.
        noise: of the sensors, total root mean squares; a time-correlated part is taken for white.
        process_noise: standard deviation of what a step adds, per axis of position, velocity, attitude and rate.
        gate: square of an innovation, in units of its covariance, beyond which the measurement is taken for an outlier;
            inf for none.
    """

    process: ExactParams
    noise: NoiseParams
    process_noise: Float[Array, "4"]
    gate: Float[Array, ""]


@dataclass(frozen=True)
class ErrorStateEKF:
    """Filters measurements by `init`, `predict` and `update`; as a world model, filters a history and predicts on.

    What `step` samples is the truth, without the noise of a further measurement. The station is taken to be where it is
    at the reference epoch.

    Args:
        config: sensor noise and vehicles; the default vehicles and cooperative noise when None.
        fidelity: of the process. `iss-hcw` is off `iss-numerical` by 5e-4 m and 3e-6 rad in 16 s, a tenth of
            cooperative noise or less, and needs no float64.
        process_noise: as in `FilterParams`.
        history_length: `H` to report.
        dt: seconds a step.
        gate: as in `FilterParams`.
    """

    config: DockingConfig | None = field(default=None, compare=False, repr=False)
    fidelity: Fidelity = "iss-hcw"
    process_noise: tuple[float, float, float, float] = field(default=HELD_COMMANDS, compare=False)
    history_length: int = 8
    dt: float = 0.25
    gate: float = field(default=math.inf, compare=False)
    process: ExactDynamics = field(init=False, repr=False)
    params: FilterParams = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        process = ExactDynamics(self.fidelity, self.config, self.history_length, self.dt)
        config = load_config(noise="cooperative") if self.config is None else self.config
        config = load_config(config, fidelity=self.fidelity, precision=process.precision)
        with jax.enable_x64(process.precision == "float64"):
            told = params_from_config(config).noise, *map(jnp.asarray, (self.process_noise, self.gate))
            noise, added, gate = jax.tree.map(lambda x: x.astype(process.precision), jax.device_get(told))
        object.__setattr__(self, "process", process)
        object.__setattr__(self, "params", FilterParams(process.params, noise, added, gate))

    @property
    def name(self) -> str:
        """What reports call it."""
        return "EKF" if self.fidelity == "iss-hcw" else f"EKF ({self.fidelity})"

    @property
    def precision(self) -> str:
        """The dtype that its numbers need."""
        return self.process.precision

    def init(self, params: FilterParams, view: Float[Array, "13"]) -> Belief:
        """Start from one measurement.

        Raises:
            RuntimeError: float64 is needed and JAX's 64-bit mode is off.
        """
        state = self.process.start(params.process, params.process.chief.epoch, view)
        view = self.process.decode(params.process, state)["state"]
        return Belief(view, jnp.diag(self._measured(params, view) ** 2))

    def predict(self, params: FilterParams, belief: Belief, action: Float[Array, "6"]) -> Belief:
        """Advance mean and covariance by one step under a held body wrench (N, N m)."""
        ahead = self._propagate(params, belief.view, action)

        def error_after(error: Array) -> Array:
            return view_error(self._propagate(params, displaced(belief.view, error), action), ahead)

        error = Gaussian(jnp.zeros(12, ahead.dtype), belief.covariance)
        added = jnp.repeat(jnp.asarray(params.process_noise), 3) ** 2
        return Belief(ahead, ekf_predict(error, error_after, jnp.diag(added)).covariance)

    def innovation(
        self, params: FilterParams, belief: Belief, view: Float[Array, "13"]
    ) -> tuple[Float[Array, "12"], Float[Array, "12 12"]]:
        """Return how far a measurement is off the mean, and the covariance that this should have."""
        noise = self._measured(params, belief.view)
        return view_error(view.astype(noise.dtype), belief.view), belief.covariance + jnp.diag(noise**2)

    def update(self, params: FilterParams, belief: Belief, view: Float[Array, "13"]) -> Belief:
        """Correct by a measurement of the whole view; by an outlier the less, the farther out it is.

        The noise of one beyond the gate is taken for so much larger that it is on it, as if it were all noise. None is
        left out, so that a filter that is off finds back. Source: Chang (2014), Robust Kalman filtering based on
        Mahalanobis distance as outlier judging criterion, J. Geodesy 88, 391; one step of its iteration.
        """
        noise = self._measured(params, belief.view)
        error, expected = self.innovation(params, belief, view)
        variance = noise**2 * jnp.maximum(normalized_square(error, expected) / params.gate, 1)
        gain, after, _ = joseph_update(belief.covariance, jnp.eye(12, dtype=noise.dtype), jnp.diag(variance))
        return Belief(displaced(belief.view, gain @ error), after)

    def encode(self, params: FilterParams, history: History) -> Belief:
        """Filter the valid measurements of a history."""

        def advance(belief: Belief, measured: tuple) -> tuple[Belief, None]:
            action, view, valid = measured
            observed = self.observe(params, belief, action, {STATE: view})
            return jax.tree.map(lambda a, b: jnp.where(valid, a, b), observed, belief), None

        # Measurements before the first valid one are copies of it, so steps count from there.
        views = history.observation[STATE]
        rest = (history.action, views[1:], history.valid[:-1])
        return jax.lax.scan(advance, self.init(params, views[0]), rest)[0]

    def step(
        self, params: FilterParams, key: Key[Array, ""] | None, action: Float[Array, "6"], state: Belief
    ) -> Belief:
        """Predict one step; with a key also draw a truth from the prediction, from there on known for certain."""
        belief = self.predict(params, state, action)
        if key is None:
            return belief
        factor = jnp.linalg.cholesky(belief.covariance)
        error = factor @ jax.random.normal(key, (12,), factor.dtype)
        return Belief(displaced(belief.view, error), jnp.zeros_like(factor))

    def observe(
        self, params: FilterParams, state: Belief, action: Float[Array, "6"], observation: dict[str, Array]
    ) -> Belief:
        """Predict over one executed action and correct by the measurement that followed it."""
        return self.update(params, self.predict(params, state, action), observation[STATE])

    def decode(self, params: FilterParams, state: Belief) -> dict[str, Array]:
        """Return the mean in the station frame, and the covariance of its 12 errors."""
        return {"state": state.view, "covariance": state.covariance}

    def _propagate(self, params: FilterParams, view: Array, action: Array) -> Array:
        state = self.process.start(params.process, params.process.chief.epoch, view)
        return self.process.decode(params.process, self.process.step(params.process, None, action, state))["state"]

    def _measured(self, params: FilterParams, view: Array) -> Float[Array, "12"]:
        """Standard deviation of a measurement's errors near a view, and of its rounding."""
        noise = jax.tree.map(jnp.asarray, params.noise)
        position = noise.position + noise.position_per_range * jnp.linalg.norm(View.of(view).position)
        white = jnp.stack([position, noise.velocity, noise.attitude, noise.rate])
        total = (white**2 + jnp.stack(noise.bias[:4]) ** 2) / 3
        return jnp.repeat(jnp.sqrt(total + jnp.asarray(_ROUNDING, total.dtype) ** 2), 3)
