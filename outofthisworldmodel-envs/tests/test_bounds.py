"""Every number of a configuration has bounds, and whatever it may be, resets and steps come to numbers."""

import functools
from collections.abc import Callable
from itertools import groupby

import jax
import numpy as np
from schema_numbers import WILD, Number, nested, numbers_of, replaced

from owm_envs.config import DockingConfig, load_config
from owm_envs.config.params import params_from_config
from owm_envs.env import DockingEnv

NUMBERS = list(numbers_of(DockingConfig))
ENDLESS = ("noise", "bias", "correlation_time")  # inf is a constant bias
BOX, POSE = [[0.0] * 3, [1.0] * 3], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
LISTS = {
    ("hull",): [BOX],
    ("obstacles",): [BOX],
    ("target", "hold"): [0.0, -7.0, 0.0],
    ("camera", "visitors"): [POSE],
    ("camera", "position"): [0.0] * 3,
}
# One structure in which nearly every number has a say.
ALL = load_config(
    fidelity="iss-numerical",
    precision="float32",
    noise={"position": 0.1, "bias": {"position": 0.1, "rate": 1e-5}},
    navigation={"outage_share": 0.3, "outlier_share": 0.1},
    hull=[BOX],
    obstacles=[BOX],
    chaser={
        "thrusters": "on_off",
        "actuation_delay": 1,
        "delay_growth": 1,
        "plume": {"strength": 0.3},
        "fault": {"leak": (1.0,) * 6},
        "hysteresis": 0.1,
        "flexible": {"slosh_mass": 1.0},
    },
    target={"rate_deg": (0.0, 0.0, 1.0)},
    randomization={"mass_scale": (0.9, 1.1), "chief_raan_deg": (0.0, 5.0), "target_rate_deg": (0.0, 1.0)},
)
TABLES = ALL.model_dump()


def field(number: Number):
    return LISTS.get(number.path) or functools.reduce(getattr, number.path, ALL)


def test_every_number_has_bounds():
    for number in NUMBERS:
        least, most = number.bounds
        assert least is not None and (most is not None or number.path == ENDLESS), number


def test_no_wild_number_is_taken():
    """But for zero and what is next to it, where zero may be."""
    tried = 0
    for number in NUMBERS:
        pixels = {"observation": "pixels"} if "camera" in number.path else {}
        for value in WILD:
            try:
                load_config(pixels | number.put(value, field(number)))
            except ValueError as error:
                assert "\n" not in str(error) and len(str(error)) < 400
            else:
                ends = number.path == ENDLESS and value is not True and value > 1
                assert abs(value) < 1e-300 or ends, (number.path, value)
            tried += 1
    assert tried > 2000


def all_at(numbers: list[Number], pick: Callable[[Number], float]) -> dict:
    """Settings in which the numbers of a table have the values that are picked."""
    values = {}
    for number in numbers:
        name = number.path[-1]
        values[name] = replaced(values.get(name, field(number)), number.place, pick(number))
    return nested(numbers[0].path[:-1], values)


PICKS = {
    "least": lambda number: number.bounds[0],
    "most": lambda number: 1e300 if number.bounds[1] is None else number.bounds[1],
    "next to nothing": lambda number: min(max(5e-324, number.bounds[0]), number.bounds[1] or 1.0),
}


def test_at_the_bounds_resets_and_steps_come_to_numbers(quick):
    """In single precision, where numbers run over first: a table's together, or one by one where that is refused."""
    env = DockingEnv(ALL)

    @quick
    def fly(params, key):
        state, observation = env.reset(params, key=key)
        state, result = env.step(params, state, np.full(6, 1e30, np.float32))
        return observation, result, env.info(params, state)

    def tried(numbers, pick) -> bool:
        try:
            config = load_config(TABLES, **all_at(numbers, pick))
        except ValueError:
            return False
        if config.structure != ALL.structure:
            return False
        out = fly(params_from_config(config), jax.random.key(0))
        bad = [name for name, leaf in jax.tree.leaves_with_path(out) if not np.isfinite(leaf).all()]
        assert not bad, (numbers, bad)
        return True

    flown = 0
    for _, table in groupby(NUMBERS, lambda number: number.path[:-1] or number.path):
        numbers = list(table)
        for pick in PICKS.values():
            together = tried(numbers, pick)
            flown += len(numbers) if together else sum(tried([number], pick) for number in numbers)
    assert flown > 250
