"""Recorded flights against the simulator: its dynamics, its noise, its camera."""

import math
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from owm_envs.config import DockingConfig
from owm_envs.config.params import params_from_config
from owm_envs.datasets.checks import DOCKED, ESCAPED, Columns, measured_rows, turned
from owm_envs.env import DockingEnv
from owm_envs.flags import own_flags
from owm_envs.task.actuators import actuators_at_rest, deliver
from owm_envs.task.events import error_norms, safe_norm
from owm_envs.task.navigation import goal_error
from owm_envs.task.randomization import drawable
from owm_envs.task.reward import reward
from owm_envs.task.sensors import Truth
from owm_envs.view import View

PARTS = ("position", "velocity", "attitude", "rate")
UNITS = ("m", "m/s", "rad", "rad/s")
STEP_TOLERANCE = {"float64": (1e-6, 1e-6, 1e-7, 1e-7), "float32": (2e-3, 2e-4, 1e-4, 1e-5)}
"""By precision, how far a recorded row may lie from a step of the dynamics from the one before; in `UNITS`.

In double precision some thousand times what was measured: an action is kept in single precision, and the numerical
fidelity's station starts anew at each row on its Kepler orbit, not on the one flown.
"""
REWARD_TOLERANCE = {"float64": 1e-5, "float32": 1e-3}
"""By precision, of one more than the reward."""
LEVEL = 1e-6
"""Of the test of noise: a sound dataset is called wrong once in a million tests."""
PSNR = 25.0
"""dB, least for a frame in a lossy video against one drawn anew; those of another moment have less."""


def step_errors(episodes: Iterable[Columns], config: DockingConfig) -> Float[np.ndarray, "E 4"] | None:
    """The largest difference of each episode's rows from a step of the dynamics with the action recorded; `UNITS`.

    Actuators are followed from an episode's start, so that delays and pulses are theirs. None where that cannot be
    known: vehicles were drawn, and what was drawn is not recorded.

    Args:
        episodes: columns of each.
    """
    if {"vehicle", "fault"} & set(drawable(config)):
        return None
    with own_flags():
        env = DockingEnv(config.model_copy(update={"observation": "state", "camera": type(config.camera)()}))
        params = env.default_params()
        errors = []
        for columns in episodes:
            epoch, truth, action = columns["epoch"], columns["observation.environment_state"], columns["action"]
            passed = np.diff(epoch[:, 0]) * 86_400 + np.diff(epoch[:, 1])
            # A step that the episode's end cut short is left out; single precision keeps seconds to 1/128.
            coarse = 1 / 64 if config.precision == "float32" else 0
            whole = np.abs(passed - config.decision_dt) <= max(config.dt / 2, coarse)
            whole &= np.isfinite(action[:-1]).all(axis=1)
            # Of a power of two rows, so that few programs do for all lengths.
            rows = len(passed)
            padded = 1 << max(rows - 1, 1).bit_length()
            fill = np.minimum(np.arange(padded), rows - 1)
            number = partial(np.asarray, dtype=config.precision)
            reached = _steps(env, params, number(epoch[fill]), number(truth[fill]), number(action[fill]))
            moved = np.asarray(reached, np.float64)[:rows]
            off = _differences(moved, truth[1:])
            errors.append(np.where(whole[:, None], off, 0).max(axis=0))
    return np.array(errors).reshape(-1, 4)


@partial(jax.jit, static_argnames="env")
def _steps(env, params, epoch, truth, action):
    """Where each row is after a decision with its action: a loop over the rows, as actuators remember."""
    at_rest = actuators_at_rest(env.structure, truth.dtype)

    def decide(actuators, row):
        epoch, view, wrench = row

        def substep(carry, _):
            actuators, physics = carry
            near = env.near_hull(params, env.dynamics.relative_state(params, physics))
            actuators, delivered = deliver(params.chaser, actuators, wrench, params.dt, near)
            return (actuators, env.dynamics.step(params, physics, delivered, params.dt)), None

        start = actuators, env.dynamics.init(params, epoch, view)
        (actuators, physics), _ = jax.lax.scan(substep, start, length=env.structure.steps_per_action)
        return actuators, env.dynamics.relative_state(params, physics)

    return jax.lax.scan(decide, at_rest, (epoch, truth, action))[1]


def _differences(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Norms (N, 4) of the differences of views, in `UNITS`."""
    one, other = View.of(one), View.of(other)
    apart = [one.position - other.position, one.velocity - other.velocity]
    apart += [turned(one.attitude, other.attitude), one.rate - other.rate]
    return np.stack([np.linalg.norm(each, axis=1) for each in apart], axis=1)


def reward_errors(episodes: Iterable[Columns], config: DockingConfig) -> Float[np.ndarray, "E"]:
    """The largest difference of each episode's rewards from those of its true rows, over `REWARD_TOLERANCE`.

    Whether a decision touched the hull and flew on is not recorded: the nearer of both rewards counts.

    Args:
        episodes: columns of each.
    """
    with own_flags():
        params = params_from_config(config)
        errors = []
        for columns in episodes:
            told, action = columns["next.reward"][:-1].astype(np.float64), columns["action"]
            rows, outcome = len(told), int(columns["outcome"][0])
            padded = 1 << max(rows, 1).bit_length()
            fill = np.minimum(np.arange(padded), rows)
            number = partial(np.asarray, dtype=config.precision)
            truth = number(columns["observation.environment_state"][fill])
            wrench = number(np.where(np.isfinite(action).all(axis=1, keepdims=True), action, 0)[fill[:-1]])
            last = np.arange(padded - 1) == rows - 1
            port, docked, escaped = int(columns["port"][0]), last & (outcome == DOCKED), last & (outcome == ESCAPED)
            both = _rewards(params, truth, wrench, port, docked, escaped)
            off = np.min([np.abs(np.asarray(each, np.float64)[:rows] - told) for each in both], axis=0)
            errors.append(np.max(off / (REWARD_TOLERANCE[config.precision] * (1 + np.abs(told)))))
    return np.array(errors)


@jax.jit
def _rewards(params, truth, wrench, port, docked, escaped):
    """The rewards of decisions from each row to the next: without a touch, and with one."""
    errors = jax.vmap(goal_error, (0, None))(truth, params.goals[port])
    norms, away = jax.vmap(error_norms)(errors), jax.vmap(safe_norm)(errors[:, :3])

    def earned(touched):
        return jax.vmap(reward, (None, 0, 0, 0, None, 0, 0))(
            params, norms[1:], away[:-1], wrench, jnp.asarray(touched), docked, escaped
        )

    return earned(False), earned(True)


class Residuals(NamedTuple):
    """Errors of measurements summed over an episode, and how that sum spreads under the configured noise."""

    squares: np.ndarray
    """(4,) of errors over their configured size."""
    count: float
    """Expected."""
    variance: np.ndarray
    """(4,) of the sum."""


def residuals(columns: Columns, config: DockingConfig) -> Residuals:
    """An episode's measured less true views, each axis over its configured standard deviation.

    Parts without noise are zero, and rows that were not measured are left out. A time-correlated error of correlation r
    from a row to the next makes the sum of squares spread further: 2 n r^2k of its variance squared, twice, is added
    for each lag k, of which there are n pairs. Outliers make it spread further by their fourth moment.
    """
    noise, fresh = config.noise, measured_rows(columns)
    seen, true = columns["observation.state"].astype(np.float64), columns["observation.environment_state"]
    view, measured = View.of(true[fresh]), View.of(seen[fresh])
    rows = int(fresh.sum())
    share, scale = (getattr(config.navigation, f"outlier_{name}") for name in ("share", "scale"))
    second, fourth = (1 - share + share * scale**power for power in (2, 4))
    off = [measured.position - view.position, measured.velocity - view.velocity]
    off += [turned(view.attitude, measured.attitude), measured.rate - view.rate]
    away = np.linalg.norm(view.position, axis=1, keepdims=True)
    white = [noise.position + noise.position_per_range * away, noise.velocity, noise.attitude, noise.rate]
    drift = [noise.bias.position, noise.bias.velocity, noise.bias.attitude, noise.bias.rate]
    lag = np.arange(1, len(fresh))
    pairs = len(fresh) - lag if fresh.all() else np.correlate(1.0 * fresh, 1.0 * fresh, "full")[len(fresh) :]
    fading = np.exp(-2 * lag * config.decision_dt / noise.bias.correlation_time)
    further = 4 * np.sum(pairs * fading)
    squares, variance = np.zeros(4), np.zeros(4)
    for part, (error, size, slow) in enumerate(zip(off, white, drift)):
        total = (second * np.broadcast_to(size, (rows, 1)) ** 2 + slow**2) / 3
        if not total.any():
            continue
        squares[part] = np.sum(error**2 / total)
        slowly = float(np.mean(slow**2 / 3 / total))
        outlying = 15 * (1 - slowly) ** 2 * (fourth / second**2 - 1)
        variance[part] = 3 * (2 * rows + further * slowly**2) + outlying * rows
    return Residuals(squares, 3.0 * rows, variance)


def noise_scores(parts: Iterable[Residuals]) -> tuple[np.ndarray, np.ndarray]:
    """How errors compare with the configured noise: (4,) root-mean-square ratios, and (4,) normal scores.

    The sum of squares is taken as a chi-square of matched mean and variance, its cube root as normal.
    Source: Wilson and Hilferty (1931), PNAS 17, 684; Satterthwaite (1946), Biometrics Bulletin 2, 110.
    """
    parts = list(parts)
    squares = np.sum([part.squares for part in parts], axis=0)
    count = np.sum([part.count for part in parts])
    variance = np.sum([part.variance for part in parts], axis=0)
    there = variance > 0
    freedom = np.where(there, 2 * count**2 / np.where(there, variance, 1), 1)
    ratio = squares / count
    score = (np.cbrt(ratio) - (1 - 2 / (9 * freedom))) / np.sqrt(2 / (9 * freedom))
    return np.where(there, np.sqrt(ratio), np.nan), np.where(there, score, 0.0)


def largest_score(tests: int) -> float:
    """The normal score that a sound dataset exceeds in one of `tests` with the chance `LEVEL`."""
    from statistics import NormalDist

    return NormalDist().inv_cdf(1 - LEVEL / (2 * tests))


def redrawn(columns: Mapping[str, Any], row: int, config: DockingConfig) -> np.ndarray | None:
    """The picture that the configured camera takes at a row; None where errors or looks were drawn.

    Args:
        row: one at which a frame is due.
    """
    if config.camera.effects.active or config.randomization.camera.active or "orbit" in drawable(config):
        return None
    with own_flags():
        env = DockingEnv(config)
        number = partial(np.asarray, dtype=config.precision)
        epoch, view = number(columns["epoch"][row]), number(columns["observation.environment_state"][row])
        return np.asarray(_picture(env, env.default_params(), epoch, view, int(columns["port"][0])))


@partial(jax.jit, static_argnames="env")
def _picture(env, params, epoch, view, port):
    from owm_envs.dynamics import station_orbit

    sensor = next(sensor for sensor in env.sensors if sensor.name == "pixels")
    physics = env.dynamics.init(params, epoch, view)
    orbit = station_orbit(env.dynamics, params, physics)
    key = jax.random.key(0)
    zero = jnp.zeros((), jnp.int32)
    return sensor.measure(key, Truth(params, View.of(view), epoch, port, zero, physics, None, key, orbit))


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two pictures of bytes, dB."""
    error = np.mean((one.astype(np.float64) - other.astype(np.float64)) ** 2)
    return math.inf if error == 0 else 10 * math.log10(255**2 / error)
