"""Recorded pixels, and films of recorded flights."""

import sys

import numpy as np
import pytest

from owm_envs import cli, datasets
from owm_envs.episode import Episode
from owm_envs.film import _moments, contact_sheet, save_film


def flight(times):
    """An episode of which only the clock counts."""
    rows = len(times)
    zeros = np.zeros((rows - 1, 6), np.float32)
    epoch = np.stack([np.full(rows, 61253.0), np.asarray(times)], axis=1)
    some = {"observation": {}, "reward": zeros[:, 0], "done": zeros[:, 0] > 0, "success": zeros[:, 0] > 0}
    return Episode(
        true_state=np.zeros((rows, 13)),
        epoch=epoch,
        action=zeros,
        port=0,
        goal_pose=np.zeros(7),
        policy=0,
        outcome=4,
        **some,
    )


def test_a_film_takes_rows_that_are_evenly_apart():
    times = np.arange(21) * 0.05
    assert _moments(flight(times), 0.25, False).tolist() == [0, 5, 10, 15, 20]
    assert _moments(flight(times), 0.3, False).tolist() == [0, 6, 12, 18, 20]
    sheet = _moments(flight(times), 1.0, True)
    assert len(sheet) == 12 and (sheet[0], sheet[-1]) == (0, 20)


def test_a_contact_sheet_goes_row_by_row():
    images = [np.full((2, 3, 3), number, np.uint8) for number in range(1, 6)]
    sheet = contact_sheet(images, columns=3)
    assert sheet.shape == (4, 9, 3)
    assert sheet[::2, ::3, 0].tolist() == [[1, 2, 3], [4, 5, 0]]


def test_a_film_reads_back(tmp_path):
    av = pytest.importorskip("av")
    images = [np.full((17, 16, 3), 40 * number, np.uint8) for number in range(6)]
    save_film(tmp_path / "film.mp4", iter(images), 20.0)
    with av.open(str(tmp_path / "film.mp4")) as film:
        seen = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert float(film.streams.video[0].average_rate) == 20.0
    assert len(seen) == 6 and seen[0].shape == (18, 16, 3)
    for number, image in enumerate(seen):
        assert abs(image.mean() - 40 * number) < 4
    with pytest.raises(ValueError, match=r"must end in \.mp4"):
        save_film(tmp_path / "film.gif", images, 20.0)


@pytest.mark.slow
def test_pixels_are_recorded_beside_the_state(seeing_run):
    for episode in datasets.read(seeing_run, "train"):
        frames = episode.observation["pixels"]
        assert set(episode.observation) == {"state", "pixels"} and episode.observation["state"].shape[1] == 13
        assert frames.shape == (len(episode) + 1, 16, 16, 3) and frames.dtype == np.uint8
        # A frame that is held is the same again, but for what the codec makes of it.
        moved = np.abs(np.diff(np.asarray(frames, np.int16), axis=0)).mean(axis=(1, 2, 3))
        assert moved[::2].max() < 3 and moved[1::2].max() > 0


@pytest.mark.slow
def test_the_command_draws_contact_sheets(seeing_run, tmp_path, capsys):
    import cv2

    cli.main(["render", str(seeing_run), "--sheet", "--size", "16", "--out", str(tmp_path), "--camera", "station_top"])
    (file,) = tmp_path.iterdir()
    assert capsys.readouterr().out.split() == [str(file)] and file.name == "val-0000-station_top.png"
    image = cv2.imread(str(file))
    assert image.shape == (48, 64, 3) and image.std() > 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["nowhere", "--sheet"], "error: no dataset at nowhere"),
        (
            ["RUN", "--sheet", "--camera", "station_tip"],
            "error: unknown camera 'station_tip'; did you mean 'station_top'?",
        ),
        (["RUN", "--sheet", "--episodes", "7"], "error: episodes must be from 0 to "),
        (["RUN", "--sheet", "--fps", "0"], "error: fps and speed must be above 0, got 0"),
        (["RUN", "--sheet", "--size", "0"], "error: height and width must be at least 1 pixel"),
        (["RUN"], "error: films need PyAV"),
    ],
)
def test_mistakes_end_in_one_line(seeing_run, options, says, capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        cli.main(["render", *(str(seeing_run) if option == "RUN" else option for option in options)])
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith(says), error
