"""Least squares estimated again in flight: what the chaser's actions do here and now."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from owm.model.world_model import Params
from owm.motion.kinematics import increments, to_motion
from owm.motion.linear import LinearMap, linear_increment
from owm.planning.health import Health


class Estimate(NamedTuple):
    """Recursive least squares in information form, one row an output of the map (body velocity, then body rate).

    Attributes:
        linear: the fit that it starts from; action and bias are re-estimated, the rest stays.
        information: of the six action coefficients, each for the whole range of its action, the bias, and six
            coefficients of the actions' sizes, which tell the two directions of an axis apart.
        moment: information times coefficients.
        squares: sum of squared prediction errors of each output, forgotten alike, and how many that are.
        count: see `squares`.
        surprise: by how much prediction errors have lately been larger than expected (a cumulative sum).
        alarms: how often that gave an alarm: the vehicle is not the one that was fitted.
    """

    linear: LinearMap
    information: Float[Array, "6 13 13"]
    moment: Float[Array, "6 13"]
    squares: Float[Array, "6"]
    count: Float[Array, "6"]
    surprise: Float[Array, "6"]
    alarms: Float[Array, "6"]
    astray: Float[Array, "6"]
    """The last prediction error where it was an outlier's or the first of many, else zero."""


_RESET = 0.1
_NOISE = 4.0
"""Times what is expected: larger squared errors are not all noise."""
_EXPECTED, _MOST, _ALARM = 1.6, 12.0, 45.0
"""Of the cumulative sum of squared errors over their variance: what is taken off each, the most that one counts, and
the alarm. Errors as expected come to it about once in a million."""
_HARDER, _NOISE_MEMORY = 4.0, 0.98
"""Times a threshold that the next alarm takes, and the share of known noise that outlives a step once there was one."""
_GATE = 25.0
"""Times what is expected: a larger squared error is not learned from unless the last was as large and of its sign."""


@dataclass(frozen=True)
class OnlineLeastSquares:
    """Follows the action map of a `LeastSquares` model by recursive least squares with forgetting.

    Forgetting leads back to the fit, not to ignorance, so that what a flight does not excite neither drifts nor winds
    up (stabilised forgetting: Kulhavy and Zarrop (1993), On a general concept of forgetting, Int. J. Control 58(4)).
    Transitions are weighed by the size of the prediction errors so far, since it is not told the sensors' noise.

    Where errors stay larger than they may be, the vehicle has changed: what was known of that output is worth a tenth
    of what the fit was at first, and forgetting leads to what is found from then on, no longer to the fit (covariance
    resetting: Goodwin and Sin (1984), Adaptive filtering, prediction and control, sec. 3.3; cumulative sum: Page
    (1954), Continuous inspection schemes, Biometrika 41).

    An alarm that comes again shows errors that no such map explains: fuel that sloshes, arrays that bend. Each alarm
    makes the next one harder to come by, and from the first one on all errors count as noise, and weigh the less.

    A measurement that is far off makes two such errors of opposite signs, a change of the vehicle makes many of one. So
    the first of them is left alone.

    Args:
        limit: largest action, N and N m.
        dt: seconds a step.
        forgetting: share of what is known that outlives a step; 0.998 is a memory of two minutes at 4 Hz.
        spread: standard deviation of a coefficient about the fit, as a share of the largest in its row; of the bias a
            third of that, of an action's size a tenth.
    """

    limit: tuple[float, ...]
    dt: float = 0.25
    forgetting: float = 0.998
    spread: float = 0.3

    def init(self, params: LinearMap) -> Estimate:
        """Start from a fit."""
        coefficients = self._coefficients(params)
        prior = self._prior(coefficients)
        information = jax.vmap(jnp.diag)(prior)
        error = 0.1 * jnp.max(jnp.abs(coefficients), axis=1)  # a guess, outweighed in a few steps
        return Estimate(
            params,
            information,
            prior * coefficients,
            error**2,
            jnp.ones_like(error),
            jnp.zeros_like(error),
            jnp.zeros_like(error),
            jnp.zeros_like(error),
        )

    def learn(
        self, known: Estimate, before: Float[Array, "13"], action: Float[Array, "6"], after: Float[Array, "13"]
    ) -> Estimate:
        """Take in one transition between measurements."""
        first = to_motion(before, before)
        fitted, drift = linear_increment(known.linear, first, action)
        share = action / jnp.asarray(self.limit, action.dtype)
        inputs = jnp.concatenate([share, jnp.ones(1, action.dtype), jnp.abs(share)])
        start = self._coefficients(known.linear)
        # What the terms that stay explain is taken off.
        change = increments(first, to_motion(after, before), self.dt, drift) - (fitted - start @ inputs)
        solved = self._solved(known)
        error = change - solved @ inputs

        keep, prior = self.forgetting, self._prior(start)
        noise = known.squares / known.count
        unsure = jax.vmap(lambda at: inputs @ jax.scipy.linalg.solve(at, inputs, assume_a="pos"))(known.information)
        expected = noise + unsure
        far = error**2 > _GATE * expected
        taken = ~far | (error * known.astray > 0)
        surprise = jnp.maximum(known.surprise + jnp.minimum(error**2 / expected, _MOST) - _EXPECTED, 0)
        surprise = jnp.where(taken, surprise, known.surprise)
        alarm = surprise > _ALARM * _HARDER**known.alarms
        anyone = jnp.ones_like(prior).at[:, 7:].set(0.1)
        changed = (known.alarms > 0) | alarm
        anchor = jnp.where(changed[:, None], solved, start)

        told = jnp.where(changed, error**2, jnp.minimum(error**2, _NOISE * expected))
        told = jnp.where(taken, told, noise)
        keep_noise = jnp.where(changed, _NOISE_MEMORY, keep)
        squares, count = keep_noise * known.squares + told, keep_noise * known.count + 1
        weight = jnp.where(taken, count / squares, 0)
        ignorant = jax.vmap(jnp.diag)(prior)
        reset = _RESET * prior * anyone
        information = keep * known.information + (1 - keep) * ignorant
        moment = keep * known.moment + (1 - keep) * prior * anchor
        information = jnp.where(alarm[:, None, None], jax.vmap(jnp.diag)(reset), information)
        moment = jnp.where(alarm[:, None], reset * solved, moment)
        return Estimate(
            known.linear,
            information + weight[:, None, None] * jnp.outer(inputs, inputs),
            moment + (weight * change)[:, None] * inputs,
            squares,
            count,
            jnp.where(alarm, 0, surprise),
            known.alarms + alarm,
            jnp.where(far, error, 0),
        )

    def health(self, known: Estimate) -> Health:
        """What has been found of the axes so far."""
        start, solved = self._coefficients(known.linear), self._solved(known)
        sound = jnp.diag(start[:, :6])
        variance = jax.vmap(lambda at: jnp.diag(jnp.linalg.inv(at)))(known.information)
        share, uneven = jnp.diag(solved[:, :6]) / sound, jnp.diag(solved[:, 7:]) / sound
        return Health(
            jnp.stack([share - uneven, share + uneven], axis=1),
            jnp.sqrt(jnp.diag(variance[:, :6]) + jnp.diag(variance[:, 7:])) / jnp.abs(sound),
            (solved[:, 6] - start[:, 6]) / self.dt,
            known.alarms,
        )

    def params(self, known: Estimate) -> LinearMap:
        """The map as estimated."""
        solved = self._solved(known)
        action = solved[:, :6] / jnp.asarray(self.limit, solved.dtype)
        return known.linear._replace(action=action, bias=solved[:, 6])

    def _coefficients(self, linear: LinearMap) -> Float[Array, "6 13"]:
        scaled = jnp.asarray(linear.action) * jnp.asarray(self.limit, linear.action.dtype)
        return jnp.concatenate([scaled, jnp.asarray(linear.bias)[:, None], jnp.zeros_like(scaled)], axis=1)

    def _prior(self, coefficients: Float[Array, "6 13"]) -> Float[Array, "6 13"]:
        """The information of each coefficient by itself before the flight."""
        deviation = self.spread * jnp.max(jnp.abs(coefficients[:, :6]), axis=1)
        return deviation[:, None] ** -2 * jnp.asarray([1.0] * 6 + [9.0] + [100.0] * 6, coefficients.dtype)

    def _solved(self, known: Estimate) -> Float[Array, "6 13"]:
        return jax.vmap(lambda a, b: jax.scipy.linalg.solve(a, b, assume_a="pos"))(known.information, known.moment)


@dataclass(frozen=True)
class OnlineBase:
    """The same for the linear map under a kinematic world model; the network's part stays as trained."""

    linear: OnlineLeastSquares

    def init(self, params: Params) -> tuple[Params, Estimate]:
        """Start from the fit that the network was trained over."""
        return params, self.linear.init(params.statistics.linear)

    def learn(
        self,
        known: tuple[Params, Estimate],
        before: Float[Array, "13"],
        action: Float[Array, "6"],
        after: Float[Array, "13"],
    ) -> tuple[Params, Estimate]:
        """Take in one transition between measurements."""
        params, estimate = known
        return params, self.linear.learn(estimate, before, action, after)

    def health(self, known: tuple[Params, Estimate]) -> Health:
        """What has been found of the axes so far."""
        return self.linear.health(known[1])

    def params(self, known: tuple[Params, Estimate]) -> Params:
        """The model over the map as estimated."""
        params, estimate = known
        return params._replace(statistics=params.statistics._replace(linear=self.linear.params(estimate)))
