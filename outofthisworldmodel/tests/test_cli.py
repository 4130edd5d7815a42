import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from owm import cli
from owm.baselines.least_squares import LeastSquares
from owm.catalogue.policies import GIVEN, NAMES, differences, kind_of, load_model
from owm.catalogue.predictors import NAMED
from owm.checkpoint import About, save_world_model
from owm.console import announce, bar
from owm.motion.linear import LinearMap
from owm.report.page import Table
from owm.report.terminal import print_table
from owm.scores.docking import evaluation_config
from owm.training.config import PRESETS


def python(code, **environ):
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, env=os.environ | environ)


def test_help_imports_nothing_heavy():
    done = python(
        "import sys\nfrom owm.cli import main\ntry:\n    main(['--help'])\nexcept SystemExit as stop:\n"
        "    assert stop.code in (0, None)\n"
        "heavy = ('jax', 'matplotlib', 'scipy', 'equinox', 'pyarrow', 'cv2')\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
    for command in ("fly", "evaluate", "train", "demo"):
        assert command in done.stdout


def test_importing_changes_no_jax_setting():
    done = python(
        "import os, jax\nbefore = dict(jax.config.values)\nenviron = dict(os.environ)\nimport owm, owm.cli\n"
        "import owm.commands.run, owm.commands.demo\nafter = dict(jax.config.values)\n"
        "print(sorted(k for k in after if before.get(k, None) != after[k] and k in before))\n"
        "print(environ == dict(os.environ))"
    )
    assert done.stdout.splitlines() == ["[]", "True"], done.stderr


def test_output_that_cannot_hold_a_letter_does_without_it():
    done = python(
        "from owm_envs.shell import tolerant_output\nfrom owm.report.terminal import print_table\n"
        "from owm.report.page import Table\ntolerant_output()\nprint_table(Table(['Δv m/s'], [['8.2']]))",
        PYTHONIOENCODING="cp1252",
        PYTHONUTF8="0",
    )
    assert done.returncode == 0, done.stderr
    assert "?v m/s" in done.stdout and "8.2" in done.stdout


def test_a_loss_that_diverges_is_told_in_one_line(monkeypatch, tmp_path, capfd):
    import owm.commands.run

    def diverge(*arguments):
        raise FloatingPointError("the loss is not finite at step 50; lower learning_rate")

    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(owm.commands.run, "train", diverge)
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", "--data", "d", "--out", "o"])
    assert stop.value.code == 2 and capfd.readouterr().err.startswith("error: the loss is not finite")


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["fly", "--policy", "dokc"], "did you mean 'dock'?"),
        (["fly", "--policy", "least-squares"], "needs a fit"),
        (["fly", "--policy", "runs/none/model"], "no checkpoint at 'runs/none/model'"),
        (["fly", "--port", "zvezda"], "did you mean 'zvezda_aft'?"),
        (["fly", "--noise", "coop"], "did you mean 'cooperative'?"),
        (["fly", "--env", "iss2"], "'iss', 'iss-hcw' or 'iss-numerical'"),
        (["fly", "--flights", "0"], "got 0"),
        (["evaluate", "docking"], "at least one policy"),
        (["evaluate", "docking", "dock", "--slots", "0"], "slots must be at least 1"),
        (["evaluate", "prediction", "exact", "--data", "none"], "no dataset at none"),
        (["train", "--data", "none", "--out", "x"], "no dataset at none"),
    ],
)
def test_mistakes_end_with_code_2_and_one_line(arguments, message, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    error = capfd.readouterr().err
    assert stop.value.code == 2 and message in error and "Traceback" not in error
    assert error.strip().splitlines()[-1].startswith("error: ")


def test_unknown_flags_end_with_code_2(capfd):
    with pytest.raises(SystemExit) as stop:
        cli.main(["fly", "--sedd", "1"])
    assert stop.value.code == 2 and "--seed" in capfd.readouterr().err


def test_train_takes_its_flags_from_the_preset(monkeypatch, tmp_path):
    import owm.commands.run

    seen = []
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(owm.commands.run, "train", lambda *arguments: seen.append(arguments))
    cli.main(
        ["train", "--data", "d", "e", "--out", "o", "--preset", "ci", "--batch", "7", "--width", "64", "--wandb", "p"]
    )
    data, _, config, project = seen[0]
    assert data == (Path("d"), Path("e")) and project == "p"
    assert (config.steps, config.batch, config.model.width) == (400, 7, 64)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_is_a_choice_of_train(preset, monkeypatch, tmp_path, recwarn):
    import owm.commands.run

    seen = []
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(owm.commands.run, "train", lambda *arguments: seen.append(arguments))
    cli.main(["train", "--data", "d", "--out", "o", "--preset", preset])
    assert seen[0][2] == PRESETS[preset]
    assert not recwarn.list, [str(warning.message) for warning in recwarn.list]


MARKED = "a [/x] [bold] :smile: [link=x]"
"""Of a path: names of folders may look like the markup of the rich library."""


def test_text_in_the_terminal_is_no_markup(capsys):
    announce(f"reading {MARKED} ...")
    with bar(f"predicting {MARKED}", "models") as update:
        update(1, 1, MARKED)
    print_table(Table([MARKED, "b"], [[MARKED, "1"]], MARKED, [0]), MARKED)
    out, err = capsys.readouterr()
    assert f"reading {MARKED} ...\n" in err and err.count(MARKED) >= 3 and out.count(MARKED) == 4


@pytest.mark.parametrize(
    "command",
    [
        "fly --policy PLACE --out PLACE",
        "evaluate docking PLACE --out PLACE",
        "evaluate matrix PLACE --out PLACE",
        "evaluate prediction PLACE --data PLACE --out PLACE",
        "evaluate prediction exact --data PLACE --out PLACE",
        "train --data PLACE --out PLACE",
        "demo --out PLACE",
        "push PLACE user/name",
        "download PLACE --out PLACE",
    ],
)
def test_a_path_that_looks_like_markup_is_named_in_one_line(command, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    place = tmp_path / "[" / "x]"  # "[/x]" closes a style that is not open
    place.mkdir(parents=True)
    (place / "thesis").touch()
    with pytest.raises(SystemExit) as ended:
        cli.main([word.replace("PLACE", str(place)) for word in command.split()])
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert ended.value.code == 2 and told.startswith("error: ") and "closing tag" not in told
    assert [file.name for file in place.iterdir()] == ["thesis"]


@pytest.mark.parametrize("content", ["{", "[]", '{"kind": "diffusion"}'])
def test_folders_that_hold_no_policy_are_named(content, tmp_path):
    (tmp_path / "config.json").write_text(content)
    with pytest.raises(ValueError, match=r"no checkpoint's"):
        kind_of(str(tmp_path))


def test_every_policy_says_what_it_was_given():
    assert set(NAMES) <= set(GIVEN) and {"world model", "least-squares"} <= set(GIVEN)
    with pytest.raises(ValueError, match="no world model"):
        load_model("dock", None)


def test_a_checkpoint_of_another_environment_is_told():
    here = evaluation_config()
    corpus = {"name": "c", "fidelity": "iss-hcw", "noise": here.noise.model_dump(mode="json"), "dt": 0.05}
    about = About.model_validate({"corpus": [corpus]})
    (told,) = differences(about, here)
    assert told == "was trained on other fidelity than it flies in: iss-hcw; now iss-numerical"
    (told,) = differences(about, evaluation_config(fidelity="iss-hcw", noise="none"))
    assert "other noise" in told and "'position': 0.05" in told
    both = About.model_validate({"corpus": [corpus, corpus | {"fidelity": "iss-numerical"}]})
    assert differences(both, here) == differences(About(), here) == []


def test_fly_draws_the_flight_of_a_scripted_policy(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    out = tmp_path / "fly"
    cli.main(["fly", "--policy", "dock", "--port", "unity_nadir", "--env", "iss", "--plot", "--out", str(out)])
    assert (out / "dock_unity_nadir.png").read_bytes()[:4] == b"\x89PNG"
    scores = json.loads((out / "scores.json").read_text())
    assert scores["dock"]["scores"]["all"]["docked"]["count"] == 1
    told = capfd.readouterr()
    assert "dock to unity_nadir" in told.out and "compiling" in told.err

    # The same again finds the flight there; another one is refused, and neither flies.
    before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
    again = ["fly", "--policy", "dock", "--port", "unity_nadir", "--env", "iss", "--out", str(out)]
    cli.main(again)
    told = capfd.readouterr()
    assert "dock to unity_nadir" in told.out and "holds these flights already" in told.err
    with pytest.raises(SystemExit) as ended:
        cli.main([*again, "--seed", "1"])
    (line,) = capfd.readouterr().err.strip().splitlines()
    said = f"error: {out} holds another run, which differs in seed: choose another folder (--out), or remove it"
    assert ended.value.code == 2 and line == said
    assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before


def test_a_report_of_other_policies_is_not_replaced(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    out = tmp_path / "scored"
    row = out / "flights" / "random" / "own" / "nominal"
    row.mkdir(parents=True)
    (row / "row.json").write_text('{"settings": {}}')
    (row / "zvezda_aft.npz").touch()
    (out / "report.md").write_text("random")
    for words in (["docking", "orbit"], ["prediction", "exact", "--data", "none"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(["evaluate", *words, "--out", str(out)])
        (line,) = capfd.readouterr().err.strip().splitlines()
        assert ended.value.code == 2 and line.startswith(f"error: {out} holds f") and "choose another folder" in line
        assert "--out" in line
    assert (out / "report.md").read_text() == "random" and not (out / "run.json").exists()


def test_models_are_found_by_name_and_by_folder(tmp_path):
    linear = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), LinearMap.skeleton(jnp.float32))
    save_world_model(LeastSquares(linear), tmp_path / "run" / "model")
    config = evaluation_config(fidelity="iss", precision="float32")
    for folder in (tmp_path / "run", tmp_path / "run" / "model"):
        assert kind_of(str(folder)) == "least-squares"
        assert isinstance(load_model(str(folder), config), LeastSquares)
    assert load_model("oracle-mppi", config).fidelity == "iss"
    (tmp_path / "run" / "model" / "weights.safetensors").write_bytes(b"cut")
    with pytest.raises(ValueError, match="damaged"):
        load_model(str(tmp_path / "run"), config)


@pytest.mark.parametrize(
    ("command", "names"), [("fly", (*NAMES, "pretrained")), ("evaluate prediction", (*NAMED, "pretrained"))]
)
def test_help_lists_every_name(command, names, capsys):
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    told = re.sub(r"[\s│]+", "", capsys.readouterr().out)
    assert not [name for name in names if name not in told]


SEEDED = (
    "fly",
    "evaluate docking dock",
    "evaluate prediction exact --data d",
    "demo",
    "train --data d",
    "train-ppo",
)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("fly --policy pretraned", "did you mean 'pretrained'?"),
        ("fly --policy runs/mine", "there is no checkpoint at 'runs/mine'"),
        ("fly --policy mine", "unknown policy 'mine'; known: dock, "),
        ("evaluate prediction nomodel --data d", "unknown predictor 'nomodel'; known: constant-velocity, "),
        ("evaluate prediction exakt --data d", "unknown predictor 'exakt'; did you mean 'exact'?"),
        ("evaluate prediction dock --data d", "unknown predictor 'dock'; known: "),
        *((f"{command} --seed -1", "seed must be an integer of at least 0, got -1") for command in SEEDED),
        ("train --data d --steps 10", "steps must be a multiple of chunk=50, got 10"),
        ("train --data d --steps 0", "error: steps: must be greater than 0, got 0"),
        ("train --data d --width 30", "model: width must be an even multiple of heads, got width=30, heads=4"),
        ("train --data d --seed 4294967296", "error: seed must be below 2**32, got 4294967296"),
        ("train-ppo --batch 0", "error: batch: must be greater than 0, got 0"),
        ("evaluate matrix TABLE", "studies.0: must be a table, got 3; unknown key 'polices'; did you mean 'policies'?"),
        ("fly --seed -1", "seed must be an integer of at least 0, got -1"),
        ("fly --out FILE", "is no folder"),
        ("evaluate docking dock dock", "name each policy once, got 'dock' twice"),
        ("evaluate docking dock --ports zvezda_aft zvezda_aft", "ports must differ, got 'zvezda_aft' twice"),
        ("evaluate docking dock --ports zvezda", "did you mean 'zvezda_aft'?"),
        ("evaluate docking dock --out FILE", "is no folder"),
        ("evaluate prediction exact --data none --out FILE", "is no folder"),
        ("train --data none --out FILE", "is no folder"),
        ("train-ppo --out FILE", "is no folder"),
        ("demo --out FILE", "is no folder"),
        ("demo --out HOME", "holds files of something else (file, table.toml): choose another folder"),
        ("train --data none --out HOME", "holds files of something else (file, table.toml): choose another folder"),
        ("fly --out HOME", "holds files of something else (file, table.toml): choose another folder"),
        ("evaluate docking dock --out HOME", "holds files of something else (file, table.toml): choose another folder"),
    ],
)
def test_a_mistake_is_one_line_before_anything_flies(command, said, tmp_path, capsys):
    file = tmp_path / "file"
    file.touch()
    table = tmp_path / "table.toml"
    table.write_text("polices = 1\nstudies = [3]\n[policies]\ndock = 'dock'\n")
    words = command.replace("FILE", str(file)).replace("TABLE", str(table)).replace("HOME", str(tmp_path)).split()
    with pytest.raises(SystemExit) as ended:
        cli.main(words if "--out" in words else [*words, "--out", str(tmp_path / "out")])
    (told,) = capsys.readouterr().err.strip().splitlines()
    assert ended.value.code == 2
    assert said in told and told.startswith("error: ")
    assert "pydantic" not in told and "Input should" not in told
