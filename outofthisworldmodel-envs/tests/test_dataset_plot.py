"""The picture of a dataset."""

import sys

import numpy as np
import pytest

from owm_envs import cli
from owm_envs.config import load_config
from owm_envs.datasets.plot import ENDS, dataset_figure, plot_dataset, residuals, sketch
from owm_envs.datasets.writer import recording
from owm_envs.task.events import OUTCOME_NAMES


@pytest.fixture(scope="module")
def folder(swoop, slow_config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plot") / "set"
    with recording(folder / "train", slow_config) as writer:
        writer.write([swoop(16), swoop(40, policy=1, outcome=4), swoop(24, outcome=2)])
    return folder


def test_every_outcome_has_its_mark():
    assert set(ENDS) == set(OUTCOME_NAMES) - {"running"}
    assert len({color for color, _ in ENDS.values()}) == len({marker for _, marker in ENDS.values()}) == len(ENDS)


def test_residuals_are_the_errors_that_were_put_in():
    true = np.tile([100.0, -50, 20, 1, 2, 3, 0.5, 0.5, -0.5, 0.5, 0.01, 0.02, 0.03], (4, 1))
    measured = true.copy()
    measured[0, :3] += [3, 0, 4]
    measured[1, 3:6] += [0, 0.002, 0]
    # A turn of 0.3 rad about body x: q (x) [cos, sin, 0, 0].
    c, s = np.cos(0.15), np.sin(0.15)
    w, x, y, z = true[2, 6:10]
    measured[2, 6:10] = -np.array([w * c - x * s, w * s + x * c, y * c + z * s, z * c - y * s])
    measured[3, 10:] += [0, 0, 1e-5]
    expected = np.diag([5, 0.002, 0.3, 1e-5])
    assert np.allclose(residuals(measured, true), expected, atol=1e-9)


def test_what_the_configuration_asks_for_grows_with_range(swoop):
    noise = {"position": 0.5, "position_per_range": 0.01, "velocity": 0.03, "bias": {"velocity": 0.04}}
    drawn = sketch(swoop(8), load_config(noise=noise), 0.25)
    distance = np.linalg.norm(swoop(8).true_state[:, :3], axis=1)
    assert np.allclose(drawn.expected[:, 0], 0.5 + 0.01 * distance)
    assert np.allclose(drawn.expected[:, 1], 0.05) and drawn.seconds == 2.0


def test_a_figure_has_a_panel_a_policy_and_tells_the_noise(folder):
    told = []
    figure = plot_dataset(folder, "train", lambda done, total: told.append((done, total)))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[:4] == [
        "dock (2), from port side",
        "orbit (1), from port side",
        "dock, from below",
        "orbit, from below",
    ]
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert figure.get_suptitle().startswith("set, train: 3 episodes, 0.0 h of flight, iss-hcw")
    words = {
        axes.get_title(loc="left"): axes.texts[0].get_text()
        for axes in figure.axes
        if "error" in axes.get_title(loc="left")
    }
    assert "set 0.05" in words["position error [m]"] and "set 10" in words["rate error [\u00b5rad/s]"]
    # A normal error of 0.05 an axis is 0.05 sqrt(3) in all.
    found = float(words["position error [m]"].split()[1])
    assert found == pytest.approx(0.05 * np.sqrt(3), rel=0.15)


def test_flights_end_where_their_marks_are(swoop, slow_config):
    drawn = [sketch(swoop(16), slow_config, 0.25), sketch(swoop(16, outcome=2, port=5), slow_config, 0.25)]
    axes = dataset_figure(drawn, slow_config, "two").axes[0]
    docked = next(line for line in axes.lines if line.get_color() == ENDS["docked"][0] and len(line.get_xdata()) == 1)
    assert np.allclose(docked.get_xydata()[0], swoop(16).true_state[-1, 1:3])


def test_the_command_writes_a_picture(folder, tmp_path, capsys):
    import cv2

    cli.main(["plot", str(folder), "--out", str(tmp_path / "set.png")])
    assert capsys.readouterr().out.strip() == str(tmp_path / "set.png")
    image = cv2.imread(str(tmp_path / "set.png"))
    assert min(image.shape[:2]) > 1000 and image.std() > 10


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["nowhere"], "no dataset at nowhere"),
        (["SET", "--split", "val"], "has no split 'val'; it has train"),
        (["SET", "--out", "set.pdf"], "out must be the name of a file that ends in .png, got set.pdf"),
    ],
)
def test_mistakes_end_in_one_line(folder, options, says, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        cli.main(["plot", *(str(folder) if option == "SET" else option for option in options)])
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("error: ") and says in error and not list(tmp_path.iterdir())


def test_without_matplotlib_the_extra_is_named(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    for name in ("owm_envs.figures", "owm_envs.datasets.plot"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(SystemExit):
        cli.main(["plot", str(folder)])
    assert 'pip install "matplotlib>=3.8"' in capsys.readouterr().err
