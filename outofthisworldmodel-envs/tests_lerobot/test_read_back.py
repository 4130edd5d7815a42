"""Does the real LeRobot read what `owm-envs generate` wrote? Run by `nox -s lerobot`, which brings LeRobot."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from datasets import load_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from owm_envs import datasets
from owm_envs.datasets.schema import columns_from_episode
from owm_envs.station import PORT_NAMES

EXAMPLE = Path(__file__).parents[2] / "examples" / "load_torch.py"
VIEW = "observation.images.fpv"


@pytest.fixture(scope="session")
def folder() -> Path:
    path = os.environ.get("OWM_LEROBOT_DATASET")
    if not path:
        pytest.fail("set OWM_LEROBOT_DATASET to a dataset written by `owm-envs generate`")
    return Path(path)


@pytest.fixture(scope="session", params=["train", "val"])
def split(request, folder):
    """(the dataset as we read it, LeRobot's view of the same folder)."""
    theirs = LeRobotDataset(f"local/{request.param}", root=folder / request.param, video_backend="pyav")
    return datasets.open(folder, request.param), theirs


def test_lerobot_counts_the_same_episodes_and_frames(split):
    ours, theirs = split
    assert theirs.num_episodes == len(ours)
    assert len(theirs) == ours.lengths.sum()
    assert theirs.fps == ours.fps
    assert {name: tuple(feature["shape"]) for name, feature in theirs.features.items()} == {
        name: tuple(feature["shape"]) for name, feature in ours.features.items()
    }


def test_lerobot_holds_the_same_bits(split):
    ours, theirs = split
    table = theirs.hf_dataset.with_format("arrow")
    first = 0
    for number, episode in enumerate(ours):
        wanted = columns_from_episode(episode, episode_index=number, first_index=first, fps=theirs.fps)
        rows = table[first : first + len(episode) + 1]
        for name, values in wanted.items():
            if name not in rows.column_names:
                continue  # a video
            held = rows[name].combine_chunks()
            flat = held.flatten() if values.ndim > 1 else held
            held = flat.to_numpy(zero_copy_only=False).reshape(values.shape)
            assert held.dtype == values.dtype, name
            np.testing.assert_array_equal(held, values, err_msg=name)
        first += len(episode) + 1


def test_an_item_is_a_frame_with_its_task(split):
    ours, theirs = split
    item, episode = theirs[0], ours[0]
    np.testing.assert_array_equal(item["observation.state"].numpy(), episode.observation["state"][0])
    # LeRobot hands float64 columns out as float32 tensors; the file keeps them whole, as the test above shows.
    np.testing.assert_array_equal(item["observation.environment_state"].numpy(), episode.true_state[0].astype("f4"))
    assert item["next.done"].dtype == torch.bool
    assert PORT_NAMES[episode.port].replace("_", " ") in item["task"]


def test_lerobot_sees_the_same_pictures(split):
    """Frames of several episodes, within a level of ours: the decoders round colours each in their way."""
    ours, theirs = split
    if VIEW not in ours.features:
        pytest.skip("the dataset has no camera")
    for number in (0, len(ours) // 2, len(ours) - 1):
        pixels, first = ours[number].observation["pixels"], int(ours.lengths[:number].sum())
        for row in (0, 1, len(pixels) // 2, len(pixels) - 1):
            seen = theirs[first + row][VIEW].permute(1, 2, 0).numpy() * 255
            assert np.abs(seen - pixels[row]).max() <= 1, (number, row)


def test_the_statistics_normalise_by_train(split, folder):
    ours, theirs = split
    actions = np.concatenate([episode.action for episode in datasets.read(folder, "train")]).astype(np.float64)
    statistics = theirs.meta.stats
    np.testing.assert_allclose(statistics["action"]["mean"], actions.mean(axis=0), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(statistics["action"]["std"], actions.std(axis=0), rtol=1e-6)
    assert set(statistics) == set(ours.features)


def test_windows_and_batches_come_out_as_lerobot_trains_on_them(split, folder):
    ours, theirs = split
    windows = LeRobotDataset(
        theirs.repo_id,
        root=theirs.root,
        delta_timestamps={"observation.state": [-1 / theirs.fps, 0.0], "action": [0.0, 1 / theirs.fps]},
        video_backend="pyav",
    )
    loader = torch.utils.data.DataLoader(windows, batch_size=4, shuffle=False)
    batch, episode = next(iter(loader)), ours[0]
    assert batch["observation.state"].shape == (4, 2, 13) and batch["action"].shape == (4, 2, 6)
    np.testing.assert_array_equal(batch["observation.state"][1].numpy(), episode.observation["state"][:2])
    np.testing.assert_array_equal(batch["action"][1].numpy(), episode.action[1:3])
    assert batch["observation.state_is_pad"][0].tolist() == [True, False]


def test_a_single_episode_can_be_chosen(split):
    ours, theirs = split
    last = len(ours) - 1
    chosen = LeRobotDataset(theirs.repo_id, root=theirs.root, episodes=[last], video_backend="pyav")
    assert len(chosen) == len(ours[last]) + 1
    np.testing.assert_array_equal(chosen[0]["observation.state"].numpy(), ours[last].observation["state"][0])


def test_the_datasets_library_loads_the_rows(split, folder):
    ours, _ = split
    rows = load_dataset("parquet", data_files=str(ours.folder / "data/*/*.parquet"), split="train").with_format("numpy")
    assert len(rows) == ours.lengths.sum()
    np.testing.assert_array_equal(rows[:5]["observation.state"], ours[0].observation["state"][:5])


def test_a_torch_loader_takes_windows(folder):
    command = [sys.executable, str(EXAMPLE), str(folder), "--batch", "4", "--batches", "3", "--workers", "2"]
    said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=300).stdout
    assert "observation.state: (4, 24, 13) torch.float32" in said and "action: (4, 23, 6) torch.float32" in said
    assert "3 batches" in said


def _program(name: str, *arguments: str) -> subprocess.CompletedProcess:
    command = [str(Path(sys.executable).with_name(name)), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def test_lerobot_doctor_finds_nothing_wrong(split):
    ours, _ = split
    done = _program("lerobot-doctor", "check", str(ours.folder))
    assert done.returncode == 0 and "FAIL" not in done.stdout, done.stdout + done.stderr


OF_ARMS = {"DEAD_JOINT", "SATURATED_JOINT", "ACTION_STATE_DIVERGENCE_CRASHED", "ACTION_RANGE_MISMATCH_CRASHED"}
"""What lerobot-lint says of anything but an arm: it takes each number of the state for a joint that has an action."""
OF_SIZE = {"UNITS_INFERRED", "TOO_FEW_EPISODES", "TASK_IMBALANCE", "DURATION_OUTLIER"}
"""What it remarks on small datasets, and on flights that end early."""


def test_lerobot_lint_finds_nothing_wrong_but_that_a_chaser_is_no_arm(split, tmp_path):
    """Timing, frames, jumps, frozen states, lengths and tasks are as it wants them."""
    ours, _ = split
    done = _program("lelint", "check", str(ours.folder), "--json", str(tmp_path / "report.json"))
    told = json.loads((tmp_path / "report.json").read_text())["findings"]
    assert [finding for finding in told if finding["check"] not in OF_ARMS | OF_SIZE] == [], done.stderr
