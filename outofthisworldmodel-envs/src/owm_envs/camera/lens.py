"""Cameras: where they stand, what they see, and the rays of a picture in tiles."""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from astrojax.attitude import quat_multiply, quat_rotate, quat_to_rotation
from owm_envs.camera.trace import LANES, SIDE
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
        place, body = (jnp.asarray(part, jnp.float32) for part in (view.position, view.attitude))
        position = place + quat_rotate(body, position)
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


class Grid(NamedTuple):
    """How a picture is cut into tiles, on the plane at distance 1 of a perspective camera, or in metres."""

    across: Float[Array, "C"]
    """Borders of the columns, from the left."""
    down: Float[Array, "R"]
    """Borders of the rows, falling from the top."""
    step: Float[Array, ""]
    """Width of a sample."""


def grid(camera: Camera) -> Grid:
    """Cut a picture into tiles; the last ones of a row or column may reach beyond it."""
    rows, columns = _tiles(camera)
    perspective = camera.projection == "perspective"
    extent = 2.0 * jnp.tan(0.5 * camera.field) if perspective else camera.field
    step = extent.astype(jnp.float32) / (camera.height * camera.samples)
    across = step * (jnp.arange(columns + 1, dtype=jnp.float32) * SIDE - 0.5 * camera.width * camera.samples)
    down = step * (0.5 * camera.height * camera.samples - jnp.arange(rows + 1, dtype=jnp.float32) * SIDE)
    return Grid(across, down, step)


def _tiles(camera: Camera) -> tuple[int, int]:
    """Rows and columns of tiles."""
    return -(-camera.height * camera.samples // SIDE), -(-camera.width * camera.samples // SIDE)


class Rays(NamedTuple):
    """Rays through the middles of samples: 64 a tile, row by row."""

    origin: Vector
    """(B, 64), or (1, 1) where all start at one point [m]."""
    way: Vector
    """Unit directions, (B, 64), or (1, 1) where all run parallel."""


def rays(camera: Camera, pose: Pose, grid: Grid, tiles: Int[Array, "B"]) -> Rays:
    """Give the rays of some tiles, which count row by row."""
    inner = grid.step * (jnp.arange(SIDE, dtype=jnp.float32) + 0.5)
    columns = grid.across.shape[0] - 1
    x = grid.across[tiles % columns][:, None, None] + inner[None, None, :]
    y = grid.down[tiles // columns][:, None, None] - inner[None, :, None]
    x, y = (a.reshape(-1, LANES) for a in jnp.broadcast_arrays(x, y))
    right, up, forward = pose.axes.T
    offset = tuple(x * right[j] + y * up[j] for j in range(3))
    point = lambda a: tuple(a[j].reshape(1, 1) for j in range(3))
    if camera.projection == "perspective":
        inverse = jax.lax.rsqrt(1.0 + x * x + y * y)
        return Rays(point(pose.position), tuple((o + forward[j]) * inverse for j, o in enumerate(offset)))
    return Rays(tuple(o + pose.position[j] for j, o in enumerate(offset)), point(forward))


def arranged(values: Float[Array, "T 64"], camera: Camera) -> Float[Array, "H W"]:
    """Put the values of tiles, of every sample, in the places of the picture."""
    rows, columns = _tiles(camera)
    grid = values.reshape(rows, columns, SIDE, SIDE).swapaxes(1, 2).reshape(rows * SIDE, columns * SIDE)
    return grid[: camera.height * camera.samples, : camera.width * camera.samples]
