"""A small stand-in for the environments: a rigid chaser near a station on a circular orbit, cooperative noise.

Serves the tests of the world model, which must not depend on the environments' package being complete.
"""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from astrojax.attitude import quat_conjugate, quat_multiply, quat_rotate
from astrojax.attitude import quat_from_rotation_vector as quat_exp
from astrojax.attitude import quat_to_rotation_vector as quat_log
from owm_envs.view import VIEW_SLICES, View

MASS = 12_000.0
INERTIA = (80_000.0, 80_000.0, 50_000.0)
FORCE, TORQUE = 1600.0, 2000.0
MEAN_MOTION = 1.1272e-3
SUBSTEP = 0.05
NOISE = (0.05, 0.002, 5e-5, 1e-5)
POLICIES = ("random", "dock", "orbit", "excite")


def derivative(view, action, orbital):
    """Return the time derivative of the view under body force and torque; `orbital` scales the mean motion."""
    n = MEAN_MOTION * orbital
    inertia = jnp.asarray(INERTIA, view.dtype)
    r, v, q, w = View.of(view)
    thrust = quat_rotate(q, action[:3]) / MASS
    coupling = jnp.stack([-n * n * r[0], 2 * n * v[2], 3 * n * n * r[2] - 2 * n * v[1]])
    frame = quat_rotate(quat_conjugate(q), jnp.asarray([1.0, 0.0, 0.0], view.dtype) * n)
    inertial = w + frame
    wdot = (action[3:] - jnp.cross(inertial, inertia * inertial)) / inertia + jnp.cross(w, frame)
    qdot = 0.5 * quat_multiply(q, jnp.concatenate([jnp.zeros_like(w[:1]), w]))
    return jnp.concatenate([v, thrust + coupling, qdot, wdot])


def substep(view, action, orbital=1.0):
    """Advance 0.05 s by the midpoint rule under a held action."""
    middle = view + 0.5 * SUBSTEP * derivative(view, action, orbital)
    view = view + SUBSTEP * derivative(middle, action, orbital)
    return view.at[VIEW_SLICES.attitude].divide(jnp.linalg.norm(View.of(view).attitude))


def measure(key, view, noise=1.0):
    """Return the view with cooperative noise, times `noise`."""
    eps = jax.random.normal(key, (4, 3), view.dtype) * (jnp.asarray(NOISE, view.dtype)[:, None] * noise / 3**0.5)
    r, v, q, w = View.of(view)
    return View(r + eps[0], v + eps[1], quat_multiply(q, quat_exp(eps[2])), w + eps[3]).numbers()


def pointing(direction):
    """Return a quaternion whose body +z looks along `direction`."""
    z = direction / jnp.linalg.norm(direction)
    q = jnp.stack([1.0 + z[2], -z[1], z[0], jnp.zeros_like(z[0])])
    return q / jnp.linalg.norm(q)


def pd(view, target, velocity, attitude):
    """Return the docking PD action towards a moving target pose."""
    r, v, q, w = View.of(view)
    inertia = jnp.asarray(INERTIA, view.dtype)
    force = quat_rotate(quat_conjugate(q), 16.0 * (target - r) + 880.0 * (velocity - v))
    error = quat_log(quat_multiply(quat_conjugate(q), attitude))
    torque = (800.0 * error - 16_000.0 * w) * inertia / max(INERTIA)
    return jnp.concatenate([jnp.clip(force, -FORCE, FORCE), jnp.clip(torque, -TORQUE, TORQUE)])


def start(key):
    """Draw an initial view: 100-225 m out, nose roughly to the origin, nearly at rest."""
    keys = jax.random.split(key, 5)
    direction = jax.random.normal(keys[0], (3,), jnp.float32)
    direction = direction / jnp.linalg.norm(direction)
    r = direction * jax.random.uniform(keys[1], (), jnp.float32, 100.0, 225.0)
    q = quat_multiply(pointing(-r), quat_exp(jax.random.normal(keys[2], (3,), jnp.float32) * 0.1))
    v = jax.random.normal(keys[3], (3,), jnp.float32) * 0.05
    return jnp.concatenate([r, v, q, jax.random.normal(keys[4], (3,), jnp.float32) * 0.005])


@partial(jax.jit, static_argnames=("steps",))
def fly(key, policy, steps, orbital=1.0, noise=1.0):
    """Fly one episode of `steps` 20 Hz steps; return measured and true views (steps + 1) and actions (steps)."""
    limit = jnp.asarray([FORCE] * 3 + [TORQUE] * 3, jnp.float32)
    k_start, k_goal, k_run = jax.random.split(key, 3)
    view = start(k_start)
    goal = jax.random.normal(k_goal, (3,), jnp.float32) * 15.0
    position = View.of(view).position
    axis = jnp.cross(position, goal + jnp.asarray([1.0, 2.0, 3.0], jnp.float32))
    axis = axis / jnp.linalg.norm(axis)
    radius = 80.0 + jnp.abs(goal[0])
    omega = 0.9 * jnp.sqrt(0.6 * FORCE / MASS / radius)
    inward = position / jnp.linalg.norm(position)

    def step(carry, t):
        view, held = carry
        k_noise, k_uniform, k_held = jax.random.split(jax.random.fold_in(k_run, t), 3)
        seen = measure(k_noise, view, noise)
        uniform = jax.random.uniform(k_uniform, (6,), jnp.float32, -1.0, 1.0) * limit
        held = jnp.where(t % 40 == 0, jax.random.uniform(k_held, (6,), jnp.float32, -1.0, 1.0), held)
        dock = pd(seen, goal, jnp.zeros(3, jnp.float32), pointing(-View.of(view).position + 0.1))
        arc = omega * SUBSTEP * t
        out = quat_rotate(quat_exp(axis * arc), inward)
        orbit = pd(seen, radius * out, radius * omega * jnp.cross(axis, out), pointing(-out))
        # Planner-like: a guided approach with strong actions held for two seconds on top, rates bounded by damping.
        mixed = dock * jnp.asarray([1.0] * 3 + [0.5] * 3, jnp.float32) + held * limit * 0.7
        action = jnp.stack([uniform, dock, orbit, jnp.clip(mixed, -limit, limit)])[policy]
        return (substep(view, action, orbital), held), (seen, view, action)

    times = jnp.arange(steps, dtype=jnp.int32)
    (last, _), (seen, true, action) = jax.lax.scan(step, (view, jnp.zeros(6, jnp.float32)), times)
    seen = jnp.concatenate([seen, measure(k_run, last, noise)[None]])
    return seen, jnp.concatenate([true, last[None]]), action


@partial(jax.jit, static_argnames=("steps",))
def replay(view, action, steps):
    """Fly held actions, one per 0.25 s, from a true view; return the `steps + 1` true views."""

    def step(view, action):
        after = jax.lax.fori_loop(0, 5, lambda _, x: substep(x, action), view)
        return after, after

    _, views = jax.lax.scan(step, view, action[:steps])
    return jnp.concatenate([view[None], views])


def episodes(seed, count, seconds=90.0, policies=POLICIES, orbital=1.0, noise=1.0):
    """Return `count` recorded episodes as objects with the fields that `owm.data.windows.from_episodes` reads."""
    steps = int(seconds / SUBSTEP)
    keys = jax.random.split(jax.random.key(seed), count)
    names = [policies[i % len(policies)] for i in range(count)]
    index = jnp.asarray([POLICIES.index(name) for name in names], jnp.int32)
    flown = jax.vmap(lambda k, p: fly(k, p, steps, orbital, noise))(keys, index)
    seen, true, action = (np.asarray(x) for x in flown)
    return [
        SimpleNamespace(
            observation={"state": seen[i]}, true_state=true[i], action=action[i], policy=names[i], port="none"
        )
        for i in range(count)
    ]
