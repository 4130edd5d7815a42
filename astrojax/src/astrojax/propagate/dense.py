"""A whole trajectory, to be asked for any time on the way.

Source: the interpolants are those of Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, sec. II.6:
the cubic through both ends (6.7), with a term more for Dormand and Prince's method (6.12).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from astrojax._types import FloatScalar, Scalar
from astrojax.propagate.adaptive import advanced, checked, flattened, stepper
from astrojax.propagate.dormand_prince import DORMAND_PRINCE
from astrojax.propagate.methods import Method


class Trajectory(NamedTuple):
    """The steps of an integration.

    Attributes:
        t: (S + 1,) times the steps begin at, and the end; those after the last accepted step repeat it.
        y: (S + 1, n) states there, flattened; slope: (S + 1, n) derivatives.
        bend: (S, n) what the method's interpolant adds.
        status: as in `Solution`; with `TOO_MANY_STEPS` the trajectory ends early.
        steps: accepted; rejected: tried in vain.
        unravel: from a flattened state to its structure.
    """

    t: Float[Array, "S+1"]
    y: Float[Array, "S+1 n"]
    slope: Float[Array, "S+1 n"]
    bend: Float[Array, "S n"]
    status: Int[Array, ""]
    steps: Int[Array, ""]
    rejected: Int[Array, ""]
    unravel: Callable


def trajectory(
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
    max_steps: int = 512,
    bounded: bool = False,
) -> Trajectory:
    """Every step from t0 to t1 of dy/dt = f(t, y, *args), for `interpolate` and `events`.

    Args:
        max_steps: static: steps tried at most, each of which has its room.
        bounded: static: as for `integrate`, for reverse-mode derivatives.
        f, t0, y0, t1, args, method, rtol, atol, first_step, max_step: as for `integrate`.

    Raises:
        ValueError: as `integrate`.
    """
    flat, y, unravel = flattened(f, y0, args)
    checked(method, y, max_steps)
    start, step = stepper(flat, t0, y, t1, method, rtol, atol, first_step, max_step)
    empty = jnp.zeros((max_steps + 1, y.size), y.dtype)
    ts = jnp.full(max_steps + 1, start.t)
    room = (ts, empty.at[0].set(start.y), empty.at[0].set(start.slope), empty[1:])

    def turn(p, kept):
        ts, ys, slopes, bends = kept
        after, (tried, _, accept) = step(p)
        at = jnp.where(accept, p.steps, max_steps + 1)  # a rejected step is written nowhere
        ts = ts.at[at + 1].set(after.t, mode="drop")
        ys = ys.at[at + 1].set(after.y, mode="drop")
        slopes = slopes.at[at + 1].set(after.slope, mode="drop")
        bends = bends.at[at].set(tried.bend, mode="drop")
        return after, (ts, ys, slopes, bends)

    end, (ts, ys, slopes, bends) = advanced(turn, start, room, max_steps, bounded)
    later = jnp.arange(max_steps + 1, dtype=jnp.int32) > end.steps
    ts = jnp.where(later, end.t, ts)
    ys, slopes = (jnp.where(later[:, None], a[None], b) for a, b in ((end.y, ys), (end.slope, slopes)))
    return Trajectory(ts, ys, slopes, bends, end.status, end.steps, end.rejected, Partial(unravel))


def interpolate(path: Trajectory, t: Scalar) -> tuple[PyTree, Bool[Array, ""]]:
    """State of a trajectory at a time, and whether the trajectory covers it.

    Args:
        path: from `trajectory`.
        t: time [s]; outside the trajectory its nearest end is taken, and the flag is False.

    Validity: order 4 for `DORMAND_PRINCE` and 3 for the others, over steps as long as the method takes.
    """
    t = jnp.asarray(t, path.t.dtype)
    i, share, inside = _locate(path, t)
    return path.unravel(between(path, i, share)), inside


def _locate(path, t):
    """Step a time lies in, how far along, and whether it lies in any."""
    forward = path.t[-1] >= path.t[0]
    sign = jnp.where(forward, 1.0, -1.0).astype(t.dtype)
    inside = (sign * (t - path.t[0]) >= 0) & (sign * (t - path.t[-1]) <= 0)
    i = jnp.searchsorted(sign * path.t, sign * t, side="right").astype(jnp.int32) - 1
    i = jnp.clip(i, 0, jnp.maximum(path.steps.astype(jnp.int32) - 1, 0))
    h = path.t[i + 1] - path.t[i]
    share = (t - path.t[i]) / jnp.where(h == 0, 1.0, h)
    return i, jnp.clip(share, 0.0, 1.0), inside


def between(path: Trajectory, i: Int[Array, ""], share: FloatScalar) -> Float[Array, "n"]:
    """State inside step i, at a share of it from 0 to 1, flattened."""
    h = path.t[i + 1] - path.t[i]
    y0, y1 = path.y[i], path.y[i + 1]
    rise = y1 - y0
    start = h * path.slope[i] - rise
    end = rise - h * path.slope[i + 1] - start
    rest = 1.0 - share
    return y0 + share * (rise + rest * (start + share * (end + rest * path.bend[i])))
