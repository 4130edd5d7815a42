"""What is damaged is refused in one line, by each reader; what only a recomputation can know, by `verify`."""

import shutil
import sys
from pathlib import Path

import pytest

from owm_envs import datasets
from owm_envs.config import load_config
from owm_envs.datasets.generate import Request, generate
from owm_envs.datasets.manifest import MANIFEST, write_manifest

sys.path.insert(0, str(Path(__file__).parent))

from damaged import DAMAGES

CONFIG = load_config(fidelity="iss", noise="cooperative", horizon=2.0, ports=["zvezda_aft", "pirs_nadir"])


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A small dataset of both splits, with its manifest."""
    folder = tmp_path_factory.mktemp("sound") / "set"
    generate(folder, CONFIG, Request(160, 80, seed=7, episodes_per_batch=8))
    write_manifest(folder)
    return folder


@pytest.fixture
def copy(sound, tmp_path):
    """A copy to damage."""
    return shutil.copytree(sound, tmp_path / "set")


def read_all(folder: Path) -> None:
    """Read all that readers read."""
    for split in ("train", "val"):
        datasets.read(folder, split)
        datasets.read_statistics(folder, split)


def refusal(folder: Path) -> str | None:
    """How a dataset is refused; None if it is not. Nothing but these errors may be raised."""
    try:
        read_all(folder)
    except (ValueError, FileNotFoundError) as error:
        return str(error)
    return None


def test_a_sound_dataset_is_read(sound):
    assert refusal(sound) is None


@pytest.mark.parametrize("manifest", ["none", "made to fit"])
@pytest.mark.parametrize("name", DAMAGES)
def test_each_damage_is_refused(copy, name, manifest):
    (copy / MANIFEST).unlink()
    DAMAGES[name](copy)
    if manifest != "none":
        write_manifest(copy)
    said = refusal(copy)
    print(said)
    assert said is not None
    assert "\n" not in said
