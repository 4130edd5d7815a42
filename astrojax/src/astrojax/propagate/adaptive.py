"""Integration with steps as long as a tolerance allows.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, sec. II.4: the error's norm (4.11), the
first step, and the controller that looks at two errors (Gustafsson 1991, ACM Trans. Math. Softw. 17(4), 533).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from astrojax._types import FloatScalar, Scalar
from astrojax.propagate.dormand_prince import DORMAND_PRINCE
from astrojax.propagate.methods import Method

SUCCESS = 0
"""Status of an integration: the end was reached."""
TOO_MANY_STEPS = 1
"""Status: `max_steps` were tried before the end."""
STEP_TOO_SMALL = 2
"""Status: the tolerance wants steps too short for the time's digits."""
NOT_FINITE = 3
"""Status: the derivative was no number however short the step."""
_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 5.0
_FINEST = 16.0  # shortest step, in units of the time's last digit


class Solution(NamedTuple):
    """Where an integration ended.

    Attributes:
        t: time reached, the one asked for if `status` is `SUCCESS`.
        y: state there, of the structure that was given; never NaN.
        status: `SUCCESS`, `TOO_MANY_STEPS`, `STEP_TOO_SMALL` or `NOT_FINITE`.
        steps: accepted; rejected: tried in vain.
    """

    t: FloatScalar
    y: PyTree
    status: Int[Array, ""]
    steps: Int[Array, ""]
    rejected: Int[Array, ""]


class Progress(NamedTuple):
    """What goes from step to step."""

    t: FloatScalar
    y: Float[Array, "n"]
    slope: Float[Array, "n"]
    h: FloatScalar
    error: FloatScalar
    steps: Int[Array, ""]
    rejected: Int[Array, ""]
    just_rejected: Bool[Array, ""]
    status: Int[Array, ""]


RUNNING = -1


def integrate(
    f: Callable[..., PyTree],
    t0: Scalar,
    y0: PyTree,
    t1: Scalar,
    *args: Any,
    method: Method = DORMAND_PRINCE,
    rtol: Scalar = 1e-9,
    atol: ArrayLike = 1e-9,
    first_step: Scalar | None = None,
    max_step: Scalar | None = None,
    max_steps: int = 4096,
    bounded: bool = False,
) -> Solution:
    """State at t1 of dy/dt = f(t, y, *args), by steps within a tolerance.

    Args:
        f: derivative, returning the structure of `y0`.
        t0: time at the start [s].
        y0: pytree of arrays of one dtype; for `NYSTROM_12` one array, position then velocity.
        t1: time at the end [s], before t0 to go backwards.
        args: handed to `f` unchanged.
        method: static: `DORMAND_PRINCE`, `FEHLBERG` or `NYSTROM_12`.
        rtol: relative tolerance of a step's error.
        atol: absolute tolerance of it, for all components or (n,) one for each.
        first_step: length of the first step tried [s]; if None, from the derivative.
        max_step: longest step [s]; if None, the whole way.
        max_steps: static: steps tried at most.
        bounded: static: take exactly `max_steps` turns of a loop, those after the end idle. Slower, but reverse-mode
            derivatives need it. Forward mode and `vmap` work either way; derivatives are those of the steps taken, at
            fixed lengths.

    Raises:
        ValueError: `max_steps` is less than one, or the state does not fit the method.

    Validity: non-stiff equations. In float32 ask for an rtol of 1e-6 or more.
    """
    flat, y, unravel = flattened(f, y0, args)
    checked(method, y, max_steps)
    start, step = stepper(flat, t0, y, t1, method, rtol, atol, first_step, max_step)

    end, _ = advanced(lambda p, _: (step(p)[0], None), start, None, max_steps, bounded)
    return Solution(end.t, unravel(end.y), end.status, end.steps, end.rejected)


def advanced(turn: Callable, start: Progress, kept: PyTree, max_steps: int, bounded: bool) -> tuple[Progress, PyTree]:
    """Where turns of (progress, kept) come to, once the end is reached or `max_steps` were tried."""

    def going(carry):
        return (carry[0].status == RUNNING) & (carry[0].steps + carry[0].rejected < max_steps)

    if bounded:

        def body(carry, _):
            return select(going(carry), turn(*carry), carry), None

        (end, kept), _ = jax.lax.scan(body, (start, kept), length=max_steps)
    else:
        end, kept = jax.lax.while_loop(going, lambda carry: turn(*carry), (start, kept))
    return end._replace(status=jnp.where(end.status == RUNNING, TOO_MANY_STEPS, end.status)), kept


def flattened(f: Callable, y0: PyTree, args: tuple) -> tuple[Callable, Float[Array, "n"], Callable]:
    """The derivative and the state as those of one vector, and the way back."""
    y, unravel = ravel_pytree(y0)
    if not jnp.issubdtype(y.dtype, jnp.floating):
        raise ValueError(f"y0: expected floating-point numbers, got {y.dtype}")
    return lambda t, y: ravel_pytree(f(t, unravel(y), *args))[0], y, unravel


def checked(method: Method, y: Float[Array, "n"], max_steps: int) -> None:
    """Refuse what no integrator here can do."""
    if max_steps < 1:
        raise ValueError(f"max_steps: expected at least 1, got {max_steps}")
    if method.name.startswith("Runge-Kutta-Nystrom") and y.size % 2:
        raise ValueError(f"y0: {method.name} expects as many velocities as positions, got {y.size} numbers")


def select(condition: Bool[Array, ""], new: PyTree, old: PyTree) -> PyTree:
    """One structure of arrays or the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def stepper(
    f: Callable,
    t0: Scalar,
    y: Float[Array, "n"],
    t1: Scalar,
    method: Method,
    rtol: Scalar,
    atol: ArrayLike,
    first_step: Scalar | None,
    max_step: Scalar | None,
) -> tuple[Progress, Callable]:
    """Where to begin, and a function from one `Progress` to the next and the `Step` tried with its length."""
    dtype = y.dtype
    t0, t1, rtol, atol = (jnp.asarray(x, dtype) for x in (t0, t1, rtol, atol))
    sign = jnp.where(t1 >= t0, 1.0, -1.0).astype(dtype)
    longest = jnp.abs(t1 - t0) if max_step is None else jnp.asarray(max_step, dtype)
    longest = jax.lax.stop_gradient(longest)
    slope = f(t0, y)

    def norm(error, a, b):
        scaled = error / (atol + rtol * jnp.maximum(jnp.abs(a), jnp.abs(b)))
        return jax.lax.stop_gradient(jnp.sqrt(jnp.mean(jax.lax.stop_gradient(scaled) ** 2)))

    if first_step is None:
        h = jax.lax.stop_gradient(_first_step(f, t0, y, slope, sign, norm, longest, method))
    else:
        h = jnp.asarray(first_step, dtype)
    none = jnp.zeros((), jnp.int32)
    start = Progress(
        t=t0,
        y=y,
        slope=slope,
        h=jax.lax.stop_gradient(jnp.minimum(h, longest)),
        error=jnp.ones((), dtype),
        steps=none,
        rejected=none,
        just_rejected=jnp.zeros((), bool),
        status=jnp.where(t0 == t1, SUCCESS, RUNNING).astype(jnp.int32),
    )
    exponent = 1.0 / (method.error_order + 1.0)
    eps = float(jnp.finfo(dtype).eps)

    def turn(p):
        left = jnp.abs(t1 - p.t)
        last = p.h >= left
        # The last step is the way to t1 itself, which carries its derivative.
        h = jnp.where(last, t1 - p.t, sign * p.h)
        tried = method.step(f, p.t, p.y, p.slope, h)
        error = norm(tried.error, p.y, tried.y)
        finite = jnp.isfinite(error) & jnp.all(jnp.isfinite(tried.y)) & jnp.all(jnp.isfinite(tried.last))
        error = jnp.maximum(jnp.where(finite, error, 1e6), 1e-12)
        accept = finite & (error <= 1.0)
        factor = _SAFETY * error ** (-0.85 * exponent) * p.error ** (0.2 * exponent)
        shrunk = _SAFETY * error**-exponent
        factor = jnp.where(accept, factor, shrunk)
        factor = jnp.clip(factor, _SHRINK, jnp.where(p.just_rejected | ~accept, 1.0, _GROW))
        size = jax.lax.stop_gradient(jnp.minimum(jnp.abs(h) * factor, longest))
        tiny = ~accept & (size <= _FINEST * eps * jnp.maximum(jnp.abs(p.t), jnp.abs(t1 - t0) * eps))
        tiny |= (p.t + h == p.t) & ~last
        failed = jnp.where(tiny, jnp.where(finite, STEP_TOO_SMALL, NOT_FINITE), RUNNING)
        status = jnp.where(accept & last, SUCCESS, failed).astype(jnp.int32)
        taken = Progress(
            t=jnp.where(last, t1, p.t + h),
            y=tried.y,
            slope=tried.last,
            h=size,
            error=error,
            steps=p.steps + 1,
            rejected=p.rejected,
            just_rejected=~accept,
            status=status,
        )
        stay = p._replace(h=size, rejected=p.rejected + 1, just_rejected=~accept, status=status)
        return select(accept, taken, stay), (tried, h, accept)

    return start, turn


def _first_step(f, t0, y, slope, sign, norm, longest, method):
    """A step whose error an explicit Euler step would make a hundredth of the tolerance."""
    size, speed = norm(y, y, y), norm(slope, y, y)
    known = (size > 1e-5) & (speed > 1e-5)
    guess = jnp.where(known, 0.01 * size / jnp.where(known, speed, 1.0), 1e-6)
    guess = jnp.minimum(guess, longest)
    bend = norm(f(t0 + sign * guess, y + sign * guess * slope) - slope, y, y) / jnp.where(guess > 0, guess, 1.0)
    steepest = jnp.maximum(speed, bend)
    flat = steepest <= 1e-15
    fine = jnp.where(
        flat, jnp.maximum(1e-6, guess * 1e-3), (0.01 / jnp.where(flat, 1.0, steepest)) ** (1.0 / (method.order + 1.0))
    )
    return jnp.minimum(100.0 * guess, fine)
