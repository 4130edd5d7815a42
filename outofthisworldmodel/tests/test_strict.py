"""World models, planner and training loss under JAX's strictness flags."""

from typing import get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import LeastSquares
from owm.interface import History
from owm.model.backbones import BACKBONES
from owm.model.config import ModelConfig
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.motion.linear import LinearMap
from owm.planning import mpc, mppi
from owm.planning.config import Objective, PlannerConfig
from owm.training.loss import draw, window_losses
from owm_envs.field import GeodesicField
from owm_envs.policies.guidance import Goal, drift_beside

CONFIG = {"width": 16, "heads": 2, "window": 5, "head_width": 16}
LIMIT = (1600.0,) * 3 + (2000.0,) * 3
LEARNED = [*((stream, "transformer") for stream in STREAMS), *(("kinematic", name) for name in BACKBONES)]
DEPTH = 3


def shaped(*shape, dtype=jnp.float32):
    return jax.ShapeDtypeStruct(shape, dtype)


DRIFT = drift_beside(6_795_000.0)
FIELD = GeodesicField(
    nodes=shaped(1, 16, 4),
    clearances=shaped(16),
    origins=shaped(2, 3),
    spacings=shaped(2),
    shapes=shaped(2, 3, dtype=jnp.int32),
    goals=shaped(1, 3),
)


def learned(stream, backbone):
    """A model and the shapes of its numbers."""
    config = ModelConfig(stream=stream, backbone=backbone, **CONFIG)
    network = eqx.filter_eval_shape(lambda: Network(config, key=jax.random.key(0)))
    return LearnedWorldModel(config, None), Params(network, STREAMS[stream].skeleton(jnp.float32))


def replanned(model, params, objective="geodesic"):
    """The shapes of a replan's wrenches."""
    config = PlannerConfig(candidates=4, horizon=6, chunk=2, knots=3, objective=objective)
    length = model.history_length
    history = History({"state": shaped(length, 13)}, shaped(length - 1, 6), shaped(length, dtype=bool))

    def replan(params, field, pose, history, committed):
        problem = mppi.Problem(params, config.tuning(LIMIT), Goal(field, np.int32(0), pose, DRIFT))
        state = mppi.init_planner(config.shape)
        return mppi.plan(model, config.shape, problem, history, state, committed=committed, key=jax.random.key(0))

    return jax.eval_shape(replan, params, FIELD, shaped(7), history, shaped(0, 6))[0].shape


@pytest.mark.parametrize(("stream", "backbone"), dict.fromkeys(LEARNED))
def test_learned_models_plan_and_train(stream, backbone, jax_flags):
    model, params = learned(stream, backbone)
    length = model.history_length + DEPTH

    def trained(params, observation, action):
        draws = draw(jax.random.key(0), 1, length - 1, DEPTH, params.network.stream, jnp.float32)
        draws = jax.tree.map(lambda x: x[0], draws)
        return sum(window_losses(model, params, {"state": observation}, action, 2, 0.5, draws))

    def onward(params, state, action, observation):
        sample = model.step(params, jax.random.key(0), action, state)
        return model.decode(params, model.observe(params, sample, action, {"state": observation}))["state"]

    with jax_flags(strict=True):
        assert replanned(model, params) == (2, 6)
        lost = jax.eval_shape(trained, params, shaped(length, 13), shaped(length - 1, 6))
        history = History({"state": shaped(8, 13)}, shaped(7, 6), shaped(8, dtype=bool))
        state = jax.eval_shape(model.encode, params, history)
        assert jax.eval_shape(onward, params, state, shaped(6), shaped(13)).shape == (13,)
    assert lost.shape == ()


@pytest.mark.parametrize("objective", get_args(Objective))
@pytest.mark.parametrize("model", ["constant velocity", "least squares"])
def test_simple_models_plan(model, objective, jax_flags):
    linear = LinearMap.skeleton(jnp.float32)
    model, params = (ConstantVelocity(), ()) if model == "constant velocity" else (LeastSquares(linear), linear)
    with jax_flags(strict=True):
        assert replanned(model, params, objective) == (2, 6)


def test_linear_control_solves(jax_flags):
    problem = mpc.tracking(1.1e-3, steps=4)
    cone = mpc.Corridor(0.5, 0.2, jnp.zeros(3), jnp.eye(3))

    def solved(start, reference):
        return mpc.solve(problem, start, reference, reference, cone, jnp.float32(1.0), 0.1, reference, iterations=3)

    with jax_flags(strict=True):
        assert jax.eval_shape(solved, shaped(6), shaped(4, 3)).shape == (4, 3)
