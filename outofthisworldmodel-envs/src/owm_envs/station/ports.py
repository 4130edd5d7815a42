"""The eight docking ports of the station and the poses the chaser is asked to hold in front of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from owm_envs.words import unknown


class Port(NamedTuple):
    """One docking port in the station frame (+x port side, +y aft, +z zenith; metres)."""

    name: str
    interface: tuple[float, float, float]
    """Centre of the mating plane [m]."""
    normal: tuple[float, float, float]
    """Outward unit vector of the approach corridor."""
    standoff: float
    """Distance from the mating plane to the centre of a chaser that holds at the goal [m]."""
    mechanism: str
    """"IDSS", "CBM" or "SSVP"."""
    split: str
    """"train" or "held_out"."""


PORTS: tuple[Port, ...] = (
    Port("harmony_forward", (0.194, -20.840, -3.336), (0.0, -1.0, 0.0), 3.66, "IDSS", "train"),
    Port("harmony_zenith", (0.233, -14.939, -0.218), (0.0, 0.0, 1.0), 5.0, "CBM", "held_out"),
    Port("harmony_nadir", (0.233, -14.939, -4.985), (0.0, 0.0, -1.0), 5.0, "CBM", "train"),
    Port("zvezda_aft", (0.233, 32.550, -1.870), (0.0, 1.0, 0.0), 6.0, "SSVP", "train"),
    Port("poisk_zenith", (0.233, 20.129, 3.555), (0.0, 0.0, 1.0), 5.0, "SSVP", "held_out"),
    Port("pirs_nadir", (0.233, 20.129, -7.290), (0.0, 0.0, -1.0), 5.5, "SSVP", "train"),
    Port("rassvet_nadir", (0.240, 7.161, -9.267), (0.0, 0.0, -1.0), 5.5, "SSVP", "train"),
    Port("unity_nadir", (0.233, 0.166, -4.918), (0.0, 0.0, -1.0), 6.5, "CBM", "held_out"),
)
"""The ports in their canonical order; a port's index everywhere is its place in this tuple."""

PORT_NAMES: tuple[str, ...] = tuple(port.name for port in PORTS)
TRAIN_PORTS: tuple[str, ...] = tuple(port.name for port in PORTS if port.split == "train")
HELD_OUT_PORTS: tuple[str, ...] = tuple(port.name for port in PORTS if port.split == "held_out")


def port_index(name: str) -> int:
    """Give the index of a port in `PORTS`.

    Args:
        name: a name from `PORT_NAMES`.

    Raises:
        ValueError: the name is unknown; the message names the nearest one and all known ones.
    """
    if name in PORT_NAMES:
        return PORT_NAMES.index(name)
    raise ValueError(unknown("port", name, PORT_NAMES))


def port_indices(ports: str | int | Sequence[str | int] | np.ndarray, slots: int | None = None) -> Int[np.ndarray, "B"]:
    """Give the indices of the ports of a batch of slots.

    Args:
        ports: one name or index for every slot, or one a slot.
        slots: how many there are; as many as there are ports when None.

    Raises:
        ValueError: a port is unknown, or there are not as many as slots.
    """
    values = np.asarray(ports)
    truths = isinstance(ports, Sequence) and any(isinstance(port, bool) for port in ports)
    if values.dtype.kind in "UO":
        named = [port_index(name) if isinstance(name, str) else name for name in values.ravel().tolist()]
        values = np.array(named).reshape(values.shape)
    count = len(PORTS)
    if truths or values.ndim > 1 or values.dtype.kind not in "iu" or (values < 0).any() or (values >= count).any():
        raise ValueError(
            f"ports must be names or indices from 0 to {count - 1}, one for each slot, got {values.tolist()}"
        )
    if values.ndim == 0:
        values = np.repeat(values, 1 if slots is None else slots)
    if slots is not None and len(values) != slots:
        raise ValueError(f"ports must have shape ({slots},), one for each slot, or be a single one, got {values.shape}")
    return values.astype(np.int32)


def docked_attitude(normal: tuple[float, float, float]) -> Float[np.ndarray, "4"]:
    """Give the attitude that points the chaser's nose into a port.

    Body +z is against the outward normal; body +y is as near to nadir as the corridor allows, or as near to
    forward where the corridor itself is vertical.

    Args:
        normal: (3,) outward unit normal of the port, station frame.

    Returns:
        (4,) unit quaternion q_bw (scalar first, body to station), its first non-zero component positive.
    """
    nose = -np.asarray(normal, np.float64)
    vertical = abs(nose[2]) > 0.99
    up = np.array((0.0, -1.0, 0.0) if vertical else (0.0, 0.0, -1.0), np.float64)
    y_axis = up - (up @ nose) * nose
    y_axis /= np.linalg.norm(y_axis)
    rotation = np.stack([np.cross(y_axis, nose), y_axis, nose], axis=1)
    # The eigenvector of Bar-Itzhack's symmetric matrix stays well defined at half turns, where w = 0.
    m = rotation
    bar_itzhack = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ],
        np.float64,
    )
    q = np.linalg.eigh(bar_itzhack)[1][:, -1]
    q = np.where(np.abs(q) < 1e-12, 0.0, q)
    return q * np.sign(q[np.flatnonzero(q)[0]]) + 0.0


def goal_poses() -> Float[np.ndarray, "8 7"]:
    """Give the pose a docking chaser must hold, for every port.

    Returns:
        (8, 7) float64 in `PORTS` order: centre position [m] and q_bw (scalar first), station frame.
    """
    rows = []
    for port in PORTS:
        position = np.asarray(port.interface, np.float64) + port.standoff * np.asarray(port.normal, np.float64)
        rows.append(np.concatenate([position, docked_attitude(port.normal)]))
    return np.stack(rows)


def outward_normals(poses: Float[np.ndarray, "P 7"]) -> Float[np.ndarray, "P 3"]:
    """Give the outward normals of ports from hold poses: against the nose of a chaser that holds there.

    Args:
        poses: (P, 7) position [m] and unit q_bw (scalar first).

    Returns:
        (P, 3) unit vectors.
    """
    w, x, y, z = np.asarray(poses, np.float64)[:, 3:].T
    return -np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
