import json
import subprocess
import sys
import tomllib

import pytest

from owm_envs import cli
from owm_envs.config import DockingConfig, load_config
from owm_envs.station import PORT_NAMES


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        cli.main(list(arguments))
        raise SystemExit(0)
    return ended.value.code


def test_help_is_answered_without_loading_jax():
    script = (
        "import sys\n"
        "from owm_envs import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit as ended: assert not ended.code\n"
        "print('loaded', {'jax', 'torch', 'pyarrow', 'cv2'} & set(sys.modules))"
    )
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "generate" in answer.stdout and "loaded set()" in answer.stdout, answer.stdout


def test_config_show_prints_what_load_config_reads(capsys, tmp_path):
    assert run("config", "show", "--preset", "rl") == 0
    text = capsys.readouterr().out
    assert DockingConfig.model_validate(tomllib.loads(text)) == load_config(preset="rl")
    file = tmp_path / "mine.toml"
    file.write_text('fidelity = "iss"\n[chaser]\nmass = 9000.0\n')
    assert run("config", "show", str(file)) == 0
    shown = tomllib.loads(capsys.readouterr().out)
    assert shown["chaser"]["mass"] == 9000.0 and shown["fidelity"] == "iss"


def test_config_validate_accepts_a_good_file(capsys, tmp_path):
    file = tmp_path / "good.toml"
    file.write_text('noise = "cooperative"\nports = ["zvezda_aft"]\n')
    assert run("config", "validate", str(file)) == 0
    told = capsys.readouterr().out
    assert "valid" in told and "chaser" not in told
    assert "noise.position = 0.05, not 0.0 (m, >= 0, <= 1000000)" in told


def test_config_show_tells_units_and_schema_is_json(capsys):
    assert run("config", "show") == 0
    assert "mass = 12000.0  # kg, >= 1, <= 10000000" in capsys.readouterr().out
    assert run("config", "schema") == 0
    assert json.loads(capsys.readouterr().out)["properties"]["dt"]["unit"] == "s"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("horizn = 3.0\n", "did you mean 'horizon'"),
        ("[chaser]\nmas = 3.0\n", "did you mean 'chaser.mass'"),
        ('ports = ["zvezda_aff"]\n', "did you mean 'zvezda_aft'"),
        ("dt = -1.0\n", "dt: must be at least 0.0001, got -1.0 s"),
        ("steps_per_action = 1.5\n", "steps_per_action: must be a whole number, got 1.5"),
        ("hull = 3\n", "hull: must be 'iss' or a list, got 3"),
        ("[chief]\nreference_epoch = 07:00:00\n", "reference_epoch: must be a date and time, such as 2026-08-01T"),
        ("dt = \n", "not valid TOML"),
        (None, "No such file"),
    ],
)
def test_config_validate_names_the_mistake(capsys, tmp_path, text, message):
    file = tmp_path / "bad.toml"
    if text is not None:
        file.write_text(text)
    assert run("config", "validate", str(file)) == 2
    told = capsys.readouterr().err
    assert message in told and "Traceback" not in told and "bad.toml" in told and "Input should" not in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env", "iss-nmerical"], "did you mean 'iss-numerical'"),
        (["--noise", "coperative"], "did you mean 'cooperative'"),
        (["--transitions", "0"], "transitions must be at least 1"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
        (["--planner-style", "2"], "planner_style must be from 0 to 1"),
        (["--transitions", "many"], "many"),
        (["--seed", "-1"], "seed must be an integer of at least 0, got -1"),
        (["--seed", "4294967296"], "seed must be below 2**32, got 4294967296"),
    ],
)
def test_generate_names_a_mistake_and_writes_nothing(capsys, tmp_path, arguments, message):
    out = tmp_path / "set"
    assert run("generate", "--out", str(out), *arguments) == 2
    told = capsys.readouterr()
    assert message in told.out + told.err and "Traceback" not in told.err
    assert not list(tmp_path.iterdir())


def test_generate_leaves_an_existing_folder_alone(capsys, tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    assert run("generate", "--out", str(tmp_path)) == 2
    assert "holds files of something else (mine.txt)" in capsys.readouterr().err


def test_ports_lists_every_port(capsys):
    assert run("ports") == 0
    table = capsys.readouterr().out
    assert all(name in table for name in PORT_NAMES)
