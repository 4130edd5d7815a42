"""Pictures of the sky alone, from the station: `python tools/look_at_sky.py OUT`."""

import sys
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from astrojax.compilation import compiler_options
from owm_envs.camera.light import heavens
from owm_envs.camera.sky import load_sky, sky_radiance, splat_stars
from owm_envs.dynamics import PhysicalState, station_orbit
from owm_envs.env import DockingEnv

SIZE = 768, 1024


def camera(look, up, fov_deg, size=SIZE):
    """Directions (H, W, 3), their projection, and the angle between pixels."""
    height, width = size
    ahead = np.array(look, float) / np.linalg.norm(look)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    focal = 0.5 * height / np.tan(np.radians(fov_deg) / 2)
    rows, columns = np.mgrid[:height, :width]
    rays = (columns - (width - 1) / 2)[..., None] * right - (rows - (height - 1) / 2)[..., None] * above + focal * ahead
    axes = jnp.asarray(np.stack([right, -above, ahead]), jnp.float32)

    def project(toward):
        seen = toward @ axes.T
        deep = jnp.where(seen[:, 2] > 1e-3, seen[:, 2], 1.0)
        centre = jnp.asarray([(width - 1) / 2, (height - 1) / 2], jnp.float32)
        return seen[:, :2] / deep[:, None] * jnp.float32(focal) + centre, seen[:, 2] > 1e-3

    rays = jnp.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True), jnp.float32)
    return rays, project, jnp.float32(1 / focal)


def picture(sky, above, look, up, fov_deg, exposure=1.0):
    rays, project, footprint = camera(look, up, fov_deg)
    light = jax.jit(sky_radiance, compiler_options=compiler_options())(sky, above, rays, footprint)
    light = exposure * np.asarray(light + splat_stars(sky, above, project, SIZE))
    assert np.isfinite(light).all()
    toned = light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)
    shown = np.where(toned < 0.0031308, 12.92 * toned, 1.055 * np.clip(toned, 1e-9, None) ** (1 / 2.4) - 0.055)
    return np.round(255 * np.clip(shown, 0, 1)).astype(np.uint8)


def week(step=20.0):
    """The heavens every `step` seconds of the first two days from the reference epoch, and place and Sun below."""
    with jax.enable_x64(True):
        env = DockingEnv(None, fidelity="iss-hcw")
        params = env.default_params()

        @jax.jit
        def at(t):
            day = jnp.floor(t / 86_400)
            epoch = jnp.stack([params.chief.epoch[0] + day, t - 86_400 * day])
            orbit = station_orbit(env.dynamics, params, PhysicalState(epoch, jnp.zeros(()), None, None))
            return heavens(epoch, orbit[:3], orbit[3:])

        return jax.lax.map(at, jnp.arange(0, 7 * 86_400.0, step))


def main(out: Path) -> None:
    sky, every = load_sky(), week()
    every = jax.tree.map(np.asarray, every)
    below = np.einsum("nij,j->ni", every.earth_from_station, [0, 0, 1])
    latitude, longitude = np.degrees(np.arcsin(below[:, 2])), np.degrees(np.arctan2(below[:, 1], below[:, 0]))
    sun = np.degrees(np.arcsin(every.sun[:, 2]))

    def nearest(lat, lon, elevation, weight=1.0):
        away = np.hypot(latitude - lat, (longitude - lon + 180) % 360 - 180) + weight * np.abs(sun - elevation)
        k = int(away.argmin())
        print(f"asked {lat} {lon} sun {elevation}: {latitude[k]:.1f} {longitude[k]:.1f} sun {sun[k]:.1f}")
        return jax.tree.map(lambda x: jnp.asarray(x[k]), every)

    forward, nadir = (0, -1, 0), (0, 0, -1)
    limb = (0, -1, -0.42)
    shots = {
        "nadir": (nearest(24, 20, 60), nadir, forward, 60),
        "limb": (nearest(40, 10, 50), limb, (0, 0, 1), 60),
        "pacific": (nearest(0, -150, 50), (0, -1, -0.7), (0, 0, 1), 70),
        "terminator": (nearest(20, 80, 2, 4.0), (0, -1, -0.5), (0, 0, 1), 75),
        "night": (nearest(42, 5, -40, 0.3), (0, -1, -0.5), (0, 0, 1), 65),
        "america": (nearest(38, -90, -40, 0.3), (0, -1, -0.7), (0, 0, 1), 65),
    }
    low = nearest(0, -30, 25, 1.0)
    flat = np.array([low.sun[0], low.sun[1], 0])
    shots["glint"] = (low, [*flat[:2] / np.linalg.norm(flat), -0.6], (0, 0, 1), 60)
    dawn = nearest(0, -140, -18, 6.0)
    flat = np.array([dawn.sun[0], dawn.sun[1], 0])
    shots["sunrise"] = (dawn, [*flat[:2] / np.linalg.norm(flat), -0.35], (0, 0, 1), 30)
    zenith = nearest(-30, 100, -50, 1.0)
    shots["stars"] = (zenith, (0.3, -1, 0.3), (0, 0, 1), 60)
    moonlit = nearest(-30, 100, -30, 3.0)
    shots["moon"] = (moonlit, tuple(moonlit.moon), (0, 0, 1), 10)
    for name, (above, *view) in shots.items():
        cv2.imwrite(str(out / f"sky_{name}.png"), picture(sky, above, *view)[..., ::-1])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
