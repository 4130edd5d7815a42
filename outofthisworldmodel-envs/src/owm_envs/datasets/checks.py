"""What must hold of the rows of an episode: each check names file, field, row, what is allowed and what came.

They cost less than reading the rows, and need no simulator: order and time, types, ranges by field, and that truth
moves as something that moves does. `owm_envs.datasets.verify` goes further.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from astrojax.time import mjd_from_calendar
from owm_envs.config import DockingConfig
from owm_envs.datasets.layout import Span
from owm_envs.episode import POLICY_NAMES
from owm_envs.station.ports import PORT_NAMES, goal_poses
from owm_envs.view import View

Columns = Mapping[str, np.ndarray]
"""Arrays of one episode's rows, by column."""
OUTCOMES = ("running", "docked", "collided", "escaped", "timeout", "invalid_action", "diverged")
DOCKED, ESCAPED, TIMEOUT, INVALID = (OUTCOMES.index(n) for n in ("docked", "escaped", "timeout", "invalid_action"))
_DRAWS, _DRIFTS = 6.0, 8.0
"""Largest error over the configured one: no normal number that noise is made of is larger; of drift none is likely."""


class Limits(NamedTuple):
    """How large what was recorded may be: as the run was configured, or generous bounds where that is not known."""

    force: float = 1e6
    """N, per axis."""
    torque: float = 1e6
    """N m, per axis."""
    acceleration: float = 10.0
    """m/s2."""
    turn: float = 10.0
    """rad/s2, of a body that does not rotate."""
    distance: float = 1e6
    """m."""

    @classmethod
    def of(cls, config: DockingConfig | None) -> "Limits":
        """Those of a configuration."""
        if config is None:
            return cls()
        chaser, ranges = config.chaser, config.randomization
        fault = chaser.fault
        scale = max(map(abs, chaser.thrust_scale)) * max(map(abs, ranges.thrust_scale))
        scale *= max(1.0, max(map(abs, fault.thrust_scale)) * max(map(abs, ranges.fault_scale)))
        scale *= 3.0 if chaser.flexible.active else 1.0  # what was stored comes back
        leaks = max(map(abs, fault.leak[:3])), max(map(abs, fault.leak[3:]))
        limits = chaser.force_limit, chaser.torque_limit
        force, torque = (3**0.5 * (scale * limit + leak) for limit, leak in zip(limits, leaks))
        return cls(
            chaser.force_limit,
            chaser.torque_limit,
            # Tides and rotating axes are small beside thrust: 0.05 m/s2 is theirs at 4 km and 10 m/s.
            force / (chaser.mass * ranges.mass_scale[0]) + 0.05,
            torque / (min(chaser.inertia) * ranges.inertia_scale[0]) + 1e-3,
            2 * config.escape_radius,
        )


def check_finite(columns: Columns, span: Span, names: Sequence[str]) -> None:
    """Columns hold finite numbers: all that is demanded of datasets that others wrote.

    Raises:
        ValueError: one does not.
    """
    for name in names:
        values = columns[name]
        if values.dtype.kind not in "iufb" or not np.isfinite(values).all():
            raise ValueError(f"{span.path}: {name} of episode {span.number} must be finite numbers")


def check_episode(columns: Columns, span: Span, fps: float, config: DockingConfig | None) -> None:
    """All checks of one episode of ours, its types known to be right.

    Args:
        columns: of all its rows, by name.
        span: where they lie.
        fps: rows a second.
        config: of the environment, where it is known.

    Raises:
        ValueError: the first that fails.
    """
    require = _Episode(span, columns)
    limits = Limits.of(config)
    _check_place(require, fps)
    _check_time(require, fps)
    _check_labels(require)
    _check_ranges(require, limits)
    _check_motion(require, limits)
    if config is not None:
        _check_start(require, config)
        _check_ending(require, config)
        _check_measurement(require, config)


class _Episode:
    """An episode's columns, and how what is wrong with them is told."""

    def __init__(self, span: Span, columns: Columns):
        self.span, self.columns, self.rows = span, columns, span.rows
        with np.errstate(invalid="ignore"):  # of a signalling NaN; it is refused below
            self.state = columns["observation.state"].astype(np.float64)
        self.truth = columns["observation.environment_state"]
        # Several numbers of an epoch in single precision: its seconds are then 1/128 s coarse.
        epoch = columns["epoch"]
        self.coarse = 1 / 64 if (epoch == epoch.astype(np.float32)).all() else 1e-6
        self.passed = np.diff(epoch[:, 0]) * 86_400 + np.diff(epoch[:, 1])

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __call__(self, name: str, good: np.ndarray, allowed: str, came: np.ndarray | None = None) -> None:
        """Refuse the episode if a row is not good."""
        if good.all():
            return
        row = int(np.argmin(good))
        values = self.columns[name] if came is None else came
        told = np.array2string(np.asarray(values[row]), precision=6, max_line_width=10_000, threshold=20)
        where = f"{self.span.path}: {name} of episode {self.span.number}, row {row},"
        raise ValueError(f"{where} must be {allowed}, got {told}")


def _check_place(episode: _Episode, fps: float) -> None:
    """Rows are where their numbers say."""
    number, rows = episode.span.number, np.arange(episode.rows)
    episode("episode_index", episode["episode_index"] == number, f"{number}")
    episode("frame_index", episode["frame_index"] == rows, "the row")
    episode("index", episode["index"] == episode.span.index + rows, f"{episode.span.index} more than the row")
    late = np.abs(episode["timestamp"] - rows / fps) <= 1e-4
    episode("timestamp", late, f"the row by {fps:g} a second")


def _check_time(episode: _Episode, fps: float) -> None:
    """The epoch advances by one period a row; by less to the last, which the episode's end may have cut short."""
    epoch = episode["epoch"]
    day = np.isfinite(epoch).all(axis=1) & (epoch[:, 0] == np.floor(epoch[:, 0])) & (np.abs(epoch[:, 0]) < 1e7)
    episode("epoch", day & (epoch[:, 1] >= 0) & (epoch[:, 1] <= 86_400), "a whole day and seconds from 0 to 86400")
    passed, period, coarse = episode.passed, 1 / fps, episode.coarse
    good = np.abs(passed - period) <= coarse
    good[-1:] = (passed[-1:] >= -coarse) & (passed[-1:] <= period + coarse)
    episode("epoch", np.append(True, good), f"{period:g} s after the row before", epoch)


def _check_labels(episode: _Episode) -> None:
    """Port, goal, policy and outcome are known ones, the same in all rows; flags are set where they may be."""
    for name, least, most in (
        ("port", 0, len(PORT_NAMES) - 1),
        ("policy", -1, len(POLICY_NAMES) - 1),
        ("outcome", 1, len(OUTCOMES) - 1),
    ):
        values = episode[name]
        episode(name, (values >= least) & (values <= most), f"from {least} to {most}")
        episode(name, values == values[0], f"{values[0]} as in the rows before")
    port, outcome = int(episode["port"][0]), int(episode["outcome"][0])
    episode("task_index", episode["task_index"] == port, f"the port, {port}")
    at_goal = (np.abs(episode["goal_pose"] - goal_poses()[port]) <= 1e-4).all(axis=1)
    episode("goal_pose", at_goal, f"that of {PORT_NAMES[port]}")
    # The last decision's row, and the one that pads it.
    last = np.arange(episode.rows) >= episode.rows - 2
    episode("next.done", episode["next.done"] == last, "true in the last two rows alone")
    docked = last & (outcome == DOCKED)
    episode("next.success", episode["next.success"] == docked, "true in the last two rows of one that docked alone")
    if len(tasks := episode.span.tasks) and PORT_NAMES[port].replace("_", " ") not in tasks[0]:
        raise ValueError(f"{episode.span.path}: task of episode {episode.span.number} must name its port, got {tasks}")


def _within(bound: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: (np.abs(values) <= bound).reshape(len(values), -1).all(axis=1)  # false of NaN


def _check_ranges(episode: _Episode, limits: Limits) -> None:
    """Numbers are finite and no larger than they can be; quaternions have length one."""
    for name, view, told in (
        ("observation.state", View.of(episode.state), "measured"),
        ("observation.environment_state", View.of(episode.truth), "true"),
    ):
        for part, bound, unit in (("position", limits.distance, "m"), ("velocity", 1e4, "m/s"), ("rate", 1e2, "rad/s")):
            values = getattr(view, part)
            episode(name, _within(bound)(values), f"a {told} {part} of at most {bound:g} {unit} an axis", values)
        length = np.linalg.norm(view.attitude, axis=1)
        episode(name, np.abs(length - 1) <= 1e-4, f"a {told} attitude of length 1", view.attitude)
    action, reward = episode["action"], episode["next.reward"]
    # An action that is no number ends the episode, and is kept.
    free = (np.arange(episode.rows) == episode.rows - 2) & (episode["outcome"][0] == INVALID)
    for part, bound, unit in ((slice(0, 3), limits.force, "N"), (slice(3, 6), limits.torque, "N m")):
        good = _within(bound * (1 + 1e-5))(action[:, part]) | free
        episode("action", good, f"at most {bound:g} {unit} an axis", action[:, part])
    episode("next.reward", _within(1e9)(reward), "at most 1e+09 in size")
    pad = np.arange(episode.rows) < episode.rows - 1
    episode("action", pad | ~action.any(axis=1), "zero in the last row, which starts no transition")
    episode("next.reward", pad | (reward == 0), "zero in the last row, which starts no transition")


def _check_motion(episode: _Episode, limits: Limits) -> None:
    """Truth goes from a row to the next as its velocities say, and these change no faster than thrusters allow.

    The trapezoid's error is at most a quarter of the spread of accelerations by the square of the time.
    """
    view, passed = View.of(episode.truth), np.maximum(episode.passed, 0)[:, None]
    name, slack = "observation.environment_state", passed[:, 0] + episode.coarse
    speed = np.linalg.norm(view.velocity, axis=1)[1:] * episode.coarse
    spin = np.linalg.norm(view.rate, axis=1)
    turn = limits.turn + spin[1:] ** 2 + spin[:-1] ** 2
    before, after = view.attitude[:-1], view.attitude[1:]
    for part, moved, allowed, unit in (
        ("position", _residual(np.diff(view.position, axis=0), view.velocity, passed),
         2e-3 + speed + limits.acceleration * slack**2 / 2, "m"),
        ("attitude", _residual(turned(before, after), view.rate, passed),
         1e-3 + spin[1:] * episode.coarse + turn * slack**2 / 2 + (spin[1:] * slack) ** 3, "rad"),
        ("velocity", np.linalg.norm(np.diff(view.velocity, axis=0), axis=1),
         1e-4 + 1e-2 * np.linalg.norm(view.velocity, axis=1)[1:] * slack + 1.1 * limits.acceleration * slack, "m/s"),
        ("rate", np.linalg.norm(np.diff(view.rate, axis=0), axis=1), 1e-4 + 1.1 * turn * slack, "rad/s"),
    ):  # fmt: skip
        good = np.append(True, moved <= allowed)
        told = f"a true {part} that follows from the row before to {np.max(allowed, initial=0):.2g} {unit}"
        episode(name, good, told, np.append(0.0, moved))


def _residual(moved: np.ndarray, rate: np.ndarray, passed: np.ndarray) -> np.ndarray:
    return np.linalg.norm(moved - passed * (rate[1:] + rate[:-1]) / 2, axis=1)


def turned(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vectors (N, 3) from attitudes (N, 4) to others, body axes [rad]; exact for small turns."""
    scalar = np.sum(before * after, axis=1, keepdims=True)
    vector = before[:, :1] * after[:, 1:] - after[:, :1] * before[:, 1:] - np.cross(before[:, 1:], after[:, 1:])
    return 2 * vector * np.where(scalar < 0, -1, 1)


def _check_start(episode: _Episode, config: DockingConfig) -> None:
    """The episode began where, and when, the configuration lets one begin."""
    reset, first = config.reset, np.arange(episode.rows) > 0
    view, name = View.of(episode.truth), "observation.environment_state"
    for part, least, most, unit in (
        ("position", reset.radius_min, reset.radius_max, "m"),
        ("velocity", 0.0, reset.speed, "m/s"),
        ("rate", 0.0, reset.rate, "rad/s"),
    ):
        size, slack = np.linalg.norm(getattr(view, part), axis=1), 1e-5 * most + 1e-9
        good = first | ((size >= least - slack) & (size <= most + slack))
        episode(name, good, f"a true {part} of {least:g} to {most:g} {unit} at the start", size)
    day, seconds = mjd_from_calendar(config.chief.reference_epoch)
    since = (episode["epoch"][:, 0] - day) * 86_400 + episode["epoch"][:, 1] - seconds
    good = first | ((since >= -1) & (since <= reset.epoch_window + 1))
    episode("epoch", good, f"within {reset.epoch_window:g} s of the reference epoch at the start", episode["epoch"])


def _check_ending(episode: _Episode, config: DockingConfig) -> None:
    """The episode ended where its outcome says."""
    decisions, longest, outcome = episode.rows - 1, config.horizon_decisions, int(episode["outcome"][0])
    told = f"{episode.span.path}: episode {episode.span.number}"
    if decisions > longest or (outcome == TIMEOUT and decisions < longest):
        raise ValueError(f"{told} must have at most {longest} decisions, and no fewer at a timeout, got {decisions}")
    position, last = View.of(episode.truth).position, np.arange(episode.rows) == episode.rows - 1
    away = np.linalg.norm(position, axis=1)
    name = "observation.environment_state"
    # Outside only at its end, and only if it escaped or ended otherwise in that very step.
    episode(name, last | (away <= config.escape_radius + 1e-3), f"within {config.escape_radius:g} m of the station")
    if outcome == ESCAPED:
        episode(name, ~last | (away >= config.escape_radius - 1e-3), "outside, since it escaped", away)
    if outcome == DOCKED:
        off = np.linalg.norm(position - episode["goal_pose"][:, :3], axis=1)
        near = ~last | (off <= config.docking.position + 1e-4)
        episode(name, near, f"{config.docking.position:g} m from the goal at its end, since it docked", off)


def _check_measurement(episode: _Episode, config: DockingConfig) -> None:
    """What was measured lies as near the truth as the configured errors, which have a largest size, leave it.

    What a quiet navigation shows is that of the row before.
    """
    noise, seen, true = config.noise, View.of(episode.state), View.of(episode.truth)
    fresh, held = measured_rows(episode.columns), np.append(False, (np.diff(episode.state, axis=0) == 0).all(axis=1))
    episode("observation.state", fresh | held, "that of the row before, as it was not measured")
    draws = _DRAWS * (config.navigation.outlier_scale if config.navigation.heavy_tailed else 1)
    spread = noise.position + noise.position_per_range * np.linalg.norm(true.position, axis=1)
    for part, size, drift, off in (
        ("position", spread, noise.bias.position, seen.position - true.position),
        ("velocity", noise.velocity, noise.bias.velocity, seen.velocity - true.velocity),
        ("attitude", noise.attitude, noise.bias.attitude, turned(true.attitude, seen.attitude)),
        ("rate", noise.rate, noise.bias.rate, seen.rate - true.rate),
    ):
        # Single precision, and what normalising an observation and back loses.
        rounding = 1e-5 + 1e-6 * np.linalg.norm(getattr(true, part), axis=1)
        allowed = draws * size + _DRIFTS * drift + rounding
        error = np.linalg.norm(off, axis=1)
        told = f"a measured {part} within {np.max(allowed):.2g} of the true one"
        episode("observation.state", ~fresh | (error <= allowed), told, error)


def measured_rows(columns: Columns) -> np.ndarray:
    """Which rows (N,) of an episode were measured at that instant: all but where relative navigation was quiet."""
    fresh = columns.get("observation.state_valid")
    return np.ones(len(columns["observation.state"]), bool) if fresh is None else fresh.reshape(-1)
