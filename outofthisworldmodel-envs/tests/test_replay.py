"""The page of a flight without a browser: what it holds is what was flown, and it asks for nothing else."""

import base64
import html
import json
import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_angle
from owm_envs import cli, datasets
from owm_envs.camera.views import camera
from owm_envs.datasets.writer import recording
from owm_envs.replay import film, load, recorded, save_page
from owm_envs.replay.page import page, page_data
from owm_envs.station import CHASER, PARTS, hull_boxes

FRAMES = np.repeat(np.arange(5, dtype=np.uint8), 5)[:, None, None, None] * np.full((1, 8, 8, 3), 50, np.uint8)
NASTY = 'a </script><script>alert("x")</script> & <b>'


def numbers(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


@pytest.fixture(scope="module")
def flight(swoop, slow_config):
    episode = swoop(24)
    return recorded("Swoop", swoop(24, observation={**episode.observation, "pixels": FRAMES}), slow_config)


@pytest.fixture(scope="module")
def text(flight):
    return page(flight)


@pytest.fixture
def run(swoop, slow_config, tmp_path):
    """Folder of a dataset of two flights, as `owm fly` leaves it."""
    with recording(tmp_path / "run" / "episodes", slow_config) as writer:
        writer.write([swoop(16), swoop(24)])
    return tmp_path / "run"


def kept(text):
    """The data in a page."""
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])


def test_what_the_page_holds_is_what_was_flown(text, flight):
    data, episode = kept(text), flight.episode
    assert np.array_equal(numbers(data["times"]), np.float32(0.25 * np.arange(25)))
    assert np.array_equal(numbers(data["state"]).reshape(-1, 13), episode.true_state.astype(np.float32))
    assert np.array_equal(numbers(data["boxes"]).reshape(-1, 2, 3), hull_boxes().astype(np.float32))
    for k, name in enumerate(["force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z"]):
        assert np.array_equal(numbers(data["columns"][name]), np.append(episode.action[:, k], 0)), name
    assert [part["name"] for part in data["parts"]["station"]] == [part.name for part in PARTS]
    assert [part["dimensions"] for part in data["parts"]["chaser"]] == [list(part.dimensions) for part in CHASER]


def test_curves_are_the_errors_to_the_goal(flight):
    columns, episode = flight.columns, flight.episode
    attitudes, goal = jnp.asarray(episode.true_state[:, 6:10]), jnp.asarray(episode.goal_pose[3:])
    angle = jax.vmap(quat_angle, (0, None))(attitudes, goal)
    assert np.allclose(columns["attitude"], np.degrees(angle), atol=1e-3)
    assert columns["distance"][-1] == 0 and columns["distance"][0] == pytest.approx(80 * np.hypot(1, 0.4))
    assert np.allclose(columns["rate"], np.degrees(1 / 6.0))
    force = np.linalg.norm(episode.action[:, :3].astype(float), axis=1)
    assert flight.delta_v == pytest.approx(0.25 * force.sum() / 12_000)


def test_cameras_are_the_named_ones(text, flight):
    for mode, name in (("chase", "chaser_isometric"), ("nose", "chaser_fpv"), ("port", "station_fpv")):
        lens, told = camera(name, port="zvezda_aft"), kept(text)["cameras"][mode]
        assert np.allclose(told["position"], lens.position) and np.allclose(told["attitude"], lens.attitude)
        assert told["field"] == pytest.approx(82 if mode != "chase" else 60, abs=1e-4) and told["mount"] == lens.mount


def test_a_page_asks_nothing_of_the_network(text):
    markup = re.sub(r"<script\b.*?</script>", "", text, flags=re.DOTALL)
    assert re.search(r"Content-Security-Policy\" content=\"default-src 'none'", markup)
    assert not re.findall(r"https?://|\bsrc=|<link|@import|url\(", markup)
    # All that is left in three.js is the name of a namespace, which nobody fetches.
    assert set(re.findall(r"https?://[^\"'`\s]*", text)) <= {"http://www.w3.org/1999/xhtml"}
    assert not re.findall(r"\bimport\s*\(|\bfetch\(\s*[\"']", text) and "{{" not in markup


def test_a_page_is_small(text, swoop, slow_config):
    assert len(page(recorded("Long", swoop(7200), slow_config))) < 3_000_000
    assert len(text) < 1_800_000


def test_frames_are_kept_once_each(text, flight):
    frames = kept(text)["frames"]
    assert frames["rows"] == [0, 5, 10, 15, 20] and len(frames["images"]) == 5
    import cv2

    for shade, image in enumerate(frames["images"]):
        data = np.frombuffer(base64.b64decode(image.removeprefix("data:image/jpeg;base64,")), np.uint8)
        assert abs(cv2.imdecode(data, cv2.IMREAD_COLOR).astype(int) - 50 * shade).max() <= 2


def test_no_text_can_break_out_of_the_page(swoop, slow_config):
    text = page(recorded(NASTY, swoop(4), slow_config))
    assert NASTY not in text and text.count(html.escape(NASTY)) == 2
    assert text.count("<script") == text.count("</script>") == 3


def test_a_flight_of_no_known_date_has_no_sky(swoop, slow_config):
    undated = recorded("Undated", swoop(8, epoch=np.zeros((9, 2))), slow_config)
    assert page_data(undated)["sky"] is None
    assert np.allclose(undated.times, 0.25 * np.arange(9))


def test_the_command_shows_what_was_recorded(run, tmp_path, capsys):
    out = tmp_path / "page.html"
    cli.main(["replay", str(run), "--episode", "1", "--out", str(out)])
    assert str(out) in capsys.readouterr().out
    data = kept(out.read_text(encoding="utf-8"))
    (_, wanted) = datasets.read(run)
    assert np.array_equal(numbers(data["state"]).reshape(-1, 13), wanted.true_state.astype(np.float32))
    assert data["facts"][0][:2] == ["outcome", "docked"]


def test_frames_are_drawn_where_asked(run):
    pictures = film(load(run), size=16, fps=1.0)
    assert pictures.rows.tolist() == [0, 4, 8, 12, 16] and pictures.images.shape == (5, 16, 16, 3)
    assert pictures.images.std() > 5


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["nowhere"], "no dataset at nowhere"),
        (["RUN", "--episode", "2"], "episode must be from 0 to 1 in "),
        (["RUN", "--episode", "-1"], "episode must be from 0 to 1 in "),
        (["RUN", "--split", "test"], "has no split 'test'; it has episodes"),
        (["RUN", "--out", "page.htm"], "out must be the name of a file that ends in .html, got page.htm"),
        (["RUN", "--out", "taken/page.html"], "taken is no folder"),
        (["RUN", "--frames", "--fps", "0"], "fps must be above 0, got 0"),
        (["RUN", "--rerun"], "Rerun recordings need rerun-sdk"),
    ],
)
def test_mistakes_end_in_one_line(run, options, says, capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("")
    with pytest.raises(SystemExit):
        cli.main(["replay", *(str(run) if option == "RUN" else option for option in options)])
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("error: ") and says in error
    assert not list(tmp_path.glob("*.html"))


def test_a_page_takes_its_place_whole(flight, tmp_path, monkeypatch):
    out = tmp_path / "page.html"
    out.write_text("before")
    monkeypatch.setattr("owm_envs.replay.page.page", lambda recording: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        save_page(out, flight)
    assert out.read_text() == "before" and list(tmp_path.iterdir()) == [out]
