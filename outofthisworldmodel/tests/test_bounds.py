"""Every number of the configurations of training, planning and evaluation has bounds."""

import numpy as np
import pytest
from pydantic import ValidationError
from schema_numbers import WILD, numbers_of

from owm.baselines.ppo.config import PPOConfig
from owm.planning.config import PlannerConfig
from owm.study.matrix import Matrix
from owm.training.config import TrainConfig
from owm_envs.words import mistakes

LISTS = {("rollouts",): [(1.0, 16)], ("network",): [8], ("studies",): []}
GIVEN = {Matrix: {"policies": {}, "studies": ()}}


@pytest.mark.parametrize("model", [TrainConfig, PlannerConfig, PPOConfig, Matrix])
def test_no_wild_number_is_taken(model):
    tried = 0
    for number in numbers_of(model):
        if number.path in (("seed",), ("model",)) or number.path[0] == "model":  # checked_seed; a test of its own
            continue
        least, most = number.bounds
        assert least is not None and most is not None, number
        for value in WILD:
            try:
                model.model_validate(GIVEN.get(model, {}) | number.put(value, LISTS.get(number.path)))
            except ValidationError as error:
                assert len(mistakes(error, model)) < 400
            else:
                assert abs(value) < 1e-300 and least <= 0, (number, value)
            tried += 1
    assert tried


@pytest.mark.parametrize("seed", [True, 2**32, -1, 10**400, np.nan, 1.5])
@pytest.mark.parametrize("model", [TrainConfig, PPOConfig])
def test_seeds_are_whole_numbers_of_32_bits(model, seed):
    with pytest.raises((ValidationError, TypeError)):
        model(seed=seed)


def test_at_the_bounds_a_plan_s_numbers_are_finite():
    """In single precision; none that is divided by is lost."""
    for number in numbers_of(PlannerConfig):
        for value in number.bounds:
            try:
                config = PlannerConfig.model_validate(number.put(value, None))
            except ValidationError:
                continue  # chunk, latency and knots go with the horizon
            for leaf in config.tuning((1.0,) * 6):
                for array in leaf if isinstance(leaf, tuple) else (leaf,):
                    assert np.isfinite(array).all() and (np.asarray(array) ** 2 < 1e30).all()
