"""Does the real LeRobot find by name what `owm-envs push` put on a hub? Run by `nox -s lerobot`."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from owm_envs import datasets
from owm_envs.datasets.manifest import write_manifest

LOAD = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset

found = LeRobotDataset(sys.argv[1])
states = found.hf_dataset.with_format("numpy")["observation.state"][:]
print(json.dumps({"episodes": found.num_episodes, "frames": len(found), "revision": str(found.revision)}))
import numpy
numpy.save(sys.argv[2], numpy.stack(list(states)))
"""


@pytest.mark.parametrize("split", ["train", "val"])
def test_lerobot_loads_a_split_by_its_name(local_hub, tmp_path, split):
    path = os.environ.get("OWM_LEROBOT_DATASET")
    if not path:
        pytest.fail("set OWM_LEROBOT_DATASET to a dataset written by `owm-envs generate`")
    run = shutil.copytree(Path(path), tmp_path / "set")
    write_manifest(run)
    # Processes of their own, that take this hub for the one hub from their first import on.
    home = str(tmp_path / "home")
    hub = {"HF_ENDPOINT": local_hub.address, "HF_HOME": home, "HF_HUB_OFFLINE": "0", "HF_HUB_DISABLE_XET": "1"}
    for words in (
        ("-m", "owm_envs", "push", str(run), "user/set"),
        ("-c", LOAD, f"user/set-{split}", str(tmp_path / "states.npy")),
    ):
        done = subprocess.run(
            [sys.executable, *words], env=os.environ | hub, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    ours = datasets.read(run, split)
    told = json.loads(done.stdout.splitlines()[-1])
    assert told == {"episodes": len(ours), "frames": sum(len(e) + 1 for e in ours), "revision": "v3.0"}
    states = np.concatenate([episode.observation["state"] for episode in ours])
    np.testing.assert_array_equal(np.load(tmp_path / "states.npy"), states)
