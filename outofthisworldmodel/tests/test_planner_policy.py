"""The policy around the planner, flying a rigid body beside a box."""

from dataclasses import dataclass

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from free_body import BIAS, ENV, GOAL, LIMIT, NO_BIAS, PORT, STARTS, FreeBody, make, move, observe, small_field

from owm.planning.config import PlannerConfig
from owm.planning.policy import PlannerPolicy
from owm.scores.prediction import prediction_error
from owm_envs.config import load_config
from owm_envs.env import DockingEnv
from owm_envs.station import PORT_NAMES
from owm_envs.view import View


def fly(policy, views, decisions, bias=NO_BIAS):
    """Fly a batch of bodies; return the last views and all actions."""
    actions = []
    for _ in range(decisions):
        action, _ = policy.predict(observe(policy.layout, views))
        # One body at a time: a program for two may round otherwise than one for one.
        moved = [move(bias, view[None], wrench[None])[0] for view, wrench in zip(views, action, strict=True)]
        views = np.stack(moved)
        actions.append(action)
    return views, np.stack(actions)


def miss(views):
    """Distance to the goal m, speed m/s, angle to the goal attitude rad."""
    seen = View.of(views)
    angle = 2 * np.arccos(np.minimum(1, np.abs(seen.attitude @ GOAL[3:])))
    return np.linalg.norm(seen.position - GOAL[:3], axis=1), np.linalg.norm(seen.velocity, axis=1), angle


@pytest.mark.parametrize(("bias", "latency"), [(NO_BIAS, 0), (BIAS, 0), (BIAS, 1)])
def test_reaches_the_goal_and_stays_there(bias, latency):
    """Bias or none, planned in no time or in a step: the corrector finds it and the warm start holds against it."""
    policy = make(latency=latency)
    views, actions = fly(policy, STARTS, 200, bias)
    assert (actions[:latency] == 0).all() and np.abs(actions[latency]).max() > 1.0
    assert actions.dtype == np.float32 and actions.shape == (200, 2, 6)
    misses = []
    for _ in range(5):
        misses.append(miss(views))
        views, _ = fly(policy, views, 8, bias)
    distance, speed, angle = np.mean(misses, axis=0)
    assert (distance < 0.1).all() and (speed < 0.05).all() and (angle < np.radians(2)).all()


def test_without_the_corrector_a_bias_keeps_it_away():
    assert (miss(fly(make(corrector=False), STARTS, 200, BIAS)[0])[0] > 0.5).all()


@dataclass(frozen=True)
class BiasLearner:
    """Takes half of each prediction error over as a bias."""

    def init(self, params):
        return params

    def learn(self, known, before, action, after):
        _, velocity, _, rate = View.of(after - FreeBody().step(known, None, action, before))
        return known + 0.5 * jnp.concatenate([velocity, rate]) / FreeBody.dt

    def params(self, known):
        return known


def test_a_learner_gives_each_slot_the_parameters_it_finds():
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, PlannerConfig(corrector=False), 2, learner=BiasLearner())
    policy.reset(ports=[PORT] * 2)
    views = STARTS
    for _ in range(30):  # one slot under the bias, one without
        action, state = policy.predict(observe(policy.layout, views))
        flown = [move(bias, views, action) for bias in (BIAS, NO_BIAS)]
        views = np.stack([flown[0][0], flown[1][1]])
    np.testing.assert_allclose(state.known, [BIAS, NO_BIAS], atol=2e-5)
    policy.reset(mask=np.array([True, False]))
    _, state = policy.predict(observe(policy.layout, views))
    np.testing.assert_allclose(state.known, [NO_BIAS, NO_BIAS], atol=2e-5)


def test_a_reset_slot_starts_like_a_fresh_policy_and_leaves_the_others_alone():
    policy, undisturbed, fresh = make(), make(), make()
    half, _ = fly(policy, STARTS, 5)  # in the middle of a chunk
    fly(undisturbed, STARTS, 5)
    policy.reset(mask=np.array([False, True]))
    again = np.stack([half[0], STARTS[1]])
    _, actions = fly(policy, again, 21)
    _, continued = fly(undisturbed, np.stack([half[0], half[1]]), 21)
    _, first = fly(fresh, STARTS, 21)
    np.testing.assert_array_equal(actions[:, 1], first[:, 1])
    np.testing.assert_array_equal(actions[:, 0], continued[:, 0])
    assert np.abs(actions[:, 1] - continued[:, 1]).max() > 1.0  # N


def test_episode_start_is_a_reset():
    told, flagged = make(), make()
    half, _ = fly(told, STARTS, 5)
    fly(flagged, STARTS, 5)
    told.reset(mask=np.array([True, False]))
    observation = observe(told.layout, half)
    expected, _ = told.predict(observation)
    with pytest.warns(UserWarning, match="slot 0 begins an episode, but its port was not announced"):
        actual, _ = flagged.predict(observation, episode_start=np.array([True, False]))
    np.testing.assert_array_equal(actual, expected)


def test_slots_do_not_depend_on_their_number():
    _, alone = fly(make(1), STARTS[:1], 9)
    _, together = fly(make(2), STARTS, 9)
    np.testing.assert_array_equal(alone[:, 0], together[:, 0])


def test_a_returned_state_can_be_resumed():
    policy = make()
    views = STARTS
    observation = observe(policy.layout, views)
    _, state = policy.predict(observation)
    second, _ = policy.predict(observation, state)
    policy.predict(observation)
    repeated, _ = policy.predict(observation, state)
    np.testing.assert_array_equal(repeated, second)


def test_ended_slots_are_skipped_until_they_begin_again():
    policy = make()
    policy.active = np.array([True, False])
    actions, _ = policy.predict(observe(policy.layout, STARTS))
    assert len(policy.seconds) == 1
    assert (actions[1] == 0).all() and np.abs(actions[0]).max() > 1.0
    policy.reset(mask=np.array([False, True]))
    actions, _ = policy.predict(observe(policy.layout, STARTS))
    assert len(policy.seconds) == 2 and np.abs(actions[1]).max() > 1.0


def test_sees_only_the_measured_view():
    """Epoch and goal error are never read, and truth has no way in: no info is ever passed."""
    env = load_config(fidelity="iss-numerical", steps_per_action=5)
    seen, blind = (PlannerPolicy(FreeBody(), small_field(), env, num_slots=2) for _ in range(2))
    for policy in (seen, blind):
        policy.reset(ports=[PORT] * 2)
    observation = observe(seen.layout, STARTS)
    erased = np.full_like(observation, np.nan)
    erased[:, seen.layout.view] = STARTS
    np.testing.assert_array_equal(seen.predict(observation)[0], blind.predict(erased)[0])


def test_normalised_environments_get_the_same_commands():
    config = ENV.model_copy(update={"normalize": True})
    plain = make()
    scaled = PlannerPolicy(FreeBody(), small_field(), config, num_slots=2)
    scaled.reset(ports=[PORT] * 2)
    limit = np.float32(LIMIT)
    scale = np.float32([225.0] * 3 + [5.0] * 3 + [1.0] * 4 + [0.05] * 3)
    wrench, _ = plain.predict(observe(plain.layout, STARTS))
    action, _ = scaled.predict(observe(scaled.layout, STARTS / scale))
    np.testing.assert_allclose(action * limit, wrench, atol=0.02 * 1600)
    assert np.abs(action).max() <= 1


def test_wrong_decision_rate_is_refused():
    with pytest.raises(ValueError, match=r"every 0\.25 s.*steps_per_action=5"):
        PlannerPolicy(FreeBody(), small_field(), load_config(fidelity="iss"))


def test_ports_are_checked():
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, num_slots=2)
    with pytest.raises(ValueError, match="call reset"):
        policy.predict(np.zeros((2, policy.layout.size), np.float32))
    with pytest.raises(ValueError, match="ports must be given"):
        policy.reset()
    with pytest.raises(ValueError, match="indices from 0 to 7"):
        policy.reset(ports=[0, 8])
    with pytest.raises(ValueError, match="does not cover zvezda_aft"):
        policy.reset(ports=[0, 3])
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        policy.reset(ports=[0])


def test_a_single_port_is_that_of_every_slot():
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, num_slots=2)
    policy.reset(ports=PORT_NAMES[PORT])
    each = make()
    np.testing.assert_array_equal(*(flown.predict(observe(each.layout, STARTS))[0] for flown in (policy, each)))
    with pytest.raises(ValueError, match="unknown port 'z'"):
        policy.reset(ports=["z", "z"])


def test_any_form_of_the_environment_is_taken():
    vector = gymnasium.make_vec("ISS-v0", num_envs=2, config=ENV)
    for subject, slots in ((DockingEnv(ENV), 1), (gymnasium.make("ISS-v0", config=ENV), 1), (vector, 2)):
        policy = PlannerPolicy(FreeBody(), small_field(), subject)
        assert policy.num_slots == slots and policy.layout == DockingEnv(ENV).layout
    with pytest.raises(TypeError, match=r"env must be a DockingEnv, .* got int"):
        PlannerPolicy(FreeBody(), small_field(), 4)


def test_what_a_model_lacks_is_told():
    class Half:
        name, dt, params, encode, step = "half", 0.25, (), None, None

    for use in (lambda model: PlannerPolicy(model, small_field(), ENV), lambda model: prediction_error(model, None)):
        with pytest.raises(TypeError, match="world model Half lacks history_length, observe, decode"):
            use(Half())


def test_observations_are_checked():
    policy = make()
    with pytest.raises(ValueError, match="must have shape"):
        policy.predict(np.zeros((2, 7), np.float32))
    broken = observe(policy.layout, STARTS)
    broken[1, policy.layout.view] = np.nan
    with pytest.raises(ValueError, match=r"not finite in slots \[1\]"):
        policy.predict(broken)


def test_a_model_that_predicts_nothing_finite_is_given_up(monkeypatch):
    monkeypatch.setattr(FreeBody, "params", np.full(6, np.nan, np.float32))
    policy = make()
    with pytest.raises(ValueError, match="'free body' predicts no finite view"):
        fly(policy, STARTS, 60)
    assert len(policy.seconds) == 8


@dataclass(frozen=True)
class Ranging:
    """How many decisions ago the flight began."""

    name: str = "age"
    shape: tuple[int, ...] = (2,)
    dtype: str = "int32"
    every: int = 1
    may_miss: bool = False

    def measure(self, key, truth):
        """Measure."""
        return jnp.full(2, truth.count, jnp.int32)


@dataclass(frozen=True)
class Looking(FreeBody):
    """Falls aside by as much as its last measurement says, and asks for an integer history."""

    parts: tuple[str, ...] = ("state", "age")

    def encode(self, params, history):
        """The last view, moved."""
        assert history.observation["age"].shape == (3, 2) and history.observation["age"].dtype == jnp.int32
        return super().encode(params, history).at[1].add(history.observation["age"][-1, 0])


def test_a_model_sees_the_parts_that_it_looks_at():
    env = DockingEnv(ENV, sensors=(Ranging(),))
    policies = [PlannerPolicy(model, small_field(), env, PlannerConfig(), 2) for model in (Looking(), FreeBody())]
    observation = {"state": observe(policies[0].layout, STARTS), "age": np.zeros((2, 2), np.int32)}
    answers = []
    for policy in policies:
        policy.reset(ports=np.full(2, PORT))
        answers.append([policy.predict(observation | {"age": np.full((2, 2), age, np.int32)})[0] for age in (0, 9)])
    np.testing.assert_array_equal(answers[0][0], answers[1][0])
    state = policies[0]._state.observation
    assert state.keys() == {"state", "age"} and state["age"][:, :, 0].tolist() == [[0, 0, 9]] * 2
    assert policies[1]._state.observation.keys() == {"state"}
    with pytest.raises(ValueError, match="looks at age, which the environment does not observe; it observes state"):
        PlannerPolicy(Looking(), small_field(), ENV, PlannerConfig(), 2)
