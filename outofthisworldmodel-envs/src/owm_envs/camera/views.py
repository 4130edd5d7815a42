"""The named cameras, and how to aim one's own."""

from collections.abc import Sequence
from typing import Any, NamedTuple

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
"""Up in the station frame; the nose and up in the chaser's."""


class _Stand(NamedTuple):
    """Where a named camera stands, in the frame of its mount [m], and what it looks at."""

    mount: str
    place: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float]
    field: float
    """deg, or m if orthographic."""
    projection: str = "perspective"


_STANDS = {
    # The paper's: along the nose.
    "chaser_fpv": _Stand("chaser", (0.0, 1.75, 1.55), (0.0, 1.75, 2.55), UP, 82.0),
    "chaser_isometric": _Stand("chaser", (7.0, 7.0, -13.0), (0.0, 0.0, 2.0), UP, 60.0),
    "chaser_top": _Stand("chaser", (0.0, 22.0, 3.0), (0.0, 0.0, 3.0), NOSE, 60.0),
    "station_isometric": _Stand("station", (-88.79, -124.31, 74.59), (0.0, 0.0, 0.0), ZENITH, 45.0),
    "station_top": _Stand("station", (0.0, 0.0, 120.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 120.0, "orthographic"),
}


def _stand(name: str, port: str) -> _Stand:
    if name == "station_fpv":  # just off the port, outwards
        chosen = PORTS[port_index(port)]
        place, target = (np.add(chosen.interface, away * np.array(chosen.normal)) for away in (0.25, 1.25))
        up = (0.0, -1.0, 0.0) if abs(chosen.normal[2]) > 0.9 else ZENITH
        return _Stand("station", tuple(place.tolist()), tuple(target.tolist()), up, 82.0)
    if name not in _STANDS:
        raise ValueError(unknown("camera", name, CAMERA_NAMES))
    return _STANDS[name]


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
    stand = _stand(name, port)
    parallel = changes.get("projection", stand.projection) == "orthographic"
    fields = {
        "mount": stand.mount,
        "position": stand.place,
        "attitude": aimed(stand.place, stand.target, stand.up),
        "projection": stand.projection,
        "field": stand.field if stand.projection == "orthographic" else np.radians(stand.field),
        "exposure": 0.0,
        **changes,
    }
    if height < 1 or width < 1:
        raise ValueError(f"height and width must be at least 1 pixel, got {height} and {width}")
    if not 0.0 < float(fields["field"]) < (np.inf if parallel else np.pi):
        raise ValueError(f"field must be positive, and below pi rad in perspective, got {float(fields['field'])}")
    for output in fields.get("outputs", ()):
        if output not in OUTPUTS:
            raise ValueError(unknown("output", output, OUTPUTS))
    for key in ("position", "attitude", "field", "exposure"):
        fields[key] = jnp.asarray(fields[key], jnp.float32)
    return Camera(height=height, width=width, **fields)
