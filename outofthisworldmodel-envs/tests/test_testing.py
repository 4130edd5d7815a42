"""`check_env` and `check_policy` pass what is sound of a user's own, and name what is wrong with the rest."""

import copy
from dataclasses import dataclass

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_from_rotation_vector, quat_multiply
from owm_envs.adapters.gymnasium import DockingGymEnv, DockingVectorEnv
from owm_envs.dynamics.free_flyer import FreeFlyer
from owm_envs.env import DockingEnv
from owm_envs.episode import POLICY_NAMES
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.testing import check_env, check_policy
from owm_envs.view import View


@dataclass(frozen=True)
class Dragged(FreeFlyer):
    """A free-flyer in still air: what a user might bring."""

    damping: float = 0.1

    def step(self, params, state, wrench, dt):
        slowed = state.chaser.orbit.at[3:].multiply(jnp.exp(-self.damping * dt))
        return super().step(params, state._replace(chaser=state.chaser._replace(orbit=slowed)), wrench, dt)


def altered(change):
    """Dragged dynamics whose state after a step is changed by `change(params, state, dt)`."""

    class Altered(Dragged):
        def step(self, params, state, wrench, dt):
            return change(params, super().step(params, state, wrench, dt), dt)

    return Altered()


def with_orbit(state, orbit):
    return state._replace(chaser=state.chaser._replace(orbit=orbit))


def branches_in_python(params, state, dt):
    return state if state.chaser.orbit[0] > 0 else state._replace(elapsed=dt)


def drifts_off(params, state, dt):
    return with_orbit(state, state.chaser.orbit.at[0].add(0.5 * dt))


def stretches_the_quaternion(params, state, dt):
    return state._replace(chaser=state.chaser._replace(attitude=1.001 * state.chaser.attitude))


def turns_unseen(params, state, dt):
    turn = quat_from_rotation_vector(jnp.stack([0.3 * dt, 0 * dt, 0 * dt]))
    return state._replace(chaser=state.chaser._replace(attitude=quat_multiply(state.chaser.attitude, turn)))


def divides_by_speed(params, state, dt):
    """A drag of constant size: its direction has no gradient at rest."""
    speed = jnp.sqrt(jnp.sum(state.chaser.orbit[3:] ** 2))
    factor = jnp.where(speed > 0, 1 - 1e-3 * dt / speed, 1)
    return with_orbit(state, state.chaser.orbit.at[3:].multiply(factor))


def widens(params, state, dt):
    return with_orbit(state, state.chaser.orbit.astype(jnp.float64))


def forgets_the_clock(params, state, dt):
    return state._replace(elapsed=state.elapsed - dt)


def loses_the_velocity(params, state, dt):
    return with_orbit(state, state.chaser.orbit[:3])


class Staggered(Dragged):
    """Keeps its position half a step ahead, which shows in the view."""

    def init(self, params, epoch, view):
        state = super().init(params, epoch, view)
        return with_orbit(state, state.chaser.orbit.at[:3].add(params.dt / 2 * View.of(view).velocity))


@pytest.mark.parametrize(
    ("dynamics", "message"),
    [
        (altered(branches_in_python), r"jit: expected step to be traceable, got .*boolean"),
        (altered(widens), r"dtype follows the inputs: expected float32 .*chaser.orbit.* got float32 and float64"),
        (altered(loses_the_velocity), r"types: expected step to keep the shape \(6,\) of .*chaser.orbit"),
        (Staggered(), r"init inverts relative_state: expected position .* under thrust, got"),
        (altered(forgets_the_clock), r"clocks: expected elapsed to advance by dt, to 1 s .*got 0 s"),
        (altered(stretches_the_quaternion), r"unit quaternion: expected .* length 1 .* got 1\.0010"),
        (altered(drifts_off), r"velocity is the derivative of position: expected .* m/s .* got"),
        (altered(turns_unseen), r"rate is the derivative of attitude: expected .* rad/s"),
        (altered(divides_by_speed), r"finite gradients: expected .*at rest in the origin, got .*nan"),
        (object(), r"interface: .* lacks has_epoch, init, step, relative_state"),
        (Dragged, r"interface: .* is a class, not an instance"),
    ],
    ids=lambda value: "" if isinstance(value, str) else None,
)
def test_what_is_wrong_is_named(dynamics, message):
    with pytest.raises(AssertionError, match=message):
        check_env(dynamics)


@pytest.mark.slow
def test_a_users_dynamics_pass_and_fly():
    check_env(Dragged())
    env = gymnasium.make("ISS-v0", dynamics=Dragged(damping=1.0), noise="none")
    start = env.reset(seed=0)[1]["true_state"]
    for _ in range(10):
        env.step(np.zeros(6, np.float32))
    twin = copy.deepcopy(env)
    for _ in range(10):
        *_, info = env.step(np.zeros(6, np.float32))
        *_, same = twin.step(np.zeros(6, np.float32))
    np.testing.assert_allclose(View.of(info["true_state"]).velocity, View.of(start).velocity * np.exp(-1.0), rtol=1e-9)
    np.testing.assert_allclose(same["true_state"], info["true_state"], rtol=0, atol=1e-9)
    assert max(env.unwrapped.traces.values()) == 1


@pytest.mark.slow
def test_our_own_pass():
    check_env("ISSNumerical-v0", noise="cooperative", horizon=0.2)


def test_unusable_dynamics_are_refused_by_every_door():
    class Mutable(Dragged):
        __hash__ = None

    for door in (DockingEnv, DockingGymEnv, DockingVectorEnv):
        with pytest.raises(TypeError, match="frozen dataclass"):
            door(fidelity="iss", dynamics=Mutable())


class Drifts:
    """A policy that does nothing: what a user might bring."""

    def reset(self, mask=None, ports=None):
        self.ports = ports

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros((len(observation), 6), np.float32), state


def broken(change, returns=lambda count: count):
    """A policy whose actions are `change(observation, state, itself)`, and whose state counts."""

    class Broken(Drifts):
        calls = 0

        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            self.calls += 1
            return change(observation, state, self), returns(1 + (state or 0))

    return Broken()


def zeros(observation, *shape):
    return np.zeros((len(observation), *(shape or (6,))), np.float32)


class Wordless(Drifts):
    def predict(self, observation):
        return zeros(observation)


class Bare(Drifts):
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return zeros(observation)


class Forgets(Drifts):
    """Slots share what one of them forgets."""

    count = 0

    def reset(self, mask=None, ports=None):
        self.count += 1

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return zeros(observation) + self.count, 0


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (Drifts, "interface: expected an object, made with its class, got the class"),
        (object(), r"interface: expected reset\(mask, ports\), got object, which lacks it"),
        (Wordless(), r"interface: expected predict\(observation, state, .*got Wordless's, which says: too many"),
        (Bare(), "types: expected predict to return actions and a state, got ndarray"),
        (broken(lambda o, s, p: zeros(o, 7)), r"shapes: expected actions of shape \(2, 6\), got \(2, 7\)"),
        (broken(lambda o, s, p: zeros(o)[0]), r"shapes: expected actions of shape \(2, 6\), got \(6,\)"),
        (broken(lambda o, s, p: zeros(o).astype(int)), "types: expected actions of floats, got int64"),
        (broken(lambda o, s, p: zeros(o) + np.nan), "finite numbers: expected finite actions, got .*nan"),
        (broken(lambda o, s, p: zeros(o.__imul__(0))), "in place: expected predict to leave the observation"),
        (
            broken(lambda o, s, p: zeros(o) + p.calls),
            r"the same state, the same actions: expected \[\[2.0, .* got \[\[3",
        ),
        (
            broken(lambda o, s, p: zeros(o) + p.calls, lambda c: None),
            r"the same episode, the same actions: expected \[\[1",
        ),
        (Forgets(), r"slots by themselves: expected \[\[1.* beside a reset, got \[\[2"),
    ],
    ids=lambda value: "" if isinstance(value, str) else type(value).__name__,
)
def test_what_is_wrong_with_a_policy_is_one_line(policy, message):
    with pytest.raises(AssertionError, match=message) as error:
        check_policy(policy)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", [*(name for name in POLICY_NAMES if "geodesic" not in name), "drifts"])
def test_our_own_policies_pass(name, request):
    if name == "dock-safe":
        request.getfixturevalue("quick_drifts")
    env = gymnasium.make("ISS-v0", noise="cooperative")
    check_policy(Drifts() if name == "drifts" else VectorPolicy(make_policy(name, env)), env)
