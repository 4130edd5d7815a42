"""The environment's dynamics as a world model."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm.baselines.exact import ExactDynamics
from owm.interface import History, roll_out
from owm_envs.config import load_config
from owm_envs.config.params import params_from_config
from owm_envs.dynamics import DYNAMICS
from owm_envs.view import View

VIEW = np.array([60.0, -90.0, 40.0, 0.5, 2.0, -1.0, 0.6, 0.0, 0.8, 0.0, 0.01, -0.02, 0.005])
WRENCHES = np.random.default_rng(0).uniform(-1, 1, (64, 6)) * np.array([1600.0] * 3 + [2000.0] * 3)


def history_at(view):
    return History({"state": view[None]}, np.zeros((0, 6)), np.ones(1, bool))


@pytest.mark.parametrize("fidelity", ["iss", "iss-hcw", "iss-numerical"])
def test_follows_the_environment_of_its_fidelity(fidelity):
    """16 s of wild wrenches, started three days from the model's epoch: within a centimetre and 1e-4 rad."""
    model = ExactDynamics(fidelity)
    config = load_config(fidelity=fidelity, precision=model.precision)
    dynamics = DYNAMICS[fidelity](config)
    with jax.enable_x64(model.precision == "float64"):
        dtype = jnp.dtype(model.precision)
        params = params_from_config(config)
        view, wrenches = jnp.asarray(VIEW, dtype), jnp.asarray(WRENCHES, dtype)

        @jax.jit
        def truth(params, view, wrenches):
            epoch = params.chief.epoch + jnp.asarray([3.0, 4000.0], dtype)

            def decide(state, wrench):
                state = jax.lax.fori_loop(0, 5, lambda _, s: dynamics.step(params, s, wrench, params.dt), state)
                return state, dynamics.relative_state(params, state)

            return jax.lax.scan(decide, dynamics.init(params, epoch, view), wrenches)[1]

        @jax.jit
        def predict(params, view, wrenches):
            return roll_out(model, params, model.encode(params, history_at(view)), wrenches)

        expected = View.of(np.asarray(truth(params, view, wrenches)))
        predicted = View.of(np.asarray(predict(model.params, view, wrenches)))
    assert np.abs(predicted.position - expected.position).max() < 0.01
    assert np.abs(predicted.velocity - expected.velocity).max() < 1e-3
    turn = 2 * np.arccos(np.minimum(1, np.abs(np.sum(predicted.attitude * expected.attitude, axis=1))))
    assert turn.max() < 2e-3 if model.precision == "float32" else turn.max() < 1e-4
    assert np.abs(predicted.rate - expected.rate).max() < 1e-5


def test_observing_starts_again_from_the_measurement_one_step_later():
    model = ExactDynamics("iss-hcw")
    view = VIEW.astype(np.float32)

    @jax.jit
    def observed(params, history, view):
        state = model.observe(params, model.encode(params, history), WRENCHES[0], {"state": view})
        return model.decode(params, state)["state"], state.epoch

    seen, epoch = observed(model.params, history_at(0.5 * view), view)
    np.testing.assert_allclose(seen, view, atol=1e-6)
    assert float(epoch[1] - model.params.chief.epoch[1]) == pytest.approx(0.25)


def test_takes_the_vehicle_from_a_configuration():
    heavy = ExactDynamics("iss-hcw", load_config(fidelity="iss-hcw", chaser={"mass": 15_000.0}))
    assert float(heavy.params.chaser.mass) == 15_000.0
    light = ExactDynamics("iss-hcw")
    assert heavy == light and hash(heavy) == hash(light)  # so that one compiled planner serves both


def test_says_what_it_needs():
    model = ExactDynamics()
    with pytest.raises(RuntimeError, match="64-bit mode"):
        model.encode(model.params, history_at(VIEW.astype(np.float32)))
    with pytest.raises(ValueError, match="did you mean 'iss-numerical'"):
        ExactDynamics("iss-numeric")
