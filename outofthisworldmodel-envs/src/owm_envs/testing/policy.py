"""`check_policy`: whether a policy of one's own flies slots as the package's do."""

import inspect
from collections.abc import Sequence
from typing import Any

import gymnasium
import jax
import numpy as np

from owm_envs.adapters.gymnasium import DockingVectorEnv
from owm_envs.env import docking_env
from owm_envs.station import port_indices
from owm_envs.testing.expect import alike, expect


def check_policy(
    policy: Any,
    env: Any = "ISS-v0",
    *,
    slots: int | None = None,
    ports: Sequence[str | int] = ("zvezda_aft", "harmony_forward"),
) -> None:
    """Check that a policy can fly a batch of slots as `owm fly` and `owm evaluate docking` have it fly.

    It needs `reset(mask, ports)` and `predict(observation, state, episode_start, deterministic)`, which returns actions
    and a state. In this order: the interface; shape, type and numbers of the actions; that observations are left as
    they are; the same state, the same actions, or, of a policy that returns None, the same episode, the same actions;
    and that a slot that begins anew leaves the others alone.

    Args:
        policy: the object, not its class.
        env: to fly in: an id, a `DockingEnv`, its configuration, or a Gymnasium environment over one.
        slots: flights side by side; the policy's `num_slots`, or two.
        ports: to fly to, of which the slots take turns.

    Raises:
        AssertionError: naming the check that failed, what was expected and what came, on one line.
    """

    kind = type(policy).__name__
    expect(not inspect.isclass(policy), "interface", "an object, made with its class", f"the class {policy!r}")
    for name, given in (("reset", "mask, ports"), ("predict", "observation, state, episode_start, deterministic")):
        function = getattr(policy, name, None)
        expect(callable(function), "interface", f"{name}({given})", f"{kind}, which lacks it")
        try:
            inspect.signature(function).bind(*given.split(", "))
        except (TypeError, ValueError) as error:
            raise AssertionError(f"interface: expected {name}({given}), got {kind}'s, which says: {error}") from None
    pure = gymnasium.make(env).unwrapped.docking_env if isinstance(env, str) else docking_env(env)
    slots = (getattr(policy, "num_slots", None) or 2) if slots is None else slots
    index = port_indices(np.resize(port_indices(ports), slots))
    flown = DockingVectorEnv(
        slots, pure.config, dynamics=pure.dynamics, sensors=pure.sensors[1:], autoreset_mode="disabled"
    )
    first, _ = flown.reset(seed=0, options={"dock_port": index.tolist()})
    every, none = np.ones(slots, bool), np.zeros(slots, bool)

    def act(observation, state, start) -> tuple[np.ndarray, Any]:
        given = jax.tree.map(np.copy, observation)
        answer = policy.predict(given, state, start, True)
        paired = isinstance(answer, tuple) and len(answer) == 2
        expect(paired, "types", "predict to return actions and a state", type(answer).__name__)
        action = np.asarray(answer[0])
        expect(action.shape == (slots, 6), "shapes", f"actions of shape ({slots}, 6)", action.shape)
        expect(action.dtype.kind == "f", "types", "actions of floats", action.dtype)
        expect(np.isfinite(action).all(), "finite numbers", "finite actions", action.tolist())
        same = alike(given, observation)
        expect(same, "nothing is changed in place", "predict to leave the observation as it is", "another one")
        return action.copy(), answer[1]

    policy.reset(every, index)
    begun, state = act(first, None, every)
    second = flown.step(begun)[0]
    action, _ = act(second, state, none)
    if state is None:
        policy.reset(every, index)
        again, check = act(first, None, every)[0], "the same episode, the same actions"
        expect(np.allclose(again, begun, rtol=1e-5), check, f"{begun.tolist()} after another reset", again.tolist())
    else:
        again, check = act(second, state, none)[0], "the same state, the same actions"
        expect(np.allclose(again, action, rtol=1e-5), check, action.tolist(), again.tolist())
        policy.reset(np.arange(slots) == 0, index)
        beside = act(second, state, none)[0]
        alone = np.allclose(beside[1:], action[1:], rtol=1e-5)
        expect(alone, "slots by themselves", f"{action[1:].tolist()} beside a reset", beside[1:].tolist())
    flown.close()
