"""When something happens on the way: sign changes of a function of time and state, found and refined."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from astrojax._types import FloatScalar, Scalar
from astrojax.propagate.adaptive import flattened
from astrojax.propagate.dense import Trajectory, between
from astrojax.propagate.dormand_prince import DORMAND_PRINCE
from astrojax.propagate.methods import Method

_HALVINGS, _POLISH = 30, 3


class Events(NamedTuple):
    """Events on a trajectory, in the order they were flown through.

    Attributes:
        t: (E,) times; y: states then, stacked. Where `found` is False they are those of the trajectory's end.
        found: (E,) whether there was a further event.
        count: all there are, which may be more than E.
    """

    t: Float[Array, "E"]
    y: PyTree
    found: Bool[Array, "E"]
    count: Int[Array, ""]


def events(
    path: Trajectory,
    g: Callable[[Scalar, PyTree], FloatScalar],
    f: Callable[..., PyTree],
    *args: Any,
    method: Method = DORMAND_PRINCE,
    direction: int = 0,
    samples: int = 4,
    max_events: int = 8,
) -> Events:
    """Times and states at which g(t, y) changes its sign.

    Args:
        path: from `trajectory`.
        g: event function of time and state, such as those of `orbits.events`.
        f, args, method: what the trajectory was made with: the last refinements are steps of it, so that an event is
            as accurate as the trajectory, not as its interpolant.
        direction: static: 1 for signs that rise along the trajectory, -1 for those that fall, 0 for both.
        samples: static: how often g is looked at in a step; two events between two looks are missed.
        max_events: static: how many to return.

    Raises:
        ValueError: `direction`, `samples` or `max_events` is none of those.
    """
    if direction not in (-1, 0, 1):
        raise ValueError(f"direction: expected -1, 0 or 1, got {direction}")
    if samples < 1 or max_events < 1:
        raise ValueError(f"samples, max_events: expected at least 1, got {samples} and {max_events}")
    dtype = path.t.dtype
    rows = path.bend.shape[0]
    flat, _, _ = flattened(f, path.unravel(path.y[0]), args)

    def at(i, share):
        h = path.t[i + 1] - path.t[i]
        return g(path.t[i] + share * h, path.unravel(between(path, i, share)))

    index = jnp.arange(rows, dtype=jnp.int32)
    shares = jnp.arange(samples + 1, dtype=dtype) / samples
    values = jax.vmap(lambda i: jax.vmap(lambda s: at(i, s))(shares))(index)
    low, high = values[:, :-1], values[:, 1:]
    rising, falling = (low < 0) & (high >= 0), (low > 0) & (high <= 0)
    crossed = {1: rising, -1: falling, 0: rising | falling}[direction] & (index < path.steps)[:, None]
    found = jnp.nonzero(jnp.ravel(crossed), size=max_events, fill_value=-1)[0].astype(jnp.int32)

    def refine(where):
        i, k = jnp.maximum(where, 0) // samples, jnp.maximum(where, 0) % samples
        a, b = shares[k], shares[k + 1]
        negative = at(i, a) < 0

        def halve(_, ends):
            a, b = ends
            middle = 0.5 * (a + b)
            before = (at(i, middle) < 0) == negative
            return jnp.where(before, middle, a), jnp.where(before, b, middle)

        a, b = jax.lax.fori_loop(0, _HALVINGS, halve, (a, b))
        h = path.t[i + 1] - path.t[i]

        def truth(share):
            """g after a step of the method itself."""
            y = method.step(flat, path.t[i], path.y[i], path.slope[i], share * h).y
            return g(path.t[i] + share * h, path.unravel(y)), y

        def newton(share):
            # Derivative along the trajectory, by the interpolant: an approximate one does for the last few digits.
            value, _ = truth(share)
            _, rate = jax.jvp(lambda s: at(i, s), (share,), (jnp.ones_like(share),))
            move = jnp.where(rate == 0, 0.0, value / jnp.where(rate == 0, 1.0, rate))
            return jnp.clip(share - move, shares[k], shares[k + 1])

        share = 0.5 * (a + b)
        for _ in range(_POLISH):
            share = newton(share)
        _, y = truth(share)
        happened = where >= 0
        t = jnp.where(happened, path.t[i] + share * h, path.t[-1])
        return t, path.unravel(jnp.where(happened, y, path.y[-1])), happened

    t, y, happened = jax.vmap(refine)(found)
    return Events(t, y, happened, jnp.sum(crossed, dtype=jnp.int32))
