"""What an editor completes and a prompt shows: members, keywords, short reprs."""

import ast
import importlib
import inspect
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import owm
import owm_envs
from owm_envs.config import CONFIG_PRESETS, NOISE_PRESETS, REWARD_PRESETS, DockingConfig, load_config
from owm_envs.registration import IDS, Id

SHORT = 300
"""Characters that a repr may have."""


@pytest.mark.parametrize("package", [owm, owm_envs], ids=lambda package: package.__name__)
def test_every_member_exists_and_is_seen_by_editors(package):
    source = ast.parse(Path(package.__file__).read_text(encoding="utf-8"))
    (unseen,) = (node for node in source.body if isinstance(node, ast.If))  # what type checkers read
    read = {alias.name: line.module for line in unseen.body for alias in line.names}
    assert read == package._LATER
    assert {*read} <= {*package.__all__} <= {*dir(package)}
    for name in package.__all__:
        assert getattr(package, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        _ = package.absent


def test_the_keywords_of_make_are_those_of_the_configuration():
    beside = {"config", "preset", "render_mode", "width", "height", "camera_name", "dynamics", "sensors"}
    beside |= {"max_episode_steps", "disable_env_checker"}
    hints = get_type_hints(owm_envs.DockingKeywords)
    assert {*hints} == {*DockingConfig.model_fields} - {"fidelity"} | beside
    assert {*get_args(hints["preset"])} == {*CONFIG_PRESETS}
    for name, presets in (("noise", NOISE_PRESETS), ("reward", REWARD_PRESETS)):
        assert {*get_args(get_args(hints[name])[0])} == {*presets}
    assert {*get_args(Id)} == {*IDS}
    for function in (owm_envs.make, owm_envs.make_vec):
        assert {*hints} < {*inspect.signature(function).parameters}


def test_make_makes_what_gymnasium_makes():
    one = owm_envs.make("ISSHCW-v0", noise="cooperative", steps_per_action=5)
    assert one.unwrapped.config == load_config(fidelity="iss-hcw", noise="cooperative", steps_per_action=5)
    many = owm_envs.make_vec("ISS-v0", num_envs=2, autoreset_mode="same_step", preset="rl")
    assert many.unwrapped.config == load_config(fidelity="iss", preset="rl") and many.num_envs == 2
    with pytest.raises(ValueError, match="step_per_action"):
        owm_envs.make("ISSHCW-v0", step_per_action=5)


def test_a_configuration_tells_what_is_not_default():
    assert repr(DockingConfig()) == "DockingConfig()"
    config = load_config(fidelity="iss", noise="cooperative", steps_per_action=5, chaser={"mass": 9000.0})
    names = vars(importlib.import_module("owm_envs.config.parts")) | {"DockingConfig": DockingConfig}
    assert eval(repr(config), names) == config
    many = [((float(i), 0.0, 0.0), (i + 1.0, 1.0, 1.0)) for i in range(313)]
    assert repr(load_config(hull=many)) == "DockingConfig(hull='313 boxes')"


def test_reprs_are_short():
    from owm.model.config import PRESETS as MODELS
    from owm.training.config import PRESETS

    env = owm_envs.DockingEnv(fidelity="iss-hcw", noise="cooperative", steps_per_action=5)
    assert repr(env).startswith("DockingEnv(fidelity='iss-hcw', ") and "steps_per_action=5" in repr(env)
    model, field = owm.load_world_model("pretrained"), owm_envs.load_field(["zvezda_aft"])
    policy = owm_envs.VectorPolicy(owm_envs.make_policy("dock", env))
    planner = owm.PlannerPolicy(model, field, env)
    made = [owm_envs.make("ISSHCW-v0", steps_per_action=5).unwrapped, owm_envs.make_vec("ISSHCW-v0", num_envs=2)]
    fleet = owm_envs.FleetEnv(2, fidelity="iss-hcw")
    shown = [env, fleet, *made, model, field, policy, planner, *MODELS.values(), *PRESETS.values()]
    assert all(len(repr(each)) <= SHORT and " at 0x" not in repr(each) for each in shown), shown
