"""Where and when an episode starts."""

import zlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, Key

from astrojax.attitude import quat_from_rotation_vector, quat_multiply
from astrojax.time import normalize_epoch
from owm_envs.config.params import Params


class Start(NamedTuple):
    """An episode's start: epoch [MJD day, s of day], true relative view, index of the assigned port."""

    epoch: Float[Array, "2"]
    view: Float[Array, "13"]
    port: Int[Array, ""]


def named_key(key: Key[Array, ""], name: str) -> Key[Array, ""]:
    """A key of its own for each named draw, so that adding a draw never moves another."""
    return jax.random.fold_in(key, zlib.crc32(name.encode()))


def isotropic(key: Key[Array, ""], dtype: DTypeLike) -> Float[Array, "3"]:
    """A unit vector, uniform on the sphere."""
    vector = jax.random.normal(key, (3,), dtype)
    norm = jnp.linalg.norm(vector)
    return jnp.where(norm > 0, vector / jnp.where(norm > 0, norm, 1), jnp.eye(3, dtype=dtype)[0])


def sample_start(params: Params, *, key: Key[Array, ""], port: Int[Array, ""]) -> Start:
    """Draw a start; a negative `port` is drawn uniformly from the first `port_count` of `params.port_choices`.

    No draw depends on the time step or on another draw's presence.
    """
    ranges = params.reset
    dtype = ranges.radius_min.dtype

    def uniform(name, low, high):
        return jax.random.uniform(named_key(key, name), (), dtype, low, high)

    def direction(name):
        return isotropic(named_key(key, name), dtype)

    outward = direction("position direction")
    position = uniform("radius", ranges.radius_min, ranges.radius_max) * outward
    velocity = uniform("speed", 0, ranges.speed) * direction("velocity direction")
    rate = uniform("rate", 0, ranges.rate) * direction("rate direction")

    roll = uniform("roll", -jnp.pi, jnp.pi)
    about_nose = jnp.stack([jnp.zeros_like(roll), jnp.zeros_like(roll), roll])
    error = uniform("attitude error", 0, ranges.attitude_error) * direction("attitude error axis")
    attitude = quat_multiply(_quat_nose_to(-outward), quat_from_rotation_vector(about_nose))
    attitude = quat_multiply(attitude, quat_from_rotation_vector(error))

    offset = uniform("epoch", 0, ranges.epoch_window)
    epoch = jnp.stack(normalize_epoch(params.chief.epoch[0], params.chief.epoch[1] + offset))

    choice = jax.random.randint(named_key(key, "port"), (), 0, params.port_count, jnp.int32)
    assigned = jnp.where(port < 0, params.port_choices[choice], port).astype(jnp.int32)
    return Start(epoch, jnp.concatenate([position, velocity, attitude, rate]), assigned)


def _quat_nose_to(direction: Float[Array, "3"]) -> Float[Array, "4"]:
    """The shortest rotation taking body +z to a unit direction; half a turn about x when it is -z."""
    x, y, z = direction
    half = jnp.stack([1 + z, -y, x, jnp.zeros_like(z)])
    norm = jnp.linalg.norm(half)
    turned = jnp.asarray([0.0, 1.0, 0.0, 0.0], direction.dtype)
    return jnp.where(norm > 1e-6, half / jnp.where(norm > 1e-6, norm, 1), turned)
