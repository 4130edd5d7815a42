"""Each named camera's picture against one that was looked at: `golden/make.py` changes the look on purpose."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

FOLDER = Path(__file__).parent / "golden"
TOLERANCE = 0.05  # of the picture's mean; another processor's rounding moves edges by less


def difference(image, golden):
    """The mean difference of two pictures after a blur of a pixel, in parts of the mean of the second."""
    first, second = (cv2.GaussianBlur(np.asarray(part, np.float32), (0, 0), 1.0) for part in (image, golden))
    return np.abs(first - second).mean() / second.mean()


@pytest.fixture(scope="module")
def make():
    spec = importlib.util.spec_from_file_location("golden_make", FOLDER / "make.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.png")), ids=lambda file: file.stem)
def test_a_picture_looks_as_it_did(make, file):
    golden = cv2.imread(str(file))[..., ::-1]
    assert difference(make.picture(file.stem), golden) < TOLERANCE


def test_the_tolerance_tells_pictures_apart():
    """A quarter more light, or a shift by three pixels, is out of tolerance."""
    files = sorted(FOLDER.glob("*.png"))
    for file in files:
        golden = cv2.imread(str(file))[..., ::-1]
        for other in (np.minimum(golden * 1.25, 255.0), np.roll(golden, 3, axis=0)):
            assert difference(other, golden) > TOLERANCE, file.stem
