"""Linear model-predictive control of the approach: a convex programme about Clohessy and Wiltshire's equations.

Everything is in the station frame. The decision variables are the accelerations of `N` steps; the states they lead to
are eliminated ("condensed"), which leaves a quadratic cost over a product of balls, one a step. The approach corridor
enters as a convex penalty, so that there is a solution wherever the chaser is.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import expm

from owm_envs.flags import own_promotion


class Corridor(NamedTuple):
    """The cone before a port: apex radius m, tangent of the half-angle, and where it is."""

    radius: Float[Array, ""] | float
    slope: Float[Array, ""] | float
    goal: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    """Rows: outward normal of the port and two unit vectors across it."""


class Tracking(NamedTuple):
    """The condensed problem, fixed once: what a start and accelerations do to the states, and the cost's weights.

    Attributes:
        free_position, free_velocity: states of the steps per metre and m/s of the start.
        forced_position, forced_velocity: the same per m/s2.
        position, velocity, effort: weights of squared errors (1/m2, s2/m2) and of squared accelerations (s4/m2).
        outside: weight of the squared distance outside the corridor, 1/m2.
        curvature: upper bound of the cost's second derivative.
    """

    free_position: Float[Array, "N 3 6"]
    free_velocity: Float[Array, "N 3 6"]
    forced_position: Float[Array, "N 3 M"]
    forced_velocity: Float[Array, "N 3 M"]
    position: float
    velocity: float
    effort: float
    outside: float
    curvature: float


def clohessy_wiltshire(rate: float, dt: float) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 3"]]:
    """Exact discretisation under a held acceleration, in axes x = orbit normal, y = aft, z = zenith.

    Args:
        rate: of the station's orbit, rad/s.
        dt: step, s.

    Source: Clohessy and Wiltshire (1960); axes as in `owm_envs.dynamics.hcw`.
    """
    flow = np.zeros((9, 9))
    flow[:3, 3:6] = np.eye(3)
    flow[3, 0], flow[5, 2] = -rate * rate, 3 * rate * rate
    flow[4, 5], flow[5, 4] = 2 * rate, -2 * rate
    flow[3:6, 6:] = np.eye(3)
    grown = expm(dt * flow)
    return grown[:6, :6], grown[:6, 6:]


def tracking(
    rate: float,
    steps: int = 20,
    dt: float = 1.0,
    position: float = 1.0,
    velocity: float = 8.0,
    effort: float = 256.0,
    outside: float = 3.0,
    dtype: str = "float32",
) -> Tracking:
    """Condense the problem.

    Args:
        rate: of the station's orbit, rad/s.
        steps, dt: of the horizon, s.
        position, velocity, effort, outside: weights, see `Tracking`; effort 256 closes the loop at 0.25 rad/s.
        dtype: of the result.
    """
    ahead, push = clohessy_wiltshire(rate, dt)
    powers = [np.eye(6)]
    for _ in range(steps):
        powers.append(ahead @ powers[-1])
    free = np.stack(powers[1:])
    forced = np.zeros((steps, 6, steps, 3))
    for k in range(steps):
        for j in range(k + 1):
            forced[k, :, j] = powers[k - j] @ push
    forced = forced.reshape(steps, 6, 3 * steps)
    by_position, by_velocity = (forced[:, part].reshape(3 * steps, -1) for part in (slice(0, 3), slice(3, 6)))
    # Two sides of the corridor at most bind at once, and count a little more than once for its slope.
    hessian = (position + 1.2 * outside) * by_position.T @ by_position + velocity * by_velocity.T @ by_velocity
    curvature = float(np.linalg.eigvalsh(hessian)[-1] + effort)
    arrays = (free[:, :3], free[:, 3:], forced[:, :3], forced[:, 3:])
    return Tracking(*(x.astype(dtype) for x in arrays), position, velocity, effort, outside, curvature)


@own_promotion()
def beyond(corridor: Corridor, positions: Float[Array, "N 3"]) -> tuple[Float[Array, ""], Float[Array, "N 3"]]:
    """Half the squared distances by which positions lie outside the four planes about the cone, and the gradient."""
    along, *across = jnp.asarray(corridor.axes) @ (positions - corridor.goal).T
    across = jnp.stack(across)  # (2, N)
    excess = jnp.maximum(jnp.abs(across) - corridor.radius - corridor.slope * jnp.maximum(along, 0), 0)
    sideways = jnp.einsum("in,ij->nj", excess * jnp.sign(across), corridor.axes[1:])
    forward = -corridor.slope * jnp.where(along > 0, jnp.sum(excess, axis=0), 0)[:, None] * corridor.axes[0]
    return 0.5 * jnp.sum(excess**2), sideways + forward


@own_promotion()
def solve(
    problem: Tracking,
    start: Float[Array, "6"],
    positions: Float[Array, "N 3"],
    velocities: Float[Array, "N 3"],
    corridor: Corridor,
    confined: Float[Array, ""],
    limit: Float[Array, ""] | float,
    guess: Float[Array, "N 3"],
    iterations: int = 80,
) -> Float[Array, "N 3"]:
    """Accelerations that follow a reference within a limit on each one's length.

    Args:
        problem: from `tracking`.
        start: position m and velocity m/s.
        positions, velocities: the reference after each step.
        corridor: the cone; confined: 1 where it holds, 0 where it does not.
        limit: m/s2. A ball, and not the box of the thrusters: whatever the attitude, the ball within the box is safe.
        guess: to start from.
        iterations: of the accelerated projected gradient method; fixed, so that it takes the same time always.

    Source: Beck and Teboulle (2009), A fast iterative shrinkage-thresholding algorithm, SIAM J. Imaging Sci. 2(1),
    with the restart of O'Donoghue and Candes (2015).
    """
    at, moving = problem.free_position @ start, problem.free_velocity @ start
    shape = guess.shape

    def gradient(flat: Array) -> Array:
        there = at + problem.forced_position @ flat
        off = problem.position * (there - positions)
        off = off + problem.outside * confined * beyond(corridor, there)[1]
        fast = problem.velocity * (moving + problem.forced_velocity @ flat - velocities)
        pulled = jnp.einsum("nim,ni->m", problem.forced_position, off)
        return pulled + jnp.einsum("nim,ni->m", problem.forced_velocity, fast) + problem.effort * flat

    def project(flat: Array) -> Array:
        steps = flat.reshape(shape)
        length = jnp.sqrt(jnp.sum(steps**2, axis=1, keepdims=True) + 1e-20)
        return (steps * jnp.minimum(1, limit / length)).reshape(-1)

    def iterate(_: int, carry: tuple) -> tuple:
        old, ahead, momentum = carry
        new = project(ahead - gradient(ahead) / problem.curvature)
        restart = jnp.sum((ahead - new) * (new - old)) > 0
        grown = jnp.where(restart, 1.0, 0.5 * (1 + jnp.sqrt(1 + 4 * momentum**2)))
        push = jnp.where(restart, 0.0, (momentum - 1) / grown)
        return new, new + push * (new - old), grown

    first = project(guess.reshape(-1))
    found, *_ = jax.lax.fori_loop(0, iterations, iterate, (first, first, jnp.ones((), first.dtype)))
    return found.reshape(shape)
