"""`check_world_model`: whether a world model of a user's own keeps the contract of `owm.interface`."""

import inspect
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from owm.interface import History, WorldModel, check_complete
from owm.motion.kinematics import advance, to_motion, to_view, view_error
from owm_envs.task.sensors import STATE
from owm_envs.testing.expect import expect, outline

_START = (60.0, -40.0, 30.0, -0.2, 0.1, -0.1, 0.5, 0.5, -0.5, 0.5, 2e-3, -1e-3, 1e-3)
_ACTION = (200.0, -150.0, 100.0, 40.0, -30.0, 20.0)
_FAR = (5.0, 1.0, 0.2, 0.05)
"""m, m/s, rad, rad/s: what an estimate may be off the last of its noiseless measurements."""
_ROUNDING = 1e-3


def check_world_model(model: WorldModel, history: History | None = None) -> None:
    """Check that a world model can be planned with and scored, at the precision that it computes in.

    In this order: its parts; that it can be a static argument; that its functions can be traced and keep types and
    shapes of the state (`lax.scan` carries it); the view that `decode` reads out; finite numbers, from a history of a
    single measurement too; the same step twice; vmap equals a loop; samples that follow their key.

    Args:
        history: whole and valid, for a model that looks at more than the state part; a made-up one of that when None.

    Raises:
        AssertionError: naming the check that failed, what was expected and what came, on one line.
    """
    expect(not inspect.isclass(model), "interface", "an object, made with its class", f"the class {model!r}")
    try:
        check_complete(model)
    except TypeError as error:
        raise AssertionError(f"interface: {error}") from None
    length, dt = model.history_length, model.dt
    expect(isinstance(model.name, str), "interface", "name to be text", repr(model.name))
    whole = isinstance(length, int | np.integer) and length > 0
    expect(whole, "interface", "history_length to be a whole number from 1 on", repr(length))
    expect(isinstance(dt, float | int) and dt > 0, "interface", "dt to be a positive number of seconds", repr(dt))
    try:
        hash(model)
    except TypeError as error:
        raise AssertionError(f"static: expected a model that can be hashed (a frozen dataclass), got {error}") from None
    with jax.enable_x64(getattr(model, "precision", "float32") == "float64"):
        _check_functions(model, _history(int(length), float(dt)) if history is None else history)


def _history(length: int, dt: float) -> History:
    """Measurements of a body that coasts."""
    motion = to_motion(jnp.asarray(_START, jnp.float32), jnp.asarray(_START, jnp.float32))
    views = [to_view(motion)]
    for _ in range(length - 1):
        motion = advance(motion, jnp.zeros(6, jnp.float32), dt)
        views.append(to_view(motion))
    return History({STATE: jnp.stack(views)}, jnp.zeros((length - 1, 6), jnp.float32), jnp.ones(length, bool))


def _check_functions(model: WorldModel, history: History) -> None:
    params, action = model.params, jnp.asarray(_ACTION, jnp.float32)
    last = {name: values[-1] for name, values in history.observation.items()}
    view = last[STATE]
    key = jax.random.key(0)
    functions = {
        "encode": lambda params, history: model.encode(params, history),
        "step": lambda params, state: model.step(params, None, action, state),
        "step with a key": lambda params, state: model.step(params, key, action, state),
        "observe": lambda params, state: model.observe(params, state, action, last),
        "decode": lambda params, state: model.decode(params, state),
    }

    state = outline("encode", functions["encode"], params, history)
    for name in ("step", "step with a key", "observe"):
        after = outline(name, functions[name], params, state)
        shapes = [[(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(tree)] for tree in (state, after)]
        same = jax.tree.structure(after) == jax.tree.structure(state) and shapes[0] == shapes[1]
        expect(same, "types", f"{name} to return a state like encode's, {state}", after)
    seen = outline("decode", functions["decode"], params, state)
    expect(isinstance(seen, dict) and "state" in seen, "types", 'decode to return a dict with "state"', seen)
    form = seen["state"]
    expect(form.shape == (13,), "types", 'the view "state" to be of shape (13,)', form.shape)
    expect(jnp.issubdtype(form.dtype, jnp.floating), "types", 'the view "state" to be of floats', form.dtype)

    # Each function is compiled once: of the filter's among our own models each takes seconds.
    encode, observe, decode = (jax.jit(functions[name]) for name in ("encode", "observe", "decode"))
    step = jax.jit(lambda params, key, state: model.step(params, key, action, state))

    def flight(history, key):
        """The view now, after a step, and after a measurement."""
        state = encode(params, history)
        return [decode(params, each)["state"] for each in (state, step(params, key, state), observe(params, state))]

    views = np.asarray(flight(history, None))
    single = history._replace(
        observation={name: jnp.broadcast_to(last[name], values.shape) for name, values in history.observation.items()},
        valid=jnp.arange(len(history.valid)) == len(history.valid) - 1,
    )
    for given, of in ((history, "a whole history"), (single, "a history of a single measurement")):
        found = np.asarray(flight(given, None))
        expect(np.isfinite(found).all(), "finite numbers", f"finite views from {of}", found.tolist())
        off = np.linalg.norm(np.asarray(view_error(jnp.asarray(found[0], jnp.float32), view)).reshape(4, 3), axis=1)
        near = (off < np.array(_FAR)).all()
        expect(near, "station frame", f"encode and decode to give the last measurement of {of}", f"one off by {off} SI")
    sizes = np.linalg.norm(views[:, 6:10], axis=1)
    expect(np.abs(sizes - 1).max() < _ROUNDING, "unit quaternion", "attitudes of length 1", sizes.tolist())
    again = np.asarray(flight(history, None))
    expect(np.array_equal(again, views), "the same step twice", f"{views[1]} without a key", again[1])
    keys = jax.random.split(jax.random.key(1), 2)
    state = encode(params, history)

    @jax.jit
    @partial(jax.vmap, in_axes=(None, 0, None))
    def stepped(params, key, state):
        return functions["decode"](params, model.step(params, key, action, state))["state"]

    loop = [flight(history, key)[1] for key in keys]
    _alike(stepped(params, keys, state), np.asarray(loop), "vmap equals a loop")
    _alike([flight(history, keys[0])[1]], np.asarray(loop[:1]), "the same key, the same sample")


def _alike(came: Any, expected: np.ndarray, check: str) -> None:
    came = np.asarray(came)
    close = np.allclose(came, expected, rtol=_ROUNDING, atol=_ROUNDING)
    expect(close, check, f"{expected.tolist()}", came.tolist())
