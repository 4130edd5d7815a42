"""`owm.testing.check_world_model` passes all models that ship and names what is wrong with others."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_body import PORT, FreeBody, small_field

from owm.baselines.classical import classical_policy
from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.ekf import ErrorStateEKF
from owm.baselines.exact import ExactDynamics
from owm.baselines.least_squares import fit_least_squares
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.policies import kind_of, load_policy
from owm.planning.config import PlannerConfig
from owm.planning.policy import PlannerPolicy
from owm.testing import check_world_model
from owm_envs.config import load_config
from owm_envs.env import DockingEnv
from owm_envs.policies import VectorPolicy
from owm_envs.testing import check_policy

CONFIG = load_config(fidelity="iss", precision="float32", steps_per_action=5)
SHIPPED = {
    "constant velocity": lambda episodes: ConstantVelocity(),
    "least squares": fit_least_squares,
    "exact": lambda episodes: ExactDynamics("iss-hcw"),
    "ekf": lambda episodes: ErrorStateEKF(CONFIG),
    "pretrained": lambda episodes: load_world_model("pretrained"),
    "a user's": lambda episodes: FreeBody(),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_models_that_ship_pass(name, episodes):
    check_world_model(SHIPPED[name](episodes))


@dataclass(frozen=True)
class Body(FreeBody):
    """A user's model, one of whose functions is replaced."""

    name: str = "body"
    wrong: str = ""

    def encode(self, params, history):
        views = history.observation["state"]
        if self.wrong == "branches in Python":
            return views[-1] if history.valid[0] else views[0]
        if self.wrong == "needs a whole history":
            return views[-1] / jnp.where(history.valid.all(), 1.0, 0.0)
        if self.wrong == "another frame":
            return views[-1].at[:3].multiply(-1.0)
        return views[-1]

    def step(self, params, key, action, state):
        after = super().step(params, key, action, state)
        if self.wrong == "grows":
            return jnp.concatenate([after, after])
        if self.wrong == "stretches":
            return after.at[6:10].multiply(1.1)
        if self.wrong == "diverges":
            return after.at[0].set(jnp.nan)
        if self.wrong == "draws by itself":
            drawn = jax.pure_callback(lambda: np.random.default_rng().normal(size=()).astype("f"), jnp.float32(0))
            return after.at[0].add(drawn)
        return after

    def decode(self, params, state):
        if self.wrong == "bare":
            return state
        if self.wrong == "short":
            return {"state": state[:12]}
        return {"state": state}


class Unhashable(Body):
    __hash__ = None


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Body, "interface: expected an object, made with its class, got the class"),
        (object(), "interface: the world model object lacks name, history_length, dt, params, encode, step"),
        (Body(history_length=0), "interface: expected history_length to be a whole number from 1 on, got 0"),
        (Body(dt="0.25"), "interface: expected dt to be a positive number of seconds, got '0.25'"),
        (Unhashable(), "static: expected a model that can be hashed .*unhashable"),
        (Body(wrong="branches in Python"), "jit: expected encode to be traceable, got .*boolean"),
        (Body(wrong="grows"), r"types: expected step to return a state like encode's, .*\(13,\).*, got .*\(26,\)"),
        (Body(wrong="bare"), 'types: expected decode to return a dict with "state"'),
        (Body(wrong="short"), r'types: expected the view "state" to be of shape \(13,\), got \(12,\)'),
        (Body(wrong="diverges"), "finite numbers: expected finite views from a whole history"),
        (Body(wrong="needs a whole history"), "finite numbers: expected finite views from a history of a single"),
        (Body(wrong="another frame"), "station frame: expected encode and decode to give the last measurement"),
        (Body(wrong="stretches"), r"unit quaternion: expected attitudes of length 1, got .*1\.1"),
        (Body(wrong="draws by itself"), "the same step twice: expected .* without a key"),
    ],
    ids=lambda value: "" if isinstance(value, str) else getattr(value, "wrong", "") or type(value).__name__,
)
def test_what_is_wrong_with_a_model_is_one_line(model, message):
    with pytest.raises(AssertionError, match=message) as error:
        check_world_model(model)
    assert "\n" not in str(error.value)


POLICIES = {
    "planner": lambda: PlannerPolicy(FreeBody(), small_field(), CONFIG, PlannerConfig(), 2),
    "classical": lambda: VectorPolicy(classical_policy(DockingEnv(CONFIG))),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", POLICIES)
def test_policies_that_ship_pass(name):
    check_policy(POLICIES[name](), CONFIG, ports=[PORT])


OWN = """
import numpy as np
class Lazy:
    def __init__(self, num_slots, seed):
        self.told = num_slots, seed
    def reset(self, mask=None, ports=None):
        pass
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros((len(observation), 6), np.float32), state
class Asks(Lazy):
    def __init__(self, weights):
        pass
class Mute:
    pass
"""


def test_a_class_of_ones_own_is_loaded_by_module_and_name(tmp_path, monkeypatch):
    (tmp_path / "my_own_policies.py").write_text(OWN, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    policy = load_policy("my_own_policies:Lazy", CONFIG, 3, seed=5)
    assert policy.told == (3, 5) and policy.name == "my_own_policies:Lazy"
    assert kind_of("my_own_policies:Lazy") == "user's own"
    check_policy(policy, CONFIG)
    for name, message in {
        "my_own_policies:Lasy": "unknown class of my_own_policies 'Lasy'; did you mean 'Lazy'",
        "my_own_policies:Asks": "made with config, num_slots, seed or some of them: .*'weights'",
        "my_own_policies:Mute": "lacks reset and predict; try owm_envs.testing.check_policy",
        "nowhere_at_all:Lazy": "cannot be imported: No module named 'nowhere_at_all'",
    }.items():
        with pytest.raises((ValueError, ImportError), match=message):
            load_policy(name, CONFIG)
