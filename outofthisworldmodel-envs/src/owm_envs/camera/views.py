"""The named cameras, and how to aim one's own."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from astrojax.attitude import rotation_to_quat
from owm_envs.camera.lens import Camera
from owm_envs.camera.render import OUTPUTS
from owm_envs.config.camera import CAMERA_NAMES
from owm_envs.station.ports import PORTS, port_index
from owm_envs.words import unknown

ZENITH, NOSE, UP = (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
FPV_PLACE, FPV_FIELD_DEG = (0.0, 1.75, 1.55), 82.0
"""The paper's camera: place in the chaser's body [m] and vertical field of view."""

_ISOMETRIC = np.array([-0.50, -0.70, 0.42])


def aimed(position: Sequence[float], target: Sequence[float], up: Sequence[float] = ZENITH) -> Float[np.ndarray, "4"]:
    """Give the attitude of a camera that looks from one point at another.

    Args:
        position, target: m, in the frame of the camera's mount.
        up: what shall point up in the picture, as nearly as can be; not along the line of sight.

    Returns:
        (4,) unit quaternion, scalar first, from the camera's frame to its mount's.

    Raises:
        ValueError: the two points are one, or `up` lies along the line of sight.
    """
    forward = np.asarray(target, np.float64) - np.asarray(position, np.float64)
    right = np.cross(forward, np.asarray(up, np.float64))
    if np.linalg.norm(right) < 1e-9 * max(np.linalg.norm(forward), 1e-9):
        raise ValueError(f"a camera at {position} cannot look at {target} with {up} upwards")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return np.asarray(rotation_to_quat(jnp.asarray(np.stack([-right, np.cross(right, forward), forward], axis=1))))


def camera(
    name: str = "chaser_fpv", *, height: int = 512, width: int = 512, port: str = PORTS[0].name, **changes: Any
) -> Camera:
    """Make one of the named cameras.

    Args:
        name: of `CAMERA_NAMES`.
        height, width: of the picture in pixels.
        port: at which `station_fpv` stands, looking out along its corridor.
        changes: other fields of `Camera`; numbers become float32.

    Raises:
        ValueError: an unknown name, port or output, a size of less than one pixel, or a field of view out of range.
    """
    perspective = {"projection": "perspective", "field": np.radians(FPV_FIELD_DEG)}
    if name == "chaser_fpv":
        fields = {"mount": "chaser", "position": FPV_PLACE, "attitude": (1.0, 0.0, 0.0, 0.0), **perspective}
    elif name == "chaser_isometric":
        place = (7.0, 7.0, -13.0)
        fields = {"mount": "chaser", "position": place, "attitude": aimed(place, (0.0, 0.0, 2.0), UP), **perspective}
        fields["field"] = np.radians(60.0)
    elif name == "chaser_top":
        place = (0.0, 22.0, 3.0)
        fields = {"mount": "chaser", "position": place, "attitude": aimed(place, (0.0, 0.0, 3.0), NOSE), **perspective}
        fields["field"] = np.radians(60.0)
    elif name == "station_isometric":
        place = tuple((170.0 * _ISOMETRIC / np.linalg.norm(_ISOMETRIC)).tolist())
        fields = {"mount": "station", "position": place, "attitude": aimed(place, (0.0, 0.0, 0.0)), **perspective}
        fields["field"] = np.radians(45.0)
    elif name == "station_top":
        place = (0.0, 0.0, 120.0)
        attitude = aimed(place, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
        fields = {
            "mount": "station",
            "position": place,
            "attitude": attitude,
            "projection": "orthographic",
            "field": 120.0,
        }
    elif name == "station_fpv":
        chosen = PORTS[port_index(port)]
        place = np.array(chosen.interface) + 0.25 * np.array(chosen.normal)
        vertical = abs(chosen.normal[2]) > 0.9
        attitude = aimed(place, place + np.array(chosen.normal), (0.0, -1.0, 0.0) if vertical else ZENITH)
        fields = {"mount": "station", "position": place, "attitude": attitude, **perspective}
    else:
        raise ValueError(unknown("camera", name, CAMERA_NAMES))
    fields = {"exposure": 0.0, **fields, **changes}
    for key in ("position", "attitude", "field", "exposure"):
        fields[key] = jnp.asarray(fields[key], jnp.float32)
    if height < 1 or width < 1:
        raise ValueError(f"height and width must be at least 1 pixel, got {height} and {width}")
    for output in fields.get("outputs", ()):
        if output not in OUTPUTS:
            raise ValueError(unknown("output", output, OUTPUTS))
    return Camera(height=height, width=width, **fields)
