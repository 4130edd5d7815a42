"""`check_env`: whether equations of motion, or an environment over them, keep the contract of `Dynamics`."""

import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.utils import env_checker
from jaxtyping import Array, Float

from astrojax.attitude import quat_angle, quat_from_rotation_vector, quat_multiply, quat_sign
from owm_envs.config.params import Params
from owm_envs.dynamics import Dynamics, PhysicalState
from owm_envs.env import DockingEnv
from owm_envs.task.events import Outcome
from owm_envs.testing.expect import alike, expect, outline
from owm_envs.view import VIEW_SIZE, View

_STEPS = 20
_TOLERANCE = {"float64": 1e-6, "float32": 1e-3}
"""On every number of a view, SI units: what rounding may do to it in a few steps."""


class _Case(NamedTuple):
    name: str
    view: Float[Array, "13"]
    wrench: Float[Array, "6"]


_STILL = [0.0, 0.0, 0.0]
_TURNED = [0.5, 0.5, -0.5, 0.5]
_CASES = (
    _Case("under thrust", [30, -40, 20, 0.3, -0.2, 0.1, *_TURNED, 4e-3, -3e-3, 2e-3], [800, -600, 400, 500, 300, -200]),
    _Case("drifting", [90, -60, 120, 0.3, -0.2, 0.1, *_TURNED, 4e-3, -3e-3, 2e-3], [0.0] * 6),
    _Case("at rest in the origin", [*_STILL, *_STILL, 1, 0, 0, 0, *_STILL], [0.0] * 6),
    _Case("in a spin", [-100, 100, 50, 3.0, 1.0, -2.0, *_TURNED, 2.0, -1.0, 2.0], [1600] * 3 + [2000] * 3),
)


class _Trial(NamedTuple):
    """The environment under test and its dynamics, compiled."""

    env: DockingEnv
    params: Params
    epoch: Float[Array, "2"]
    cases: tuple[_Case, ...]
    tolerance: float
    init: Callable[..., PhysicalState]
    step: Callable[..., PhysicalState]
    view: Callable[..., Array]
    traces: dict[str, int]

    @property
    def dynamics(self) -> Dynamics:
        return self.env.dynamics


def check_env(subject: Dynamics | DockingEnv | gymnasium.Env | str, **overrides: Any) -> None:
    """Check equations of motion, and the environment over them, as this package's own are checked.

    In this order: types and shapes (dtype follows the inputs, a state that `lax.scan` carries); one trace per shape;
    jit equals eager; `init` inverts `relative_state`, at any time step; clocks; unit quaternions; velocity and rate
    as the derivatives of position and attitude; vmap equals a loop; finite gradients; the same seed, the same
    episode; nothing but finite numbers under extreme actions; and Gymnasium's own `check_env` on the adapter. Most of
    the time it takes is compilation.

    Args:
        subject: a `Dynamics` of your own (flown as fidelity "iss"), a `DockingEnv`, a Gymnasium environment over one,
            or an id.
        overrides: fields of `DockingConfig`, for a `Dynamics` or an id.

    Raises:
        AssertionError: naming the check that failed, what was expected and what came.
    """
    with jax.enable_x64(True):
        env = _docking_env(subject, overrides)
        _check_types(env)
        trial = _trial(env)
        for check in (
            _check_traces_and_jit,
            _check_init,
            _check_flight,
            _check_kinematics,
            _check_gradients,
        ):
            check(trial)
    adapter = _adapter(subject, env)
    for check in (_check_keys, _check_actions, _check_gymnasium):
        check(adapter)


def _docking_env(subject: Any, overrides: dict[str, Any]) -> DockingEnv:
    if isinstance(subject, str):
        return gymnasium.make(subject, **overrides).unwrapped.docking_env
    if overrides and isinstance(subject, (DockingEnv, gymnasium.Env)):
        raise ValueError(f"{sorted(overrides)} can't change an environment that is already built")
    if isinstance(subject, DockingEnv):
        return subject
    if isinstance(subject, gymnasium.Env):
        return subject.unwrapped.docking_env
    try:
        return DockingEnv(**{"fidelity": "iss", **overrides}, dynamics=subject)
    except TypeError as error:
        raise AssertionError(f"interface: {error}") from None


def _arguments(env: DockingEnv, dtype) -> tuple[Params, Array, Array, Array]:
    """Parameters, epoch, and the first case's view and wrench, of one dtype."""
    params = env.default_params()
    params = jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, params)
    epoch = params.chief.epoch + jnp.asarray([2.0, 1234.5], dtype)
    return params, epoch, jnp.asarray(_CASES[0].view, dtype), jnp.asarray(_CASES[0].wrench, dtype)


def _trial(env: DockingEnv) -> _Trial:
    dtype = np.dtype(env.config.precision)
    traces = {"init": 0, "step": 0, "relative_state": 0}

    def counted(name: str) -> Callable:
        def function(*args):
            traces[name] += 1
            return getattr(env.dynamics, name)(*args)

        return jax.jit(function)

    params, epoch, *_ = _arguments(env, dtype)
    cases = tuple(_Case(name, jnp.asarray(view, dtype), jnp.asarray(wrench, dtype)) for name, view, wrench in _CASES)
    compiled = [counted(name) for name in traces]
    return _Trial(env, params, epoch, cases, _TOLERANCE[env.config.precision], *compiled, traces)


def _check_types(env: DockingEnv) -> None:
    """By abstract evaluation: nothing is compiled."""
    dynamics = env.dynamics
    expect(isinstance(dynamics.has_epoch, bool), "interface", "has_epoch to be a bool", repr(dynamics.has_epoch))
    for dtype in (jnp.float64, jnp.float32):
        params, epoch, view, wrench = _arguments(env, dtype)

        def advance(state, params=params, wrench=wrench):
            return dynamics.step(params, state, wrench, params.dt)

        state = outline("init", dynamics.init, params, epoch, view)
        expect(isinstance(state, PhysicalState), "types", "init to return a PhysicalState", type(state).__name__)
        after = outline("step", advance, state)
        expect(
            jax.tree.structure(after) == jax.tree.structure(state),
            "types",
            "step to return a state of the same structure",
            jax.tree.structure(after),
        )
        for (path, old), new in zip(jax.tree.leaves_with_path(state), jax.tree.leaves(after)):
            name = jax.tree_util.keystr(path)
            expect(
                new.shape == old.shape, "types", f"step to keep the shape {old.shape} of the state's {name}", new.shape
            )
            expect(
                old.dtype == new.dtype == dtype,
                "dtype follows the inputs",
                f"{np.dtype(dtype)} from init and step for the state's {name}, as the inputs are",
                f"{old.dtype} and {new.dtype}",
            )
        seen = outline("relative_state", dynamics.relative_state, params, state)
        expect(seen.shape == (VIEW_SIZE,), "types", f"relative_state to be of shape {(VIEW_SIZE,)}", seen.shape)
        expect(
            seen.dtype == dtype, "dtype follows the inputs", f"{np.dtype(dtype)} from relative_state", f"{seen.dtype}"
        )


def _check_traces_and_jit(trial: _Trial) -> None:
    for case in trial.cases:
        state = trial.init(trial.params, trial.epoch, case.view)
        for _ in range(2):
            state = trial.step(trial.params, state, case.wrench, trial.params.dt)
        trial.view(trial.params, state)
    for name, count in trial.traces.items():
        expect(count == 1, "one trace per shape", f"{name} to be traced once for inputs of one shape and type", count)

    case = trial.cases[0]
    dynamics, params = trial.dynamics, trial.params
    state = dynamics.step(params, dynamics.init(params, trial.epoch, case.view), case.wrench, params.dt)
    compiled = trial.step(params, trial.init(params, trial.epoch, case.view), case.wrench, params.dt)
    _expect_alike(
        trial.view(params, compiled), dynamics.relative_state(params, state), trial.tolerance, "jit equals eager", ""
    )


def _expect_alike(came: Array, expected: Array, tolerance: float, check: str, where: str) -> None:
    """Two views (..., 13) within the tolerance, part by part, whatever the sign of their quaternions."""
    came, expected = View.of(np.asarray(came)), View.of(np.asarray(expected))
    sign = np.asarray(quat_sign(came.attitude, expected.attitude))[..., None]
    came = came._replace(attitude=came.attitude * sign)
    for part, ours, theirs in zip(View._fields, came, expected):
        expect(np.max(np.abs(ours - theirs)) <= tolerance, check, f"{part} {theirs}{where}", ours)


def _check_init(trial: _Trial) -> None:
    for case in trial.cases:
        start = trial.view(trial.params, trial.init(trial.params, trial.epoch, case.view))
        _expect_alike(start, case.view, trial.tolerance, "init inverts relative_state", f" {case.name}")
        quick = trial.params._replace(dt=trial.params.dt / 4)
        again = trial.view(quick, trial.init(quick, trial.epoch, case.view))
        _expect_alike(again, case.view, trial.tolerance, "the same start at any time step", f" {case.name}")


def _fly(trial: _Trial, case: _Case) -> Iterator[PhysicalState]:
    state = trial.init(trial.params, trial.epoch, case.view)
    for _ in range(_STEPS):
        yield state
        state = trial.step(trial.params, state, case.wrench, trial.params.dt)
    yield state


def _check_flight(trial: _Trial) -> None:
    flights = []
    for case in trial.cases:
        states = list(_fly(trial, case))
        views = np.stack([trial.view(trial.params, state) for state in states])
        expect(np.isfinite(views).all(), "finite numbers", f"a flight {case.name} of finite numbers", views)
        _check_clocks(trial, case, states)
        _check_attitude(trial, case, views)
        flights.append(views)

    def flight(view, wrench):
        def step(state, _):
            after = trial.dynamics.step(trial.params, state, wrench, trial.params.dt)
            return after, trial.dynamics.relative_state(trial.params, after)

        return jax.lax.scan(step, trial.dynamics.init(trial.params, trial.epoch, view), length=_STEPS)[1]

    batch = jax.jit(jax.vmap(flight))(*(jnp.stack(x) for x in zip(*(case[1:] for case in trial.cases))))
    for case, together, alone in zip(trial.cases, batch, flights):
        _expect_alike(together, alone[1:], trial.tolerance, "vmap equals a loop", f" {case.name}")


def _check_clocks(trial: _Trial, case: _Case, states: list[PhysicalState]) -> None:
    seconds = np.array([state.elapsed for state in states])
    expected = float(trial.params.dt) * np.arange(len(states))
    ticks = np.allclose(seconds, expected, rtol=0, atol=trial.tolerance)
    expect(ticks, "clocks", f"elapsed to advance by dt, to {expected[-1]:g} s {case.name}", f"{seconds[-1]:g} s")
    kept = np.array_equal(states[-1].epoch, states[0].epoch)
    expect(kept, "clocks", "the epoch to stay that of the start", f"{states[-1].epoch} after {states[0].epoch}")


def _check_attitude(trial: _Trial, case: _Case, views: np.ndarray) -> None:
    lengths = np.linalg.norm(View.of(views).attitude, axis=1)
    worst = lengths[np.argmax(np.abs(lengths - 1))]
    unit = abs(worst - 1) <= trial.tolerance
    expect(unit, "unit quaternion", f"an attitude of length 1 {case.name}", f"{worst:.9f}")


class _Motion(NamedTuple):
    """What a step did to position and attitude beside what velocity and rate say of it."""

    moved: Float[Array, "3"]
    velocity: Float[Array, "3"]
    rate: Float[Array, "3"]
    off: float
    """m/s between `moved` and `velocity`."""
    turned_off: float
    """rad/s between the turn and `rate`."""


def _check_kinematics(trial: _Trial) -> None:
    """Over a shorter step the mean of a derivative's ends is nearer to the truth, whatever the integrator's order."""
    for case in trial.cases:
        dt = float(trial.params.dt)
        long, short = _motion(trial, case, dt), _motion(trial, case, dt / 4)
        rounding = trial.tolerance / (dt / 4)
        expect(
            short.off <= max(long.off / 2, rounding),
            "velocity is the derivative of position",
            f"a position that moves at {short.velocity} m/s {case.name}",
            f"{short.moved} m/s",
        )
        expect(
            short.turned_off <= max(long.turned_off / 2, rounding),
            "rate is the derivative of attitude",
            f"an attitude that turns at {short.rate} rad/s (body axes) {case.name}",
            f"one {short.turned_off:.3g} rad/s beside it",
        )


def _motion(trial: _Trial, case: _Case, dt: float) -> _Motion:
    state = trial.init(trial.params, trial.epoch, case.view)
    later = trial.step(trial.params, state, case.wrench, jnp.asarray(dt, case.view.dtype))
    before, after = (View.of(trial.view(trial.params, at)) for at in (state, later))
    moved, velocity = (after.position - before.position) / dt, (before.velocity + after.velocity) / 2
    rate = (before.rate + after.rate) / 2
    turned = quat_multiply(before.attitude, quat_from_rotation_vector(rate * dt))
    apart = quat_angle(turned, after.attitude) / dt
    return _Motion(moved, velocity, rate, float(jnp.linalg.norm(moved - velocity)), float(apart))


def _check_gradients(trial: _Trial) -> None:
    def outcome(params, view, wrench):
        state = trial.dynamics.step(params, trial.dynamics.init(params, trial.epoch, view), wrench, params.dt)
        return jnp.sum(trial.dynamics.relative_state(params, state))

    slopes = jax.jit(jax.grad(outcome, argnums=(0, 1, 2), allow_int=True))
    for case in trial.cases:
        parameters, view, wrench = slopes(trial.params, case.view, case.wrench)
        named = {"params": parameters, "view": view, "wrench": wrench}
        for path, slope in jax.tree.leaves_with_path(named):
            if slope.dtype != jax.dtypes.float0:
                name = jax.tree_util.keystr(path)
                expect(
                    jnp.isfinite(slope).all(),
                    "finite gradients",
                    f"a finite gradient of one step with respect to {name} {case.name}",
                    np.asarray(slope),
                )


def _check_keys(adapter: gymnasium.Env) -> None:
    (first, _), (again, _), (other, _) = (adapter.reset(seed=seed) for seed in (0, 0, 1))
    expect(alike(first, again), "the same seed, the same episode", f"{first}", again)
    expect(not alike(first, other), "another seed, another episode", "another start", other)


def _check_actions(adapter: gymnasium.Env) -> None:
    largest = np.finfo(np.float64).max
    for value in (0.0, np.finfo(np.float64).smallest_subnormal, -largest, largest):
        adapter.reset(seed=0)
        for _ in range(_STEPS):
            observation, reward, terminated, truncated, info = adapter.step(np.full(6, value))
            expect(
                info["outcome"] != Outcome.DIVERGED,
                "extreme actions",
                f"dynamics that stay finite under actions {value:g}",
                "an episode that ended as 'diverged'",
            )
            for name, number in {"observation": observation, "reward": reward, **info}.items():
                finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(number))
                expect(finite, "extreme actions", f"a finite {name} under actions {value:g}", number)
            if terminated or truncated:
                break


def _adapter(subject: Any, env: DockingEnv) -> gymnasium.Env:
    if isinstance(subject, gymnasium.Env):
        return subject.unwrapped
    from owm_envs.adapters.gymnasium import DockingGymEnv

    return DockingGymEnv(env.config, dynamics=env.dynamics, sensors=env.given_sensors)


def _check_gymnasium(adapter: gymnasium.Env) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", category=UserWarning)
        # Unbounded measurements and forces in newtons are meant so.
        warnings.filterwarnings("ignore", message=".*A Box observation space m.*infinity.*")
        warnings.filterwarnings("ignore", message=".*For Box action spaces, we recommend using a symmetric.*")
        warnings.filterwarnings("ignore", message=".*not able to test alternative render modes.*")
        try:
            env_checker.check_env(adapter)
        except (AssertionError, UserWarning, gymnasium.error.Error) as error:
            raise AssertionError(f"gymnasium's check_env: {error}") from error
