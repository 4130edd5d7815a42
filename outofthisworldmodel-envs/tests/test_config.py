import subprocess
import sys

import pytest

from owm_envs.config import CONFIG_PRESETS, NOISE_PRESETS, REWARD_PRESETS, DockingConfig, load_config
from owm_envs.params import params_from_config


def test_presets_hold_the_paper_s_numbers():
    assert NOISE_PRESETS["cooperative"].position == 0.05
    assert NOISE_PRESETS["noncooperative"].position_per_range == 0.01
    assert REWARD_PRESETS["rl"].progress == -2.0
    assert REWARD_PRESETS["data"].collision == -1e6
    rl = load_config(preset="rl")
    assert (rl.decision_dt, rl.collision_terminates, rl.reset.radius_max) == (1.0, False, 125.0)


@pytest.mark.parametrize("preset", CONFIG_PRESETS)
def test_toml_round_trip(preset, tmp_path):
    config = load_config(preset=preset, noise="cooperative", ports=["zvezda_aft"], obstacles=[((0, 0, 0), (1, 1, 1))])
    file = tmp_path / "config.toml"
    file.write_text(config.to_toml())
    assert load_config(file) == config
    assert load_config(config.model_dump()) == config


def test_overrides_win_over_a_mapping_and_merge_into_nested_fields():
    config = load_config({"reset": {"radius_min": 110.0}, "dt": 0.1}, dt=0.05, reset={"radius_max": 120.0})
    assert (config.dt, config.reset.radius_min, config.reset.radius_max) == (0.05, 110.0, 120.0)


def test_a_field_may_change_within_a_named_preset():
    config = load_config(preset="rl", reward={"collision": 0.0})
    assert config.reward == REWARD_PRESETS["rl"].model_copy(update={"collision": 0.0})
    named = load_config(preset="rl", reward={"collision": 0.0}, noise="cooperative")
    assert load_config(named, reward="data").reward == REWARD_PRESETS["data"]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"nois": "none"}, "did you mean 'noise'"),
        ({"reset": {"radius_mim": 1.0}}, "did you mean 'reset.radius_min'"),
        ({"noise": "cooperatve"}, "did you mean 'cooperative'"),
        ({"reward": "rll"}, "did you mean 'rl'"),
        ({"ports": ["zvezda_aff"]}, "did you mean 'zvezda_aft'"),
        ({"ports": []}, "ports"),
        ({"dt": -1.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"reset": {"radius_min": 200.0, "radius_max": 100.0}}, "radius_max"),
        ({"precision": "float32"}, "precision must be 'float64'"),
        ({"preset": "datta"}, "did you mean 'data'"),
        ({"fidelity": "iss-numeric"}, "iss-numerical"),
        ({"config": {"fidelity": "iss-hcw"}, "fidelity": "iss"}, "config is for fidelity 'iss-hcw'"),
        ({"config": DockingConfig(), "preset": "rl"}, "pass one or the other"),
        ({"chief": {"reference_epoch": "tomorrow"}}, "chief.reference_epoch"),
        ({"obstacles": [((0, 0, 0), (1, -1, 1))]}, "lower corner below"),
    ],
)
def test_mistakes_name_the_field_and_the_nearest_name(overrides, message):
    with pytest.raises(ValueError, match=message):
        load_config(**overrides)


def test_a_missing_and_a_broken_file_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_config(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("dt = = 3")
    with pytest.raises(ValueError, match="not valid TOML"):
        load_config(broken)


def test_configurations_are_hashable_and_frozen():
    config = DockingConfig()
    assert hash(config) == hash(DockingConfig())
    with pytest.raises(ValueError, match="frozen"):
        config.dt = 1.0


def test_float64_outside_64_bit_mode_is_refused():
    with pytest.raises(RuntimeError, match="enable_x64"):
        params_from_config(DockingConfig())


def test_import_stays_light():
    code = "import owm_envs, sys; assert not {'jax', 'torch', 'cv2', 'pyarrow'} & set(sys.modules), sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)
