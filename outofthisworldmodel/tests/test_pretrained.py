"""The checkpoint that ships with the package."""

import jax
import jax.numpy as jnp
import numpy as np

from owm.baselines.exact import ExactDynamics
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.policies import GIVEN, kind_of
from owm.interface import History, roll_out
from owm.motion.kinematics import view_error


def test_the_shipped_model_predicts_what_the_equations_of_motion_do():
    model, exact = load_world_model("pretrained"), ExactDynamics("iss-hcw")
    assert kind_of("pretrained") == "world model" in GIVEN
    half = np.sqrt(0.5)
    view = jnp.asarray([40.0, -80.0, 25.0, 0.5, 0.3, -0.2, half, 0, -half, 0, 0.004, -0.006, 0.005], jnp.float32)
    draws = jax.random.uniform(jax.random.key(0), (16, 6), jnp.float32, -0.3, 0.3)
    actions = jnp.repeat(draws * jnp.asarray([1600.0] * 3 + [500.0] * 3), 8, axis=0)[:127]  # each held for 2 s

    @jax.jit
    def truth(view, actions):
        start = History({"state": view[None]}, jnp.zeros((0, 6), jnp.float32), jnp.ones(1, bool))
        return roll_out(exact, exact.params, exact.encode(exact.params, start), actions)

    views = jnp.concatenate([view[None], truth(view, actions)])
    known = model.history_length
    history = History({"state": views[:known]}, actions[: known - 1], jnp.ones(known, bool))
    rest = actions[known - 1 :]

    @jax.jit
    def predict(params, history, actions):
        return roll_out(model, params, model.encode(params, history), actions)

    predicted = predict(model.params, history, rest)
    error = np.linalg.norm(np.asarray(view_error(predicted[-1], views[-1])).reshape(4, 3), axis=1)
    moved = np.linalg.norm(np.asarray(views[-1, :3] - views[known - 1, :3]))
    assert moved > 5.0
    assert error[0] < 0.1 and error[1] < 0.01 and np.degrees(error[2]) < 0.5 and np.degrees(error[3]) < 0.05
