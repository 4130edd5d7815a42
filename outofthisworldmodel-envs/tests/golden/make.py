"""Draw the golden pictures anew, to be looked at: `python outofthisworldmodel-envs/tests/golden/make.py`."""

from pathlib import Path

import cv2
import jax
import numpy as np

from owm_envs.camera.render import render
from owm_envs.camera.scene import default_scene
from owm_envs.camera.views import CAMERA_NAMES, camera
from owm_envs.station import PORTS, docked_attitude
from owm_envs.view import View

HERE = Path(__file__).parent


def picture(name: str) -> np.ndarray:
    """What a named camera sees of a chaser 25 m before Harmony forward, by the light of `noon`, without a sky."""
    port = PORTS[0]
    place = np.array(port.interface) + 25.0 * np.array(port.normal)
    view = View.of(np.concatenate([place, np.zeros(3), docked_attitude(port.normal), np.zeros(3)]).astype(np.float32))
    shot = camera(name, height=96, width=96, samples=2)
    return np.asarray(jax.jit(render)(default_scene(), view, shot)["rgb"])


if __name__ == "__main__":
    for camera_name in CAMERA_NAMES:
        cv2.imwrite(str(HERE / f"{camera_name}.png"), picture(camera_name)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
