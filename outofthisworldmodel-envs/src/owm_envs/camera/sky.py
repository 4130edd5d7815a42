"""What lies behind the station: the Earth with its air and clouds, the Sun, the Moon and the stars.

Radiance is linear RGB in units of a white matt plane that faces the Sun, so that sunlight is an irradiance of pi. The
maps are stored by octahedron, so that a look-up takes no trigonometry, as pyramids of halved resolutions.
"""

import functools
import math
import os
from collections.abc import Callable
from importlib.resources import files
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt

from astrojax.constants import R_EARTH, WGS84_F
from owm_envs.camera.light import Heavens
from owm_envs.camera.trace import settled
from owm_envs.files import plain_file

SIDE = 2880
"""Cells along a side of the finest map: 8 km on the ground."""
LEVELS = 7
FINE = 8
"""Cells of the grain to one of the finest map."""
GRAIN = 512
"""Side of the tile of grain, a power of two."""
BLOCK = 4096
"""Directions at a time, so that intermediate results stay in the cache."""
TEXEL = (4 * np.pi) ** 0.5
"""Mean cell of a map of side 1, rad."""

SCALE_HEIGHT = 8_000.0 / R_EARTH
GRAZING = 35.4
"""Air masses from a point at sea level to its horizon: sqrt(pi R / 2 H)."""
RAYLEIGH = (0.041, 0.098, 0.236)
"""Optical depth of clear air, straight up, at 680, 550 and 440 nm (Bodhaine et al. 1999, J. Atmos. Ocean. Tech. 16)."""
HAZE = (0.030, 0.033, 0.038)
REDDEST = (1.3, 3.0, 5.5)
"""By how much thick air takes more of each colour of a low Sun; of no source but the eye."""
SLOPE = 0.028
"""Mean square slope of the sea at a wind of 5 m/s (Cox and Munk 1954)."""
MOON_ALBEDO = 0.12
NIGHT_GAIN = 0.3
"""Radiance of the brightest city, and an eighth of what a star of magnitude zero adds to a pixel. Both are far
brighter than life, so that eight bits show them beside sunlit hulls."""


class Sky(NamedTuple):
    """The maps and stars as arrays, to be passed into compiled functions."""

    surface: UInt[Array, "T"]
    """Red, green, blue (square roots of reflectance) and share of water, a byte each, all levels end to end."""
    veil: UInt[Array, "T"]
    """Opacity of clouds, lights of cities (square root) and slopes of the clouds along either axis, a byte each."""
    grain: UInt[Array, "G"]
    """A tile of noise finer than the maps: its value, and its slopes along either axis, a byte each."""
    stars: Float[Array, "S 3"]
    """Unit vectors, ICRF."""
    starlight: Float[Array, "S 3"]
    """Radiance that a star adds to one pixel."""
    night_gain: Float[Array, ""]
    """Radiance of the brightest city."""


# --- loading ---


def load_sky(
    earth: str | os.PathLike | None = None,
    clouds: str | os.PathLike | None = None,
    night: str | os.PathLike | None = None,
    *,
    night_gain: float = NIGHT_GAIN,
) -> Sky:
    """The sky of the packaged maps, or of one's own; loaded once, about 100 MB.

    Args:
        earth: image of the ground by day, equirectangular, 180 W at the left edge and north up.
        clouds: opacity of clouds, grey, likewise.
        night: lights, grey, likewise.
        night_gain: radiance of the brightest city, an eighth of a star's of magnitude zero.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a file is no image, or not twice as wide as high.
    """
    given = (None if path is None else os.path.abspath(path) for path in (earth, clouds, night))
    return _load(*given)._replace(night_gain=jnp.float32(night_gain)) if night_gain != NIGHT_GAIN else _load(*given)


@functools.cache
def _load(earth: str | None, clouds: str | None, night: str | None) -> Sky:
    import cv2

    # Read first, so that a file which cannot be is told at once.
    ground = _read(earth, "earth.jpg", colours=True)[..., ::-1]
    above, lights = _read(clouds, "clouds.jpg"), _read(night, "night.jpg")
    places = _node_places()
    surface = [*np.moveaxis(_spread(ground, places), -1, 0), _spread(_read(None, "water.jpg"), places)]
    cover = _spread(above, places)
    slopes = np.gradient(cv2.GaussianBlur(cover, (0, 0), 1.0).astype(np.float32))
    veil = [cover, _spread(lights, places), *(_signed(2 * slope) for slope in slopes[::-1])]
    with np.load(files(__package__) / "assets/stars.npz") as catalogue:
        stars, magnitude, colour = (catalogue[name] for name in ("direction", "magnitude", "colour"))
    light = 8 * 10.0 ** (-0.4 * magnitude)[:, None] * _tint(colour)
    with jax.ensure_compile_time_eval():  # kept for later calls, so no part of a program that asks for it first
        return Sky(
            surface=jnp.asarray(_pyramid(np.stack(surface, -1))),
            veil=jnp.asarray(_pyramid(np.stack(veil, -1))),
            grain=jnp.asarray(_grain()),
            stars=jnp.asarray(stars, jnp.float32),
            starlight=jnp.asarray(light, jnp.float32),
            night_gain=jnp.float32(NIGHT_GAIN),
        )


def _read(path: str | None, packaged: str, colours: bool = False) -> np.ndarray:
    import cv2

    if path is None:
        data = (files(__package__) / "assets" / packaged).read_bytes()
    else:
        data = plain_file(path).read_bytes()
    mode = cv2.IMREAD_COLOR if colours else cv2.IMREAD_GRAYSCALE
    image = cv2.imdecode(np.frombuffer(data, np.uint8), mode) if data else None
    if image is None:
        raise ValueError(f"map {path!r} is no image that can be read (JPEG or PNG)")
    if image.shape[1] != 2 * image.shape[0]:
        raise ValueError(f"map {path!r} must be twice as wide as high, got {image.shape[1]} by {image.shape[0]}")
    return image


def _node_places() -> tuple[np.ndarray, np.ndarray]:
    """Longitude and latitude [turns] of the nodes of the finest map."""
    line = np.linspace(-1, 1, SIDE + 1, dtype=np.float32)
    u, v = line[None, :], line[:, None]
    z = 1 - np.abs(u) - np.abs(v)
    below = z < 0
    x = np.where(below, (1 - np.abs(v)) * np.where(u < 0, -1, 1), u)
    y = np.where(below, (1 - np.abs(u)) * np.where(v < 0, -1, 1), v)
    return np.arctan2(y, x) / (2 * np.pi), np.arctan2(z, np.hypot(x, y)) / (2 * np.pi)


def _spread(image: np.ndarray, places: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """An equirectangular image at the nodes."""
    import cv2

    height, width = image.shape[:2]
    longitude, latitude = (place.astype(np.float32) for place in places)
    column, row = (longitude + 0.5) * width - 0.5, np.clip((0.25 - latitude) * 2 * height - 0.5, 0, height - 1)
    return cv2.remap(np.ascontiguousarray(image), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def _pyramid(level: np.ndarray) -> np.ndarray:
    """Levels of (n + 1, n + 1, 4) bytes, each half the last, packed end to end."""
    import cv2

    packed = []
    for _ in range(LEVELS):
        packed.append(np.ascontiguousarray(level).view(np.uint32).ravel())
        # Beyond an edge lies the same edge's other half.
        wide = np.pad(level, ((1, 1), (1, 1), (0, 0)))
        wide[0, 1:-1], wide[-1, 1:-1] = level[1, ::-1], level[-2, ::-1]
        wide[1:-1, 0], wide[1:-1, -1] = level[::-1, 1], level[::-1, -2]
        wide[0, 0], wide[0, -1], wide[-1, 0], wide[-1, -1] = level[1, 1], level[1, -2], level[-2, 1], level[-2, -2]
        tent = np.array([0.25, 0.5, 0.25])
        level = cv2.sepFilter2D(wide, -1, tent, tent)[1:-1:2, 1:-1:2]
    return np.concatenate(packed)


def _signed(slope: np.ndarray) -> np.ndarray:
    """Slopes as bytes, 128 for none."""
    return np.clip(np.round(slope) + 128, 0, 255).astype(np.uint8)


def _grain() -> np.ndarray:
    """A tile of fractal noise: white noise with its waves damped by their frequency."""
    white = np.random.default_rng(0).standard_normal((GRAIN, GRAIN))
    along = np.fft.fftfreq(GRAIN) * GRAIN
    frequency = np.hypot(along[:, None], along)
    waves = np.fft.fft2(white) * frequency / (frequency + 4.0) ** 2.35
    field = np.fft.ifft2(waves).real
    field = np.clip(0.5 + 0.2 * field / field.std(), 0, 1) * 255
    slopes = (np.roll(field, -1, axis) - np.roll(field, 1, axis) for axis in (1, 0))
    tile = np.stack([field.round().astype(np.uint8), *(_signed(slope) for slope in slopes)], -1)
    return np.pad(tile, ((0, 0), (0, 0), (0, 1))).view(np.uint32).ravel()


def _tint(colour: np.ndarray) -> np.ndarray:
    """Linear RGB of a star of colour index B-V, as bright as white."""
    warm = np.clip(colour, -0.3, 1.8)[:, None] - 0.45
    rgb = np.exp(warm * np.array([0.45, 0.0, -0.75]))
    return rgb / (rgb @ np.array([0.2126, 0.7152, 0.0722]))[:, None]


# --- looking ---


def sky_radiance(
    sky: Sky, heavens: Heavens, directions: Float[Array, "*N 3"], footprint: Float[Array, ""]
) -> Float[Array, "*N 3"]:
    """Linear radiance of all but the stars along directions from the station.

    Args:
        directions: unit vectors, station frame.
        footprint: angle between neighbouring pixels, rad.
    """
    shape = directions.shape[:-1]
    count = math.prod(shape)
    if count <= BLOCK or count % BLOCK:
        return _radiance(sky, heavens, directions, footprint)
    blocks = directions.reshape(-1, BLOCK, 3)
    return jax.lax.map(lambda block: _radiance(sky, heavens, block, footprint), blocks).reshape(*shape, 3)


def _radiance(sky, heavens, directions, footprint):
    hold = functools.partial(settled, sky.night_gain >= 0)
    dx, dy, dz = hold([directions[..., axis] for axis in range(3)])

    def along(vector):
        return dx * vector[0] + dy * vector[1] + dz * vector[2]

    # In units of the Earth's radius. A ray that passes the Earth is met where it comes nearest.
    here = -heavens.earth / R_EARTH
    height_sq = jnp.sum(here * here) - 1.0
    falling = along(here)
    inside = falling * falling - height_sq
    hits = (inside > 0) & (falling < 0)
    up = jnp.sqrt(jnp.where(hits, inside, 0.0) + 1e-12)  # cosine of the view's zenith angle on the ground
    distance = jnp.maximum(-falling, 0.0) - jnp.where(hits, up, 0.0)
    px, py, pz = (here[axis] + distance * d for axis, d in enumerate((dx, dy, dz)))
    radius_sq = px * px + py * py + pz * pz
    inverse = jax.lax.rsqrt(radius_sq)
    altitude = jnp.maximum(0.5 * (radius_sq - 1.0) * (1 + inverse) * inverse, 0.0)
    altitude = jnp.where(hits, 0.0, altitude)
    nx, ny, nz = hold((px * inverse, py * inverse, pz * inverse))
    falling, hits, up, distance, altitude = hold((falling, hits, up, distance, altitude))

    day = _light(heavens, nx, ny, nz, altitude)
    # Sunlight on level ground, spread over the terminator; it ends with the astronomical twilight.
    soft = 0.5 * (day + jnp.sqrt(day * day + 1.6e-3)) * jnp.clip(1.0 + 4.0 * day, 0.0, 1.0)
    toward_sun = along(heavens.sun)
    day, soft, toward_sun = hold((day, soft, toward_sun))
    air, through, sunlit = _air(hold, day, soft, up, altitude, hits, toward_sun)
    ground = _ground(hold, sky, heavens, (nx, ny, nz), up, distance, day, soft, sunlit, toward_sun, footprint)
    glow = _airglow(sky, altitude, hits, day)
    beyond = _sun_and_moon(heavens, along, toward_sun, footprint)
    channels = []
    for c in range(3):
        # Half of what the air takes from a wide scene goes forward and arrives all the same.
        behind = jnp.where(hits, jnp.sqrt(through[c]) * ground[c], through[c] * beyond[c])
        channels.append(air[c] + glow[c] + behind)
    return hold(jnp.stack(hold(channels), -1))


def _light(heavens, nx, ny, nz, altitude):
    """Cosine of the Sun's zenith angle; from on high the Sun sets later."""
    level = nx * heavens.sun[0] + ny * heavens.sun[1] + nz * heavens.sun[2]
    return level + 0.4 * jnp.sqrt(2.0 * altitude + 1e-12)


def _air_masses(cosine):
    """Air between a point at sea level and space; below the horizon it grows without bound."""
    width = 2.0 / GRAZING
    return 2.0 / (cosine + jnp.sqrt(cosine * cosine + width * width))


def _air(hold, day, soft, up, altitude, hits, toward_sun):
    """Light scattered in by the air, what it lets through, and what of the Sun reaches the ground; by colour."""
    density = jnp.exp(altitude * (-1.0 / SCALE_HEIGHT))
    column = jnp.where(hits, _air_masses(up), 2.0 * GRAZING)
    masses = column * density
    to_sun = _air_masses(day)
    rayleigh = 0.1875 * (1.0 + toward_sun * toward_sun)
    forward = jax.lax.rsqrt(1.55 - 1.4 * toward_sun)
    mie = 0.07 * forward * forward * forward
    again = 0.3 * soft / (soft + 0.12)  # light scattered more than once, of all colours
    air, through, sunlit = [], [], []
    for clear, haze, red in zip(RAYLEIGH, HAZE, REDDEST):
        depth = clear + haze
        passed = jnp.exp(-depth * masses)
        reached = jnp.exp(-to_sun * jnp.minimum(0.5 * depth * density, red / column))
        phase = (clear / depth) * 1.25 * rayleigh + (haze / depth) * mie
        air.append(phase * (1.0 - passed) * (0.7 * reached + again))
        through.append(passed)
        sunlit.append(reached)
    return hold((air, through, sunlit))


def _airglow(sky, altitude, hits, day):
    """The green line of oxygen, 95 km up, seen edge on at night."""
    layer = (altitude - 95_000.0 / R_EARTH) * (R_EARTH / 6_000.0)
    strength = jnp.where(hits, 0.0, 0.10 * sky.night_gain * jnp.exp(-layer * layer))
    strength = strength * jnp.clip(-4.0 * day, 0.0, 1.0)
    return [strength * part for part in (0.35, 1.0, 0.45)]


def _sun_and_moon(heavens, along, toward_sun, footprint):
    """The two discs and the Sun's glare; a disc smaller than a pixel is spread over one."""
    off_sun = jnp.sqrt(jnp.maximum(2.0 - 2.0 * toward_sun, 0.0) + 1e-12)
    wide = jnp.maximum(heavens.sun_radius, 0.6 * footprint)
    disc = jnp.clip((wide - off_sun) / footprint + 0.5, 0.0, 1.0) / (wide * wide)
    # Nothing of the glare of a Sun behind the Earth.
    sun = disc + heavens.sunlight * 1e-3 / (off_sun * off_sun + 2e-4)

    toward_moon = along(heavens.moon)
    off_moon = jnp.sqrt(jnp.maximum(2.0 - 2.0 * toward_moon, 0.0) + 1e-12)
    radius = jnp.maximum(heavens.moon_radius, 0.6 * footprint)
    disc = jnp.clip((radius - off_moon) / footprint + 0.5, 0.0, 1.0)
    share = disc * (heavens.moon_radius / radius) ** 2
    # The normal under the ray: across the disc by the offset, the rest towards us.
    across = toward_sun - toward_moon * jnp.sum(heavens.sun * heavens.moon)
    facing = jnp.sqrt(jnp.maximum(1.0 - (off_moon / radius) ** 2, 0.0) + 1e-6)
    lit = across / radius - facing * jnp.sum(heavens.sun * heavens.moon)
    lit = jnp.maximum(lit, 0.0)
    moon = MOON_ALBEDO * share * 2.0 * lit / (lit + facing + 1e-3)
    sun = sun * (1.0 - share)
    return [sun + moon, sun + 0.97 * moon, sun + 0.92 * moon]


def _ground(hold, sky, heavens, normal, up, distance, day, soft, sunlit, toward_sun, footprint):
    """Land, sea, clouds and cities."""
    fixed = heavens.earth_from_station * jnp.asarray([[1.0], [1.0], [(1.0 - WGS84_F) ** -2]], jnp.float32)
    x, y, z = (fixed[row, 0] * normal[0] + fixed[row, 1] * normal[1] + fixed[row, 2] * normal[2] for row in range(3))
    wide = distance * footprint * jax.lax.rsqrt(jnp.maximum(up, 0.02)) * (SIDE / TEXEL)
    level = jnp.clip(jnp.log2(jnp.maximum(wide, 1e-3)) + 0.5, 0.0, LEVELS - 1.0).astype(jnp.int32)
    x, y, z = hold((x, y, z))
    u, v = hold(_octahedral(x, y, z))
    corners, weights = _nodes(hold, u, v, level)
    red, green, blue, water = _mixed(hold, sky.surface, corners, weights)
    cover, lights, cover_u, cover_v = _mixed(hold, sky.veil, corners, weights)
    rough, rough_u, rough_v, _ = _mixed(hold, sky.grain, *_grain_nodes(hold, u, v))

    # Below the maps' resolution the grain breaks up edges; it fades before pixels grow coarser than it.
    fine = jnp.clip(1.6 - 2.5 * wide, 0.0, 1.0)
    rough = (rough - 0.5) * fine
    edge = 4.0 * cover * (1.0 - cover)
    cover = jnp.clip(cover + (1.5 * rough + 0.5 * fine * (cover - 0.5)) * edge, 0.0, 1.0)
    # Slopes of the clouds that face the Sun are brighter, by how far a step towards it moves over the map.
    step = 1e-3
    sx, sy, sz = (jnp.sum(fixed[row] * heavens.sun) for row in range(3))
    near_u, near_v = _octahedral(x + step * sx, y + step * sy, z + step * sz)
    to_u, to_v = (near_u - u) * (1.0 / step), (near_v - v) * (1.0 / step)
    climb = (cover_u - 0.502) * to_u + (cover_v - 0.502) * to_v
    climb = 1.6 * climb + fine * (0.35 + edge) * ((rough_u - 0.502) * to_u + (rough_v - 0.502) * to_v)
    relief = jnp.clip(1.0 - climb / (0.25 + jnp.maximum(day, 0.0)), 0.45, 1.25)

    # A facet of sea that mirrors the Sun to us lies half way between the two.
    half_sq = 2.0 - 2.0 * toward_sun
    rise = (day + up) ** 2 / jnp.maximum(half_sq, 1e-6)
    facing = jnp.maximum(rise, 1e-3)
    slope = jnp.exp(-(1.0 - facing) / (facing * SLOPE))
    cosine = jnp.sqrt(jnp.maximum(0.25 * half_sq, 0.0) + 1e-12)
    graze = 1.0 - jnp.minimum(cosine, 1.0)
    fresnel = 0.02 + 0.98 * graze * graze * graze * graze * graze
    glint = fresnel * slope / (4.0 * SLOPE * facing * facing * jnp.maximum(up, 0.05))
    glint = jnp.where(day > 0, jnp.minimum(glint, 4.0), 0.0) * water * (0.8 + 1.2 * rough)

    open_sky = 1.0 - cover
    lights = jnp.maximum(lights * (1.0 + 4.0 * rough), 0.0)
    night = sky.night_gain * lights * lights * (1.0 - 0.7 * cover) * jnp.clip(-8.0 * day + 0.2, 0.0, 1.0)
    mottled = 0.72 * (1.0 + (0.45 - 0.35 * water) * rough)
    channels = []
    white = 0.84 * relief * (1.0 + 0.35 * rough)
    for root, reached, lamp, fill in zip((red, green, blue), sunlit, (1.0, 0.72, 0.38), (0.40, 0.45, 0.54)):
        # What air takes from the Sun's beam comes down in part, from all of the sky.
        diffuse = soft * (fill + (1.0 - fill) * reached)
        bare = mottled * root * root * diffuse + glint * reached
        channels.append(bare * open_sky + white * diffuse * cover + night * lamp)
    return channels


def _octahedral(x, y, z):
    """Place of a direction on the maps, in [-1, 1]."""
    scale = 1.0 / (jnp.abs(x) + jnp.abs(y) + jnp.abs(z))
    x, y = x * scale, y * scale
    u = jnp.where(z < 0, jnp.copysign(1.0 - jnp.abs(y), x), x)
    v = jnp.where(z < 0, jnp.copysign(1.0 - jnp.abs(x), y), y)
    return u, v


def _nodes(hold, u, v, level):
    """Indices of the four nodes around a place, and their weights in 256ths."""
    side = jnp.right_shift(jnp.int32(SIDE), level)
    start = 4 * ((SIDE * SIDE - side * side) // 3) + 4 * (SIDE - side) + level
    # In 256ths of a cell; 2880 * 256 is exact in float32.
    length = side.astype(jnp.float32) * 256.0
    u, v = (jnp.clip((place + 1.0) * 0.5 * length, 0.0, length - 1.0).astype(jnp.int32) for place in (u, v))
    first = start + (v >> 8) * (side + 1) + (u >> 8)
    return hold(((first, first + 1, first + side + 1, first + side + 2), _weights(u & 255, v & 255)))


def _grain_nodes(hold, u, v):
    """The same of the tile of grain, which repeats."""
    u, v = (((place + 1.0) * (0.5 * SIDE * FINE * 256)).astype(jnp.int32) for place in (u, v))
    left, low = (u >> 8) & (GRAIN - 1), (v >> 8) & (GRAIN - 1)
    right, high = (left + 1) & (GRAIN - 1), (low + 1) & (GRAIN - 1)
    low, high = low * GRAIN, high * GRAIN
    return hold(((low + left, low + right, high + left, high + right), _weights(u & 255, v & 255)))


def _weights(u, v):
    both = (u * v) >> 8
    weights = (256 - u - v + both, u - both, v - both, both)
    return tuple(weight.astype(jnp.uint32) for weight in weights)


def _mixed(hold, packed, corners, weights):
    """The four bytes of a packed map at weighted nodes, in [0, 1]; two at a time, in the halves of a word."""
    even, odd = jnp.uint32(0), jnp.uint32(0)
    texels = hold([packed.at[corner].get(mode="promise_in_bounds") for corner in corners])
    for texel, weight in zip(texels, weights):
        even = even + (texel & 0x00FF00FF) * weight
        odd = odd + ((texel >> 8) & 0x00FF00FF) * weight
    parts = (even & 0xFFFF, odd & 0xFFFF, even >> 16, odd >> 16)
    return [part.astype(jnp.float32) * (1.0 / 65280.0) for part in parts]


def splat_stars(
    sky: Sky,
    heavens: Heavens,
    project: Callable[[Float[Array, "S 3"]], tuple[Float[Array, "S 2"], Bool[Array, "S"]]],
    size: tuple[int, int],
) -> Float[Array, "H W 3"]:
    """Radiance that the stars add to an image; each fills one pixel, shared among the four that it lies between.

    Args:
        project: from unit vectors in the station frame to column and row (pixel centres at whole numbers), and
            whether a star is before the camera.
        size: height and width, pixels.
    """
    height, width = size
    toward = jnp.matmul(sky.stars, heavens.icrf_from_station, precision=jax.lax.Precision.HIGHEST)
    here = -heavens.earth / R_EARTH
    falling = jnp.sum(toward * here[None], -1)
    nearest = jnp.sum(here * here) - falling * falling
    clear = (falling > 0) | (nearest > (1 + 2 * SCALE_HEIGHT) ** 2)
    place, before = project(toward)
    shown = clear & before & jnp.all(jnp.isfinite(place), -1)
    place = jnp.where(shown[:, None], place, -10.0)
    corner = jnp.floor(place)
    share = place - corner
    column, row = (jnp.clip(corner[:, axis], -2.0, 1e6).astype(jnp.int32) for axis in range(2))
    image = jnp.zeros((height, width, 3), jnp.float32)
    light = sky.starlight * sky.night_gain
    for down in range(2):
        for right in range(2):
            weight = jnp.abs(1 - down - share[:, 1]) * jnp.abs(1 - right - share[:, 0])
            at = jnp.where(row + down < 0, height, row + down), jnp.where(column + right < 0, width, column + right)
            image = image.at[at].add(weight[:, None] * light, mode="drop")
    return image
