"""A recording with a camera: what is read, and what `verify` says of its pictures."""

import shutil

import numpy as np
import pytest
import seeing

from owm_envs import datasets
from owm_envs.config import load_config
from owm_envs.datasets.generate import generate
from owm_envs.datasets.manifest import write_manifest
from owm_envs.datasets.verify import verify
from owm_envs.video import VideoWriter


@pytest.mark.slow
@pytest.mark.parametrize("channels", ["rgb", "depth"])
def test_pictures_are_read_and_drawn_anew(seeing_run, tmp_path, channels):
    folder = tmp_path / "set"
    if channels == "rgb":
        shutil.copytree(seeing_run, folder)
    else:
        camera = {**seeing.CONFIG.camera.model_dump(), "channels": channels}
        generate(folder, load_config(seeing.CONFIG, camera=camera), seeing.REQUEST)
    dataset = datasets.open(folder, "train")
    flight = dataset[0]
    pixels = flight.observation["pixels"]
    assert pixels.shape == (5, 16, 16, 3 if channels == "rgb" else 1)
    held = np.asarray(pixels)[:2].astype(np.float64)
    assert np.abs(held - held[0]).max() <= (4 if channels == "rgb" else 0)  # between instants it is held
    report = verify(folder)
    assert report.sound, report.wrong
    told = {finding.split: finding.told for finding in report.findings if finding.check == "picture"}
    assert told.keys() == {"train", "val"} and all("drawn anew" in text for text in told.values())
    if channels == "rgb":
        video = dataset.layout.span(0).clips["observation.images.fpv"].path
        frames = 255 - np.asarray([*dataset[0].observation["pixels"]] * len(dataset))
        writer = VideoWriter(video, 4)
        for image in frames:
            writer.write(image)
        writer.close()
        write_manifest(folder)
        wrong = [finding for finding in verify(folder).wrong if finding.check == "picture"]
        assert [finding.split for finding in wrong] == ["train"] and "dB, at least 25" in wrong[0].told
