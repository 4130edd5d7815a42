"""A flight as Rerun reads it back. Run by `nox -s browser`, which brings rerun-sdk."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
from rerun.chunk import RrdReader

from owm_envs import cli
from owm_envs.datasets.writer import recording
from owm_envs.replay import Pictures, recorded, save_rrd


@pytest.fixture(scope="module")
def episode(swoop):
    return swoop(24)


@pytest.fixture(scope="module")
def file(episode, slow_config, tmp_path_factory):
    images = np.full((3, 8, 8, 3), 90, np.uint8)
    flight = replace(recorded("Swoop", episode, slow_config), pictures=Pictures(np.array([0, 8, 16]), images, "seen"))
    return save_rrd(tmp_path_factory.mktemp("rerun") / "flight.rrd", flight)


def test_rerun_finds_no_fault(file):
    subprocess.run(["rerun", "rrd", "verify", str(file)], check=True, capture_output=True, timeout=120)


def test_poses_curves_and_frames_come_back(file, episode):
    chunks = {}
    for chunk in RrdReader(file).stream().to_chunks():
        if not chunk.is_static and chunk.num_rows:
            chunks.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())

    def column(place, name):
        batches = [batch for batch in chunks[place] if name in batch.schema.names]
        return np.concatenate([np.array(batch.column(name).to_pylist()) for batch in batches])

    position = column("/station/chaser", "Transform3D:translation").reshape(-1, 3)
    assert np.allclose(position, episode.true_state[:, :3], atol=1e-4)
    attitude = column("/station/chaser", "Transform3D:quaternion").reshape(-1, 4)
    assert np.allclose(attitude, np.roll(episode.true_state[:, 6:10], -1, axis=1), atol=1e-6)
    seconds = column("/station/chaser", "flight").astype("timedelta64[ns]") / np.timedelta64(1, "s")
    assert np.allclose(seconds, 0.25 * np.arange(25))
    forces = column("/curves/force/force_y", "Scalars:scalars").ravel()
    assert np.allclose(forces, np.append(episode.action[:, 1], 0))
    assert sum(batch.num_rows for batch in chunks["/station/chaser/nose"]) == 3


def test_the_command_writes_it_beside_the_page(episode, slow_config, tmp_path, capsys):
    with recording(tmp_path / "run", slow_config) as writer:
        writer.write([episode])
    cli.main(["replay", str(tmp_path / "run"), "--rerun", "--out", str(tmp_path / "out.html")])
    assert {path.name for path in tmp_path.iterdir()} == {"run", "out.html", "out.rrd"}
    assert f"{tmp_path / 'out.rrd'}: " in capsys.readouterr().out
