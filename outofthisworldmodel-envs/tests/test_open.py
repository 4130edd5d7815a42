"""Datasets of ours and of others, episode by episode and as windows, with frames decoded where they are looked at."""

import pickle
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from lerobot_sets import CAMERA, HEIGHT, WIDTH, add_video, columns, flat_frames, save_video, write_v2, write_v3

from owm_envs import datasets
from owm_envs.config import load_config
from owm_envs.datasets.cache import Cache
from owm_envs.datasets.frames import Clip, Frames
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.verify import verify
from owm_envs.datasets.windows import grid, mean_actions

LENGTHS = [7, 23, 12]


@pytest.fixture(params=["2.1", "3", "3, a group of 5 rows"])
def others(request, tmp_path):
    """A dataset that others wrote."""
    if request.param == "2.1":
        return write_v2(tmp_path / "set", LENGTHS)
    return write_v3(tmp_path / "set", LENGTHS, 5 if "group" in request.param else 1000)


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """A small dataset of ours."""
    folder = tmp_path_factory.mktemp("ours") / "set"
    config = load_config(fidelity="iss", noise="cooperative", horizon=4.0, ports=["zvezda_aft"])
    generate(folder, config, Request(320, 80, seed=3, episodes_per_batch=8))
    return folder


def test_datasets_of_others_give_their_columns_and_frames(others):
    dataset = datasets.open(others)
    assert len(dataset) == 3 and dataset.fps == 10 and dataset.lengths.tolist() == LENGTHS
    before = 0
    for number, rows in enumerate(LENGTHS):
        found = dataset.columns(number)
        for name, values in columns(number, rows, before).items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)
        assert found[CAMERA].shape == (rows, HEIGHT, WIDTH, 3)
        away = np.abs(np.asarray(found[CAMERA]).astype(int) - flat_frames(rows, before))
        assert away.max() <= 2
        before += rows
    with pytest.raises(ValueError, match=r"holds no docking episodes: it lacks .* use columns\(\)"):
        dataset[0]
    with pytest.raises(IndexError, match="has the episodes 0 to 2, got 3"):
        dataset.columns(3)


def test_statistics_of_version_2_are_those_of_its_episodes_together(tmp_path):
    dataset = datasets.open(write_v2(tmp_path / "set", LENGTHS))
    rows = np.concatenate([columns(i, n, 0)["action"] for i, n in enumerate(LENGTHS)]).astype(np.float64)
    found = dataset.statistics["action"]
    np.testing.assert_allclose(found["mean"], rows.mean(0), rtol=1e-6)
    np.testing.assert_allclose(found["std"], rows.std(0), rtol=1e-6)
    assert found["count"].tolist() == [sum(LENGTHS)]


def test_windows_cross_no_end_and_average_the_actions_between(others):
    windows = datasets.open(others).windows(context=2, rollout=2, stride=3)
    spans = [max(rows - 9, 0) for rows in LENGTHS]
    assert len(windows) == sum(spans) == 17
    place = 0
    for number, rows in enumerate(LENGTHS):
        told = columns(number, rows, 0)
        for first in range(spans[number]):
            item = windows[place]
            np.testing.assert_array_equal(item["observation.state"], told["observation.state"][first : first + 10 : 3])
            mean = told["action"][first : first + 9].reshape(3, 3, 2).mean(axis=1)
            np.testing.assert_array_equal(item["action"], mean)
            assert item[CAMERA].shape == (4, HEIGHT, WIDTH, 3) and item[CAMERA].dtype == np.uint8
            level = item[CAMERA][:, 0, 0, 0].astype(int)
            begins = sum(LENGTHS[:number]) + first
            assert np.abs(level - 5 * (begins + 3 * np.arange(4)) % 250).max() <= 2
            place += 1
    np.testing.assert_array_equal(windows[-1]["action"], windows[16]["action"])
    with pytest.raises(IndexError, match="there are 17 windows, got 17"):
        windows[17]
    assert len(list(windows)) == 17


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ({"context": 0}, "context must be at least 1, got 0"),
        ({"stride": -5}, "stride must be at least 1, got -5"),
        ({"context": 400}, r"a window spans 2076 rows; the longest episode has 81"),
    ],
)
def test_impossible_windows_are_refused(ours, sizes, message):
    with pytest.raises(ValueError, match=message):
        datasets.open(ours, "train").windows(**sizes)


def test_the_grid_ends_where_the_actions_do():
    action = np.arange(12.0)[:, None]
    rows = grid(12, 5, 1)
    assert rows.tolist() == [1, 6, 11] and mean_actions(action, rows).ravel().tolist() == [3, 8]
    assert grid(12, 5, 2).tolist() == [2, 7, 12] and len(mean_actions(action, grid(3, 5))) == 0


def test_an_episode_is_read_alone_and_equals_that_of_all(ours):
    dataset, every = datasets.open(ours, "train"), datasets.read(ours, "train")
    assert len(dataset) == len(every) == 4
    for one, other in zip([dataset[3], dataset[-2], *dataset[:2]], [every[3], every[-2], *every[:2]], strict=True):
        np.testing.assert_array_equal(one.true_state, other.true_state)
        np.testing.assert_array_equal(one.observation["state"], other.observation["state"])
    assert {"mean", "std", "q50"} <= dataset.statistics["action"].keys()
    assert dataset.features["action"]["shape"] == [6]
    with pytest.raises(FileNotFoundError, match="has no split 'test'; it has train, val"):
        datasets.open(ours, "test")


def test_the_camera_of_a_flight_is_a_part_of_its_observation(ours, tmp_path):
    folder = shutil.copytree(ours, tmp_path / "set")
    (folder / "manifest.json").unlink()
    video = add_video(folder / "train")
    dataset = datasets.open(folder, "train")
    before = dataset.lengths[0]
    flight = dataset[1]
    pixels = flight.observation["pixels"]
    assert pixels.shape == (len(flight) + 1, HEIGHT, WIDTH, 3) and pixels.dtype == np.uint8
    assert np.abs(pixels[7:9].astype(int) - flat_frames(2, before + 7)).max() <= 2
    assert dataset.windows(2, 1)[3]["observation.images.fpv"].shape == (3, HEIGHT, WIDTH, 3)
    report = verify(folder)
    assert [f.told for f in report.findings if f.check == "frames"] == [f"{dataset.lengths.sum()} decoded, one a row"]
    save_video(video, 255 - flat_frames(int(dataset.lengths.sum())), 20)
    (found,) = [finding for finding in verify(folder).wrong if finding.check == "frames"]
    assert re.search("mean of observation.images.fpv is .* its frames give", found.told)
    save_video(video, flat_frames(int(dataset.lengths.sum())), 20)
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) // 2])
    (found,) = [finding for finding in verify(folder).wrong if finding.check == "frames"]
    assert "file-000.mp4" in found.told
    save_video(video, flat_frames(int(dataset.lengths.sum()) - 3), 20)
    (found,) = [finding for finding in verify(folder).wrong if finding.check == "frames"]
    assert "frames for 324 rows; frame 321 is missing" in found.told
    save_video(video, flat_frames(400)[:, :16], 20)
    with pytest.raises(ValueError, match=r"frames are \(16, 48, 3\), info.json tells of \(32, 48, 3\)"):
        datasets.open(folder, "train")[0].observation["pixels"][0]
    video.unlink()
    with pytest.raises(FileNotFoundError, match=r"file-000.mp4 is missing"):
        datasets.open(folder, "train")


def test_datasets_and_windows_go_to_other_processes(others):
    windows = datasets.open(others).windows(2, 2, 3)
    whole = windows[5]
    copy = pickle.loads(pickle.dumps(windows))
    assert len(pickle.dumps(windows)) < 20_000, "what was decoded goes with them"
    for name, values in copy[5].items():
        np.testing.assert_array_equal(values, whole[name])


@pytest.mark.parametrize("options", [{"crf": "8"}, {"bf": "0", "g": "10", "crf": "8"}], ids=["b-frames", "ours"])
def test_frames_are_an_array_that_is_decoded_where_looked_at(tmp_path, options):
    save_video(tmp_path / "a.mp4", flat_frames(40), 10, options)
    cache = Cache(10 * HEIGHT * WIDTH * 3)
    frames = Frames(Clip(tmp_path / "a.mp4", 0.5, 30, 10.0), (HEIGHT, WIDTH), cache)
    assert frames.shape == (30, HEIGHT, WIDTH, 3) and frames.dtype == np.uint8 and len(frames) == 30
    truth = flat_frames(40)[5:35].astype(int)
    for rows in (0, 29, -1, 13, slice(3, 9), slice(None, None, -7), [4, 4, 2], slice(5, 5)):
        found = frames[rows]
        assert found.shape == truth[rows].shape
        assert np.abs(found.astype(int) - truth[rows]).max(initial=0) <= 2, rows
    assert cache.bytes <= cache.limit
    assert np.abs(np.asarray(frames).astype(int) - truth).max() <= 2
    assert np.asarray(frames, np.float32).dtype == np.float32
    assert sum(image.shape == (HEIGHT, WIDTH, 3) for image in frames) == 30
    with pytest.raises(IndexError):
        frames[30]


def test_a_frame_that_was_decoded_is_not_decoded_again(tmp_path):
    save_video(tmp_path / "a.mp4", flat_frames(20), 10)
    frames = Frames(Clip(tmp_path / "a.mp4", 0.0, 20, 10.0), (HEIGHT, WIDTH), Cache(2**20))
    first = frames[12]
    (tmp_path / "a.mp4").unlink()
    np.testing.assert_array_equal(frames[12], first)
    np.testing.assert_array_equal(frames[10:13][-1], first)  # on the way from the key frame
    with pytest.raises(FileNotFoundError, match=r"a\.mp4 is missing"):
        frames[3]


def test_a_cache_keeps_what_was_used_last():
    cache = Cache(3)
    for key in "abc":
        cache.put(key, key, 1)
    assert cache.get("a") == "a"
    cache.put("d", "d", 1)
    assert cache.get("b") is None and [cache.get(key) for key in "acd"] == ["a", "c", "d"]
    cache.put("e", "too large", 4)
    assert cache.get("e") is None and cache.bytes == 3


def test_reading_needs_no_loader_and_no_decoder(ours):
    code = (
        "import sys; from owm_envs import datasets; d = datasets.open(sys.argv[1], 'train'); d[0]; d.windows(2, 2)[0];"
        "assert not {'torch', 'grain', 'av', 'datasets', 'lerobot'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code, str(ours)], check=True, timeout=60)
