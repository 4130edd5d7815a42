"""Draw the gallery: an approach as the chaser sees it, an orbit by day, dusk and night, a docking as a film.

python tools/gallery.py ../docs/images            # about two minutes
"""

import argparse
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from astrojax.constants import GM_EARTH
from astrojax.orbits import keplerian_to_cartesian, propagate_keplerian
from owm_envs.camera.lens import Camera
from owm_envs.camera.light import Heavens, heavens
from owm_envs.camera.render import render
from owm_envs.camera.scene import Scene, default_scene
from owm_envs.camera.sky import load_sky
from owm_envs.camera.views import camera
from owm_envs.dynamics.chief import elements_at
from owm_envs.env import DockingEnv
from owm_envs.episode import Episode
from owm_envs.film import frames
from owm_envs.policies.factory import make_policy
from owm_envs.rollout import episodes, rollout
from owm_envs.station import PORTS, goal_poses, port_index
from owm_envs.view import View

DRAW = jax.jit(lambda scene, view, eye: render(scene, view, eye)["rgb"])


def orbit(days: float, minutes: np.ndarray) -> Heavens:
    """What stands where over an orbit that begins so many days after the reference epoch; one row a minute."""
    with jax.enable_x64(True):
        chief = DockingEnv(fidelity="iss").default_params().chief
        chief = jax.tree.map(lambda a: a.astype(jnp.float64), chief)
        start = chief.epoch + jnp.asarray([days, 0.0])

        def at(seconds):
            elements = propagate_keplerian(elements_at(chief, start), seconds, GM_EARTH)
            state = keplerian_to_cartesian(elements, GM_EARTH)
            return heavens(start + jnp.stack([jnp.zeros(()), seconds]), state[:3], state[3:])

        return jax.jit(jax.vmap(at))(jnp.asarray(60.0 * minutes))


def before(port: str, distance: float) -> View:
    """A chaser in front of the goal of a port, facing it, so far out [m]."""
    index = port_index(port)
    goal = goal_poses()[index]
    position = goal[:3] + distance * np.array(PORTS[index].normal)
    parts = (position, np.zeros(3), goal[3:], np.zeros(3))
    return View(*(jnp.asarray(part, jnp.float32) for part in parts))


def drawn(scene: Scene, view: View, eye: Camera) -> np.ndarray:
    """A picture, red first."""
    return np.asarray(DRAW(scene, view, eye))


def save(path: Path, image: np.ndarray, quality: int = 90) -> None:
    """Write a JPEG."""
    cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    print(path, image.shape, f"{path.stat().st_size / 1024:.0f} KiB", flush=True)


def flight(port: str, seed: int) -> tuple[DockingEnv, Episode]:
    """A docking by the scripted policy that follows the way around the hull."""
    with jax.enable_x64(True):
        env = DockingEnv(fidelity="iss-hcw", ports=[port])
        keys = jax.random.split(jax.random.key(seed), 1)
        chunks = rollout(env, make_policy("dock-geodesic", env), keys, np.array([port_index(port)]))
        return env, next(iter(episodes(chunks)))


def film(path: Path, port: str, seed: int, side: int, count: int) -> None:
    """Write a docking as a GIF: from outside, and as the chaser sees it."""
    from PIL import Image

    env, episode = flight(port, seed)
    rows = np.linspace(0, len(episode), count).round().astype(int)
    views, epochs = episode.true_state[rows], episode.epoch[rows]
    size = {"height": side, "width": side, "samples": 2}
    both = zip(
        frames(views, epochs, camera("chaser_isometric", **size), env.config),
        frames(views, epochs, camera("chaser_fpv", **size), env.config),
    )
    images = [Image.fromarray(np.hstack(pair)) for pair in both]
    palette = Image.fromarray(np.vstack([np.asarray(image) for image in images[:: max(1, count // 8)]])).quantize(96)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    images[0].save(path, save_all=True, append_images=images[1:], duration=80, loop=0, optimize=True)
    print(path, len(images), f"frames of {len(episode)} decisions, {path.stat().st_size / 2**20:.2f} MiB", flush=True)


def main() -> None:
    """Draw everything into a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side", type=int, default=480)
    parser.add_argument("--samples", type=int, default=3)
    parser.add_argument("--days", type=float, default=2.0, help="after the reference epoch")
    parser.add_argument("--only", choices=["approach", "orbit", "film"])
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    wanted = {options.only} if options.only else {"approach", "orbit", "film"}
    minutes = np.arange(0.0, 93.0, 0.1)
    stands = orbit(options.days, minutes)
    sine = -np.einsum("ni,ni->n", np.asarray(stands.sun), np.asarray(stands.earth)) / 6.78e6
    setting, sunlight = np.gradient(sine) < 0, np.asarray(stands.sunlight)
    scene = default_scene(sky=load_sky())
    under = lambda index: scene._replace(heavens=jax.tree.map(lambda a: a[index], stands))
    side, samples = options.side, options.samples

    if "approach" in wanted:  # the Sun behind the chaser, some way up
        front = np.asarray(stands.sun) @ np.array([0.0, -1.0, 0.0])
        lit = under(int(np.argmax(np.where((sine > 0.3) & (sunlight > 0.99), front, -9.0))))
        eye = camera("chaser_fpv", height=side, width=side, samples=samples)
        panels = [drawn(lit, before("harmony_forward", away), eye) for away in (110.0, 40.0, 14.0, 2.0)]
        save(options.folder / "approach_fpv.jpg", np.hstack(panels))

    if "orbit" in wanted:
        moments = {
            "day": (int(np.argmax(sine)), 0.0),
            "dusk": (int(np.argmin(np.abs(sine - 0.10) + 9.0 * ~setting)), 0.5),
            "eclipse": (int(np.argmin(np.abs(sunlight - 0.5) + 9.0 * ~setting)), 1.5),
            "night": (int(np.argmin(np.abs(sine + 0.75) + 9.0 * ~setting)), 5.0),
        }
        pictures = []
        for name, (index, stops) in moments.items():
            up = np.degrees(np.arcsin(sine[index]))
            print(f"{name}: minute {minutes[index]:.1f}, the Sun {up:.1f} deg up, {sunlight[index]:.2f} of it in sight")
            eye = camera("station_isometric", height=side, width=side * 16 // 9, samples=samples, exposure=stops)
            pictures.append(drawn(under(index), before("harmony_forward", 25.0), eye))
        save(options.folder / "orbit.jpg", np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])]))

    if "film" in wanted:
        film(options.folder / "docking.gif", "harmony_forward", 3, 224, 90)


if __name__ == "__main__":
    main()
