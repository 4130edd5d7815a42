"""Does the real LeRobot read what `owm-envs generate` wrote? Run by `nox -s lerobot`, which brings LeRobot."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from owm_envs import datasets
from owm_envs.datasets.schema import FEATURES, columns_from_episode
from owm_envs.station import PORT_NAMES


@pytest.fixture(scope="session")
def folder() -> Path:
    path = os.environ.get("OWM_LEROBOT_DATASET")
    if not path:
        pytest.fail("set OWM_LEROBOT_DATASET to a dataset written by `owm-envs generate`")
    return Path(path)


@pytest.fixture(scope="session", params=["train", "val"])
def split(request, folder):
    """(the episodes as we read them, LeRobot's view of the same folder)."""
    theirs = LeRobotDataset(f"local/{request.param}", root=folder / request.param)
    return datasets.read(folder, request.param), theirs


def test_lerobot_counts_the_same_episodes_and_frames(split):
    ours, theirs = split
    assert theirs.num_episodes == len(ours)
    assert len(theirs) == sum(len(episode) + 1 for episode in ours)
    assert theirs.fps == 20
    assert {name: tuple(feature["shape"]) for name, feature in theirs.features.items()} == {
        name: feature.shape for name, feature in FEATURES.items()
    }


def test_lerobot_holds_the_same_bits(split):
    ours, theirs = split
    table = theirs.hf_dataset.with_format("arrow")
    first = 0
    for number, episode in enumerate(ours):
        wanted = columns_from_episode(episode, episode_index=number, first_index=first, fps=theirs.fps)
        rows = table[first : first + len(episode) + 1]
        for name, values in wanted.items():
            held = rows[name].combine_chunks()
            flat = held.flatten() if values.ndim > 1 else held
            held = flat.to_numpy(zero_copy_only=False).reshape(values.shape)
            assert held.dtype == values.dtype, name
            np.testing.assert_array_equal(held, values, err_msg=name)
        first += len(episode) + 1


def test_an_item_is_a_frame_with_its_task(split):
    ours, theirs = split
    item = theirs[0]
    np.testing.assert_array_equal(item["observation.state"].numpy(), ours[0].observation["state"][0])
    # LeRobot hands float64 columns out as float32 tensors; the file keeps them whole, as the test above shows.
    np.testing.assert_array_equal(item["observation.environment_state"].numpy(), ours[0].true_state[0].astype("f4"))
    assert item["next.done"].dtype == torch.bool
    assert PORT_NAMES[ours[0].port].replace("_", " ") in item["task"]


def test_the_statistics_normalise_by_train(split, folder):
    _, theirs = split
    actions = np.concatenate([episode.action for episode in datasets.read(folder, "train")]).astype(np.float64)
    statistics = theirs.meta.stats
    np.testing.assert_allclose(statistics["action"]["mean"], actions.mean(axis=0), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(statistics["action"]["std"], actions.std(axis=0), rtol=1e-6)
    assert set(statistics) == set(FEATURES)


def test_windows_and_batches_come_out_as_lerobot_trains_on_them(split, folder):
    ours, theirs = split
    windows = LeRobotDataset(
        theirs.repo_id, root=theirs.root, delta_timestamps={"observation.state": [-0.05, 0.0], "action": [0.0, 0.05]}
    )
    loader = torch.utils.data.DataLoader(windows, batch_size=4, shuffle=False)
    batch = next(iter(loader))
    assert batch["observation.state"].shape == (4, 2, 13) and batch["action"].shape == (4, 2, 6)
    np.testing.assert_array_equal(batch["observation.state"][1].numpy(), ours[0].observation["state"][:2])
    np.testing.assert_array_equal(batch["action"][1].numpy(), ours[0].action[1:3])
    assert batch["observation.state_is_pad"][0].tolist() == [True, False]


def test_a_single_episode_can_be_chosen(split):
    ours, theirs = split
    last = len(ours) - 1
    chosen = LeRobotDataset(theirs.repo_id, root=theirs.root, episodes=[last])
    assert len(chosen) == len(ours[last]) + 1
    np.testing.assert_array_equal(chosen[0]["observation.state"].numpy(), ours[last].observation["state"][0])
