import datetime
import subprocess
import sys
import tomllib

import jax
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from owm_envs.config import CONFIG_PRESETS, NOISE_PRESETS, REWARD_PRESETS, DockingConfig, load_config
from owm_envs.config.params import params_from_config
from owm_envs.config.text import fields, json_schema, note
from owm_envs.station import save_hull


def test_presets_hold_the_paper_s_numbers():
    assert NOISE_PRESETS["cooperative"].position == 0.05
    assert NOISE_PRESETS["noncooperative"].position_per_range == 0.01
    assert REWARD_PRESETS["rl"].progress == -2.0
    assert REWARD_PRESETS["data"].collision == -1e6
    rl = load_config(preset="rl")
    assert (rl.decision_dt, rl.collision_terminates, rl.reset.radius_max) == (1.0, False, 125.0)
    # Paper, table of reward parameters, row by row.
    table = {
        "position": -0.9, "delta_position": 1.0, "sigma_position": 225.0,
        "velocity": -0.05, "delta_velocity": 0.1, "sigma_velocity": 5.0,
        "attitude": -0.2, "delta_attitude": 0.05, "sigma_attitude": np.pi,
        "rate": -0.02, "delta_rate": 0.005, "sigma_rate": 0.05,
        "gate_far": 0.5, "gate_distance": 25.0, "progress": -2.0,
        "proximity": 0.5, "sigma_proximity": 1.0, "alignment": 0.5, "sigma_alignment": 0.1,
        "effort": -0.05, "collision": -2.0, "dock": 1000.0, "escape": -1000.0,
    }  # fmt: skip
    assert rl.reward.model_dump() == table


@pytest.mark.parametrize("preset", CONFIG_PRESETS)
def test_toml_round_trip(preset, tmp_path):
    config = load_config(preset=preset, noise="cooperative", ports=["zvezda_aft"], obstacles=[((0, 0, 0), (1, 1, 1))])
    file = tmp_path / "config.toml"
    for notes in (False, True):
        file.write_text(config.to_toml(notes=notes), encoding="utf-8")
        assert load_config(file) == config
    assert load_config(config.model_dump()) == config


def _values(schema):
    """Values that a field's schema allows."""
    if "enum" in schema:
        return st.sampled_from(schema["enum"])
    if "anyOf" in schema:
        return st.one_of([_values(option) for option in schema["anyOf"]])
    if "const" in schema:
        return st.just(schema["const"])
    if schema["type"] == "array":
        if "prefixItems" in schema:
            return st.tuples(*map(_values, schema["prefixItems"]))
        return st.lists(_values(schema["items"]), min_size=schema.get("minItems", 0), max_size=4)
    if schema["type"] == "null":
        return st.none()
    low, high = schema.get("minimum", schema.get("exclusiveMinimum")), schema.get("maximum")
    if schema["type"] == "number":
        open_low, top = "exclusiveMinimum" in schema, high if high is not None else schema.get("exclusiveMaximum")
        open_high = "exclusiveMaximum" in schema
        return st.floats(low, top, exclude_min=open_low, exclude_max=open_high, allow_nan=False, allow_infinity=False)
    if schema["type"] == "integer":
        return st.integers(low, high if high is not None else 2**31 - 1)
    return {"boolean": st.booleans(), "string": st.just("2027-03-04T05:06:07Z")}[schema["type"]]


NAMES_OF_PORTS = st.lists(st.sampled_from(DockingConfig().ports), min_size=1, max_size=10)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_toml_round_trip_of_any_field(data):
    """Any field may take any value its schema allows, and TOML gives it back to the last bit."""
    path = data.draw(st.sampled_from(sorted(fields(DockingConfig))))
    value = data.draw(NAMES_OF_PORTS if path == ("ports",) else _values(fields(DockingConfig)[path]))
    nested = value
    for name in reversed(path):
        nested = {name: nested}
    if "camera" in path:
        nested["observation"] = "pixels"
    try:
        config = DockingConfig.model_validate(nested)
    except ValueError as error:
        assume("Value error" not in str(error))  # what several fields must hold between them
        raise
    for notes in (False, True):
        assert DockingConfig.model_validate(tomllib.loads(config.to_toml(notes=notes))) == config


@pytest.mark.parametrize("path", sorted(fields(DockingConfig)), ids=".".join)
def test_every_number_has_its_unit(path):
    kinds = str(fields(DockingConfig)[path])
    if path != ("forces", "zonal_degree") and ("'number'" in kinds or "'integer'" in kinds):
        assert "'unit'" in kinds and note(DockingConfig, path)


def test_notes_tell_unit_and_bounds():
    assert note(DockingConfig, ("chaser", "mass")) == "kg, >= 1, <= 10000000"
    assert note(DockingConfig, ("chaser", "inertia")) == "kg m2, >= 0.1, <= 10000000000"
    assert note(DockingConfig, ("reset", "attitude_error_deg")) == "deg, >= 0, <= 180"
    assert note(DockingConfig, ("chief", "eccentricity")) == "dimensionless, >= 0, < 1"
    assert note(DockingConfig, ("fidelity",)) == "one of iss, iss-hcw, iss-numerical"
    schema = json_schema(DockingConfig)
    mass = schema["$defs"]["ChaserConfig"]["properties"]["mass"]
    assert (mass["unit"], mass["minimum"], mass["default"]) == ("kg", 1, 12_000.0)
    assert {"enum": ["none", "cooperative", "noncooperative"]} in schema["properties"]["noise"]["anyOf"]


def test_every_number_reaches_the_parameters():
    """A field that is neither structure nor read by `params_from_config` would be a knob without a wire."""
    aside = {
        "fidelity",
        "observation",
        "goal_error",
        "normalize",
        "precision",
        "steps_per_action",
        "collision_terminates",
        "forces",
    }
    with jax.enable_x64(True):
        # Without, neither has parameters.
        base = load_config(chaser={"fault": {"leak": (1.0,) * 6}}, navigation={"outage_share": 0.3})
        plain = jax.tree.leaves(params_from_config(base))
        for path in fields(DockingConfig):
            if path[0] in aside or path == ("chaser", "thrusters") or "camera" in path:  # has a test of its own
                continue
            section = base.model_dump() if len(path) == 1 else base.model_dump()[path[0]]
            value = section[path[1] if len(path) > 1 else path[0]]
            if len(path) > 2:
                value = value[path[2]]
            config = load_config(base, **_with(path, _changed(path, value)))
            leaves = jax.tree.leaves(params_from_config(config))
            same = [a.shape == b.shape and bool(np.all(a == b)) for a, b in zip(plain, leaves, strict=True)]
            assert not all(same), path


def _with(path, value):
    for name in reversed(path):
        value = {name: value}
    return value


def _changed(path, value):
    if isinstance(value, bool):
        return not value
    if path == ("hull",) or path == ("obstacles",):
        return [((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))]
    if path == ("ports",):
        return ["unity_nadir"]
    if path == ("target", "hold"):
        return (0.0, -7.0, 0.0)
    if path == ("chief", "reference_epoch"):
        return "2027-01-01T00:00:00Z"
    if isinstance(value, bool):
        return not value
    if path[-1] == "chief_eccentricity":
        return (0.0, 0.01)
    if isinstance(value, tuple):
        return (value[0], *[x + 1 if isinstance(x, int) else x + 0.5 for x in value[1:]])
    if path == ("chief", "eccentricity"):
        return 0.01
    return value + 1 if isinstance(value, int) else value * 1.01 + 0.01


HULL = [[[-5.0, -4.0, -3.0], [5.0, 4.0, 3.0]], [[6.0, 0.0, 0.0], [7.0, 1.0, 1.0]]]


def test_a_hull_of_one_s_own(tmp_path):
    save_hull(tmp_path / "mine.csv", np.array(HULL))
    file = tmp_path / "config.toml"
    file.write_text('hull = "mine.csv"\n', encoding="utf-8")
    beside, direct = load_config(file), load_config(hull=HULL)
    assert beside == direct == load_config(hull=str(tmp_path / "mine.csv"))
    assert DockingConfig.model_validate(tomllib.loads(direct.to_toml())) == direct
    with jax.enable_x64(True):
        np.testing.assert_array_equal(params_from_config(direct).hull, HULL)
    moved = load_config(hull=[[[0.0] * 3, [1.0] * 3], HULL[1]])
    assert moved.structure == direct.structure != load_config().structure
    with pytest.raises(ValueError, match="six numbers a line"):
        load_config(hull=file)
    with pytest.raises(ValueError, match="lower corner below"):
        load_config(hull=[[[0.0] * 3, [0.0] * 3]])


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
        ({"dt": -1.0}, "dt.*at least 0.0001, got -1.0 s"),
        ({"dt": float("nan")}, "dt.*finite number, got nan s"),
        ({"chaser": {"mass": "heavy"}}, "chaser.mass.*got 'heavy' kg"),
        ({"hull": []}, "hull"),
        ({"reset": {"radius_min": 200.0, "radius_max": 100.0}}, "radius_max"),
        ({"precision": "float16"}, "precision"),
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
    heavy = {"jax", "torch", "cv2", "pyarrow"}
    code = f"import owm_envs, sys; assert not {heavy} & set(sys.modules), sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
def test_a_file_is_read_as_any_editor_leaves_it(tmp_path, encoding):
    file = tmp_path / "config.toml"
    file.write_bytes('fidelity = "iss"\r\nhorizon = 60.0  # Δ\r\n'.encode(encoding))
    assert load_config(str(file)).horizon == 60.0


def test_a_file_of_another_encoding_is_refused_with_what_to_do(tmp_path):
    file = tmp_path / "config.toml"
    file.write_bytes('ports = ["Hafen ä"]'.encode("latin-1"))
    with pytest.raises(ValueError, match="save it as UTF-8"):
        load_config(str(file))


@pytest.mark.parametrize(
    ("encoding", "said"),
    [
        ("utf-16-le", r"UTF-16 \(little-endian\) without"),
        ("utf-16-be", r"UTF-16 \(big-endian\) without"),
        ("utf-32-le", r"UTF-32 \(little-endian\) without"),
        ("utf-32-be", r"UTF-32 \(big-endian\) without"),
    ],
)
def test_an_encoding_without_its_mark_is_named(tmp_path, encoding, said):
    file = tmp_path / "config.toml"
    file.write_bytes('fidelity = "iss"\n'.encode(encoding))
    with pytest.raises(ValueError, match=f"config.toml is not UTF-8 text but looks like {said} .*: save it as UTF-8"):
        load_config(str(file))


@pytest.mark.parametrize(
    "epoch",
    [
        "2026-08-01T00:00:00Z",
        datetime.datetime(2026, 8, 1),
        datetime.datetime(2026, 8, 1, 2, tzinfo=datetime.timezone(datetime.timedelta(hours=2))),
        datetime.date(2026, 8, 1),
    ],
)
def test_an_epoch_may_be_text_or_a_date(epoch):
    assert load_config({"chief": {"reference_epoch": epoch}}) == load_config()


def test_an_unquoted_date_in_a_file_is_an_epoch(tmp_path):
    file = tmp_path / "config.toml"
    file.write_text("[chief]\nreference_epoch = 2026-08-01T00:00:00Z\n", encoding="utf-8")
    assert load_config(str(file)) == load_config()


@pytest.mark.parametrize(
    ("horizon", "dt", "held", "decisions"),
    [(10.0, 0.1, 3, 34), (360.0, 0.05, 1, 7200), (360.0, 0.05, 20, 360), (0.3, 0.1, 1, 3), (4.0, 0.05, 5, 16)],
)
def test_an_episode_is_never_cut_before_its_horizon(horizon, dt, held, decisions):
    config = load_config(fidelity="iss-hcw", precision="float32", horizon=horizon, dt=dt, steps_per_action=held)
    assert config.horizon_decisions == decisions == int(params_from_config(config).horizon_steps)
    assert decisions * config.decision_dt >= horizon * (1 - 1e-9)
