"""Cameras: where they stand, what they see, and the rays of a picture in tiles."""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax.attitude import quat_multiply, quat_rotate, quat_to_rotation
from owm_envs.camera.trace import SIDE
from owm_envs.camera.vectors import Vector
from owm_envs.view import View


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera: numbers are traced, what shapes the program is static.

    In its own frame a camera looks along +z with +y up, so that -x is the right of the picture.
    """

    position: Float[Array, "3"]
    """m, in the frame of `mount`."""
    attitude: Float[Array, "4"]
    """Unit quaternion, scalar first, from the camera's frame to that of `mount`."""
    field: Float[Array, ""]
    """Of the picture's height: an angle [rad] in perspective, a length [m] if orthographic."""
    exposure: Float[Array, ""]
    """Stops; at 0 a white plane that faces the Sun is just not clipped."""
    height: int = dataclasses.field(metadata={"static": True})
    width: int = dataclasses.field(metadata={"static": True})
    mount: Literal["chaser", "station"] = dataclasses.field(metadata={"static": True}, default="chaser")
    projection: Literal["perspective", "orthographic"] = dataclasses.field(
        metadata={"static": True}, default="perspective"
    )
    samples: int = dataclasses.field(metadata={"static": True}, default=1)
    """Rays along each side of a pixel."""
    outputs: tuple[str, ...] = dataclasses.field(metadata={"static": True}, default=("rgb",))
    """Of `rgb`, `depth`, `part`, `port`, `normal`."""


class Pose(NamedTuple):
    """Where a camera is in the station frame."""

    position: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    """Columns: right, up and forward."""


def placed(camera: Camera, view: View) -> Pose:
    """Give the camera's pose in the station frame, float32, when the chaser is at `view`."""
    position, attitude = (jnp.asarray(part, jnp.float32) for part in (camera.position, camera.attitude))
    if camera.mount == "chaser":
        body = view.attitude.astype(jnp.float32)
        position = view.position.astype(jnp.float32) + quat_rotate(body, position)
        attitude = quat_multiply(body, attitude)
    return Pose(position, quat_to_rotation(attitude) * jnp.asarray([[-1.0, 1.0, 1.0]], jnp.float32))


def project(
    camera: Camera, pose: Pose, points: Float[Array, "... 3"]
) -> tuple[Float[Array, "... 2"], Float[Array, "..."]]:
    """Give where points appear in the picture; NumPy in, NumPy out.

    Args:
        camera: whose picture.
        pose: as `placed` gives it; with its position at zero, `points` are directions to what is far away.
        points: m, station frame.

    Returns:
        pixels: column and row, counted from the top left corner: the first pixel's middle is at (0.5, 0.5).
        depth: along the optical axis [m]. In perspective, pixels mean nothing where it is not above 0.
    """
    xp = np if isinstance(points, np.ndarray) else jnp
    offset = [points[..., j] - pose.position[j] for j in range(3)]
    right, up, depth = (sum(pose.axes[j, axis] * offset[j] for j in range(3)) for axis in range(3))
    if camera.projection == "perspective":
        scale = 0.5 * camera.height / (xp.tan(0.5 * camera.field) * xp.where(depth > 0, depth, 1))
    else:
        scale = camera.height / camera.field
    return xp.stack([0.5 * camera.width + scale * right, 0.5 * camera.height - scale * up], axis=-1), depth


class Rays(NamedTuple):
    """The rays of a picture: tiles row by row, in each 64 pixels row by row."""

    origin: Vector
    """(T, 64), or (1, 1) where all start at one point [m]."""
    way: Vector
    """Unit directions, (T, 64), or (1, 1) where all run parallel."""
    across: Float[Array, "C"]
    down: Float[Array, "R"]
    """Borders of the tiles' columns and rows, as `columns_and_rows` takes them."""
    spread: Float[Array, ""]
    """Width of a ray at distance 1, or at any if parallel [m]."""


def rays(camera: Camera, pose: Pose) -> Rays:
    """Give a ray through the middle of each of the picture's samples."""
    height, width = camera.height * camera.samples, camera.width * camera.samples
    rows, columns = -(-height // SIDE), -(-width // SIDE)
    perspective = camera.projection == "perspective"
    extent = 2.0 * jnp.tan(0.5 * camera.field) if perspective else camera.field
    step = extent.astype(jnp.float32) / height
    across = step * (jnp.arange(columns + 1, dtype=jnp.float32) * SIDE - 0.5 * width)
    down = step * (0.5 * height - jnp.arange(rows + 1, dtype=jnp.float32) * SIDE)
    inner = step * (jnp.arange(SIDE, dtype=jnp.float32) + 0.5)
    x = across[None, :-1, None, None] + inner[None, None, None, :]
    y = down[:-1, None, None, None] - inner[None, None, :, None]
    x, y = (a.reshape(rows * columns, SIDE * SIDE) for a in jnp.broadcast_arrays(x, y))
    right, up, forward = pose.axes.T
    offset = tuple(x * right[j] + y * up[j] for j in range(3))
    point = lambda a: tuple(a[j].reshape(1, 1) for j in range(3))
    if perspective:
        inverse = jax.lax.rsqrt(1.0 + x * x + y * y)
        way = tuple((o + forward[j]) * inverse for j, o in enumerate(offset))
        return Rays(point(pose.position), way, across, down, step)
    origin = tuple(o + pose.position[j] for j, o in enumerate(offset))
    return Rays(origin, point(forward), across, down, step)


def picture(values: Float[Array, "T 64"], camera: Camera) -> Float[Array, "H W"]:
    """Put the values of tiles, of every sample, in the places of the picture."""
    height, width = camera.height * camera.samples, camera.width * camera.samples
    rows, columns = -(-height // SIDE), -(-width // SIDE)
    grid = values.reshape(rows, columns, SIDE, SIDE).swapaxes(1, 2)
    return grid.reshape(rows * SIDE, columns * SIDE)[:height, :width]
