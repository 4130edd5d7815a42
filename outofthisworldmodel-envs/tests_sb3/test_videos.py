"""Flights recorded by Gymnasium's and Stable-Baselines3's wrappers, which need MoviePy (100 MB with its ffmpeg)."""

import cv2
import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.wrappers import vector as vector_wrappers
from stable_baselines3.common.vec_env import VecVideoRecorder

import owm_envs  # noqa: F401 - registers the ids
from owm_envs.sb3 import make_vec_env

SHORT = {"horizon": 0.2, "render_mode": "rgb_array", "width": 480, "height": 270}  # four steps an episode
EVERY = {"episode_trigger": lambda episode: True}


def read(file):
    """A video's frames per second, its frames (N, height, width, 3)."""
    capture = cv2.VideoCapture(str(file))
    frames = []
    while (frame := capture.read())[0]:
        frames.append(frame[1])
    return capture.get(cv2.CAP_PROP_FPS), np.array(frames)


def test_record_video_of_an_episode(tmp_path):
    env = wrappers.RecordVideo(gymnasium.make("ISSHCW-v0", **SHORT), str(tmp_path), **EVERY)
    env.reset(seed=0)
    size = env.render().shape
    for _ in range(4):
        *_, truncated, _ = env.step(env.action_space.sample())
    env.close()
    (file,) = tmp_path.iterdir()
    rate, frames = read(file)
    assert truncated and rate == 20 and frames.shape == (5, *size)
    assert frames.std() > 5  # a picture, not a blank


@pytest.mark.parametrize(("mode", "lengths"), [("next_step", [5, 5]), ("same_step", [4, 4]), ("disabled", [5, 5])])
def test_record_video_of_a_batch(tmp_path, mode, lengths):
    """In same-step mode the last frame is missing, as the wrapper warns."""
    env = gymnasium.make_vec("ISSHCW-v0", num_envs=2, autoreset_mode=mode, **SHORT)
    env = vector_wrappers.RecordVideo(env, str(tmp_path), **EVERY)
    env.reset(seed=0)
    height, width, _ = env.render()[0].shape
    while len(list(tmp_path.iterdir())) < len(lengths):
        _, _, _, truncated, _ = env.step(env.action_space.sample())
        if mode == "disabled" and truncated.any():
            env.reset(options={"reset_mask": truncated})
    videos = [read(file)[1] for file in sorted(tmp_path.iterdir())]
    env.close()
    assert [len(frames) for frames in videos] == lengths
    assert videos[0].shape[1] * videos[0].shape[2] == 2 * height * width


def test_stable_baselines_records_too(tmp_path):
    venv = make_vec_env("iss-hcw", 2, seed=0, horizon=4.0, render_mode="rgb_array", width=480, height=270)
    venv = VecVideoRecorder(venv, str(tmp_path), lambda step: step == 0, video_length=3)
    venv.reset()
    for _ in range(4):
        venv.step(np.zeros((2, 6), np.float32))
    venv.close()
    (file,) = tmp_path.glob("*.mp4")
    assert len(read(file)[1]) == 4  # the start and three steps
