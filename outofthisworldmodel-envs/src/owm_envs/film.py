"""Recorded flights as films and contact sheets: the camera, from where a flight went, under the heavens of its time."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, UInt8

from owm_envs.camera.lens import Camera
from owm_envs.camera.light import Heavens, heavens
from owm_envs.camera.render import render
from owm_envs.camera.scene import default_scene
from owm_envs.camera.sky import load_sky
from owm_envs.camera.views import camera
from owm_envs.config import DockingConfig
from owm_envs.config.params import params_from_config
from owm_envs.datasets.reader import open_dataset, read_config
from owm_envs.dynamics.chief import kepler_orbit
from owm_envs.dynamics.state import PhysicalState
from owm_envs.episode import Episode
from owm_envs.files import write_atomically
from owm_envs.flags import own_flags
from owm_envs.station.ports import PORT_NAMES
from owm_envs.video import mp4, require_av, save_film
from owm_envs.view import View

_AT_ONCE = 8  # frames a call: progress is told between, and no more are in memory
_SHEET = 12


def frames(
    views: Float[np.ndarray, "T 13"], epochs: Float[np.ndarray, "T 2"], lens: Camera, config: DockingConfig
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """Draw what a camera sees along a flight, a few frames at a time.

    The light is that of the configured Kepler orbit from the first epoch on, whatever flew the station.

    Args:
        views: true relative views.
        epochs: [MJD day, s of day] UTC of each.
        lens: as `owm_envs.camera.views.camera` makes it.
        config: of the environment: the station's orbit.
    """
    with own_flags():
        params, scene = params_from_config(config), default_scene(sky=load_sky())
    views, epochs = (np.asarray(rows, config.precision) for rows in (views, epochs))
    for first in range(0, len(views), _AT_ONCE):
        rows = np.minimum(np.arange(first, first + _AT_ONCE), len(views) - 1)
        with own_flags():
            images = np.asarray(_shoot(params, scene, lens, epochs[0], views[rows], epochs[rows]))
        yield from images[: len(views) - first]


@jax.jit
def _shoot(params, scene, lens, start, views, epochs):
    def one(row):
        view, epoch = row
        return render(scene._replace(heavens=_above(params, start, epoch)), View.of(view), lens)["rgb"]

    return jax.lax.map(one, (views, epochs))


def _above(params, start, epoch):
    elapsed = (epoch[0] - start[0]) * 86_400.0 + (epoch[1] - start[1])
    orbit = kepler_orbit(params, PhysicalState(start, elapsed, epoch[:0], None))
    return heavens(epoch, orbit[:3], orbit[3:])


def skies(epochs: Float[np.ndarray, "T 2"], config: DockingConfig) -> Heavens:
    """Where Sun, Moon and Earth stood along a flight, under which `frames` draws; NumPy arrays, leading axis T.

    Args:
        epochs: [MJD day, s of day] UTC of each instant.
        config: of the environment: the station's orbit.
    """
    epochs = np.asarray(epochs, config.precision)
    with own_flags():
        params = params_from_config(config)
        return jax.device_get(jax.jit(jax.vmap(_above, (None, None, 0)))(params, epochs[0], epochs))


def film_camera(path: str | Path, name: str, size: int, port: str) -> Camera:
    """Give the camera of a film to be saved as `path`, once nothing stands in its way; raises as `save_film`."""
    require_av()
    mp4(path)
    return camera(name, height=size, width=size, port=port)


def contact_sheet(images: Sequence[UInt8[np.ndarray, "H W 3"]], columns: int = 4) -> UInt8[np.ndarray, "R C 3"]:
    """Lay pictures of one size out row by row; places without one are black."""
    blank = np.zeros_like(images[0])
    rows = [[*images[i : i + columns]] for i in range(0, len(images), columns)]
    rows = [row + [blank] * (min(columns, len(images)) - len(row)) for row in rows]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def film_run(
    run: str | Path,
    out: str | Path,
    *,
    split: str | None = None,
    episodes: Sequence[int] = (),
    name: str = "chaser_fpv",
    size: int = 256,
    fps: float = 20.0,
    speed: float = 10.0,
    sheet: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Path]:
    """Film episodes of a dataset.

    Args:
        run: folder of the dataset, or of its splits.
        out: folder for the films, one an episode.
        split: of the dataset; not needed if it has but one.
        episodes: their numbers; the first when empty.
        name: of the camera.
        size: rows and columns of a picture.
        fps: frames a second of the film.
        speed: seconds of flight in a second of film.
        sheet: make contact sheets (PNG) of a dozen pictures in place of films.
        progress: told of how many frames are done.

    Returns:
        The files.

    Raises:
        ImportError: PyAV is missing, and films are asked for.
        FileNotFoundError, ValueError: no such dataset, split, episode or camera, or a number out of range.
    """
    if not (fps > 0 and speed > 0):
        raise ValueError(f"fps and speed must be above 0, got {fps} and {speed}")
    if not sheet:
        require_av()
    flights, out = open_dataset(run, split), Path(out)
    folder = flights.folder
    lens_of = [camera(name, height=size, width=size, port=port) for port in PORT_NAMES]
    chosen = list(episodes) or [0]
    for number in chosen:
        if not 0 <= number < len(flights):
            raise ValueError(f"episodes must be from 0 to {len(flights) - 1}, got {number}")
    config = read_config(folder)
    moments = {number: _moments(flights[number], speed / fps, sheet) for number in chosen}
    total, done = sum(map(len, moments.values())), 0
    out.mkdir(parents=True, exist_ok=True)
    files = []
    for number, rows in moments.items():
        flight = flights[number]

        def told(images: Iterator[np.ndarray], before: int = done) -> Iterator[np.ndarray]:
            for count, image in enumerate(images, 1):
                progress(before + count, total)
                yield image

        shot = told(frames(flight.true_state[rows], flight.epoch[rows], lens_of[flight.port], config))
        path = out / f"{folder.name}-{number:04d}-{name}.{'png' if sheet else 'mp4'}"
        if sheet:
            save_picture(path, contact_sheet(list(shot)))
        else:
            save_film(path, shot, fps)
        done += len(rows)
        files.append(path)
    return files


def save_picture(path: Path, image: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write a picture as PNG."""
    import cv2

    data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
    write_atomically(path, lambda file: file.write(data))


def _moments(flight: Episode, apart: float, sheet: bool) -> np.ndarray:
    """Rows of a flight that are so many seconds apart, or a dozen of them spread evenly."""
    seconds = (flight.epoch - flight.epoch[0]) @ np.array([86_400.0, 1.0])
    wanted = np.linspace(0, seconds[-1], _SHEET) if sheet else np.arange(0, seconds[-1] + apart, apart)
    return np.minimum(np.searchsorted(seconds, wanted - 1e-6), len(seconds) - 1)
