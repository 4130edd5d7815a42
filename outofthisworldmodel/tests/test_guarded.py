"""When the guarded planner hands over, and to whom."""

import numpy as np
import pytest

from owm.baselines.guarded import GuardedPolicy
from owm.planning.health import Health
from owm_envs.config import load_config
from owm_envs.config.parts import NOISE_PRESETS
from owm_envs.env import DockingEnv
from owm_envs.policies import SlotPolicy
from owm_envs.task.sensors import STATE, STATE_VALID
from owm_envs.view import VIEW_SLICES

DT, MOST = 0.25, 1600.0 / 12_000.0
QUIET, WORST = NOISE_PRESETS["cooperative"].velocity, NOISE_PRESETS["noncooperative"].velocity


class Counts(SlotPolicy):
    """Commands how many decisions it has made in the episode, times its sign; tells which slots it flew."""

    def __init__(self, layout, sign):
        super().__init__(f"counts {sign}", layout, 2)
        self.sign, self.alarms = sign, (np.inf,) * 6

    def begin(self, count):
        return np.zeros(count)

    def act(self, state, observation, slots):
        state = np.where(slots.fresh, 1, state + slots.active)
        return np.repeat(self.sign * state[:, None], 6, axis=1), state

    def health_of(self, state):
        """Alarms in slot 0, of each axis after so many decisions."""
        alarms = (state[:, None] > np.asarray(self.alarms)) * np.array([[1], [0]])
        return Health(np.ones((2, 6, 2)), np.zeros((2, 6)), np.zeros((2, 6)), alarms)

    def verdict_of(self, state):
        return ["docks"] * len(state)


@pytest.fixture
def fly():
    """Commands (T, 2) under measured velocities (T, 2, 3), and the policy that gave them."""
    layout = DockingEnv(load_config(fidelity="iss-hcw")).layout
    policy = GuardedPolicy(Counts(layout, 1), Counts(layout, -1), Counts(layout, -2))

    def flown(velocity, measured=None, starts=(), alarms=(np.inf,) * 6):
        policy.planner.alarms = alarms
        policy.restart()
        policy.reset(ports=[0, 0])
        actions = []
        for step, each in enumerate(velocity):
            if step in starts:
                policy.reset([True, False], ports=[0, 0])
            state = np.zeros((2, layout.size), np.float32)
            state[:, layout.view][:, VIEW_SLICES.velocity] = each
            valid = np.ones(2, bool) if measured is None else measured[step]
            actions.append(policy.predict({STATE: state, STATE_VALID: valid[:, None]})[0][:, 0])
        return np.array(actions), policy

    return flown


def noise(of, steps=60):
    return np.random.default_rng(0).normal(size=(steps, 2, 3)) * np.asarray(of)


@pytest.mark.parametrize(
    "velocity",
    [
        noise(QUIET),
        noise(WORST) + MOST * DT * np.arange(60)[:, None, None],  # full thrust along every axis
        noise(QUIET) + 2.0 * (np.arange(60) > 30)[:, None, None] * [1, 1, 0],  # two axes jump
        noise(QUIET) * np.where(np.random.default_rng(1).uniform(size=(60, 2, 1)) < 0.05, 20, 1),
    ],
    ids=["quiet", "worst it was tried with", "a jump of two axes", "outliers"],
)
def test_it_flies_the_planner_under_what_that_was_tried_with(fly, velocity):
    actions, policy = fly(velocity)
    np.testing.assert_array_equal(actions, np.arange(1, 61)[:, None] * [1, 1])
    assert policy.verdict == ["docks", "docks"]


def test_ten_times_the_noise_hands_over_one_slot_for_its_episode(fly):
    velocity = noise(np.array([10 * WORST, WORST])[:, None])
    actions, policy = fly(velocity)
    since = np.argmax(actions[:, 0] < 0)
    assert 0 < since < 12, "three seconds"
    np.testing.assert_array_equal(actions[since:, 0], -np.arange(1, 61 - since))  # begun afresh, and for good
    np.testing.assert_array_equal(actions[:, 1], np.arange(1, 61))
    assert policy.verdict == ["counts -1", "docks"]


def test_another_episode_begins_with_the_planner(fly):
    velocity = noise(10 * WORST) * (np.arange(60) < 30)[:, None, None]
    actions, _ = fly(velocity, starts=[30])
    assert (actions[20:30] < 0).all() and (actions[30:, 0] > 0).all() and (actions[30:, 1] < 0).all()


def test_what_was_not_measured_is_no_jump(fly):
    """Old velocities for 30 s, then others."""
    velocity = np.where((np.arange(200) < 150)[:, None, None], 0.0, 3.0) + noise(QUIET, 200)
    measured = np.repeat(((np.arange(200) < 30) | (np.arange(200) >= 150))[:, None], 2, axis=1)
    actions, _ = fly(velocity, measured)
    assert (actions > 0).all()


NEVER = np.inf


@pytest.mark.parametrize("alarms", [(NEVER,) * 3 + (10, 30, 20), (30, 5, 8, 50, NEVER, NEVER)])
def test_alarms_along_all_three_axes_of_a_kind_hand_over(fly, alarms):
    actions, policy = fly(noise(QUIET), alarms=alarms)
    np.testing.assert_array_equal(actions[:31, 0], np.arange(1, 32))
    np.testing.assert_array_equal(actions[31:, 0], -2 * np.arange(1, 30))
    np.testing.assert_array_equal(actions[:, 1], np.arange(1, 61))
    assert policy.verdict == ["counts -2", "docks"]


def test_alarms_of_some_axes_leave_the_planner_flying(fly):
    actions, _ = fly(noise(QUIET), alarms=(5, 5, NEVER, NEVER, 5, 5))
    assert (actions > 0).all()


def test_who_leaves_is_not_handed_over(fly, monkeypatch):
    monkeypatch.setattr(Counts, "verdict_of", lambda self, state: ["leaves", "docks"])
    actions, _ = fly(noise(QUIET), alarms=(5,) * 6)
    assert (actions > 0).all()
