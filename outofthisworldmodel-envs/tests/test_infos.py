"""What `info` holds: numbers and codes in every adapter, so that converters to other array libraries take it."""

import gymnasium
import jax
import numpy as np
import pytest

from owm_envs.pettingzoo import parallel_env
from owm_envs.station import PORT_NAMES
from owm_envs.task.events import OUTCOME_NAMES, Outcome

CONFIG = {"fidelity": "iss", "horizon": 0.1, "steps_per_action": 1, "ports": ["zvezda_aft", "unity_nadir"]}


def scalar():
    env = gymnasium.make("ISS-v0", config=CONFIG)
    yield env.reset(seed=0)[1]
    for _ in range(2):
        yield env.step(np.zeros(6, np.float32))[4]


def vector(mode: str):
    env = gymnasium.make_vec("ISS-v0", num_envs=2, config=CONFIG, autoreset_mode=mode)
    yield env.reset(seed=0)[1]
    for _ in range(3 if mode != "disabled" else 2):
        yield env.step(np.zeros((2, 6), np.float32))[4]


def fleet():
    env = parallel_env(2, config=CONFIG)
    yield from env.reset(seed=0)[1].values()
    while env.agents:
        yield from env.step({agent: np.zeros(6) for agent in env.agents})[4].values()


ADAPTERS = {"scalar": scalar, "fleet": fleet} | {
    mode: (lambda mode=mode: vector(mode)) for mode in ("next_step", "same_step", "disabled")
}


@pytest.mark.parametrize("adapter", ADAPTERS)
def test_infos_hold_numpy_numbers_and_nothing_else(adapter):
    infos = list(ADAPTERS[adapter]())
    for info in infos:
        for value in jax.tree.leaves(info):
            assert isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "fib", value
            assert not isinstance(value, np.bool_), "Gymnasium's converters know no numpy.bool_"
    ends = [info.get("final_info", info) for info in infos]
    outcomes = {int(code) for end in ends for code in np.ravel(end["outcome"])}
    assert outcomes == {Outcome.RUNNING, Outcome.TIMEOUT}
    assert {OUTCOME_NAMES[code] for code in outcomes} == {"running", "timeout"}
    assert {PORT_NAMES[int(port)] for end in ends for port in np.ravel(end["port"])} <= set(CONFIG["ports"])
    assert not any(np.any(end["is_success"]) for end in ends)


def test_names_of_codes_are_one_table_each():
    assert OUTCOME_NAMES == tuple(outcome.name.lower() for outcome in Outcome) and len(PORT_NAMES) == 8
