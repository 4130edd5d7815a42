"""What is shown of a recorded flight, on the page and in Rerun alike."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from owm_envs.config import DockingConfig
from owm_envs.datasets.reader import dataset_folder, read_config, read_episode, read_info
from owm_envs.episode import Episode
from owm_envs.station import PORT_NAMES, hull_boxes
from owm_envs.station.boxes import distance_to
from owm_envs.view import View

_SECONDS = np.array([86_400.0, 1.0])
_KNOWN = (33_282.0, 69_807.0)  # MJD of 1950 and 2050, between which the ephemerides hold


class Curve(NamedTuple):
    """A quantity against time: a name for each of its lines, which are keys of `Recording.columns`."""

    label: str
    unit: str
    lines: tuple[str, ...]
    log: bool = False


CURVES: tuple[Curve, ...] = (
    Curve("distance to goal", "m", ("distance",), log=True),
    Curve("speed", "m/s", ("speed",)),
    Curve("attitude error", "deg", ("attitude",)),
    Curve("body rate", "deg/s", ("rate",)),
    Curve("force, body axes", "N", ("force_x", "force_y", "force_z")),
    Curve("torque, body axes", "N m", ("torque_x", "torque_y", "torque_z")),
)
HELD: tuple[str, ...] = CURVES[4].lines + CURVES[5].lines
"""Columns that keep a value from one instant to the next."""


class Pictures(NamedTuple):
    """What the chaser's camera saw."""

    rows: Int[np.ndarray, "N"]
    """Instants from which on each is shown, ascending."""
    images: np.ndarray
    """(N, H, W, 3) uint8."""
    caption: str


@dataclass(frozen=True, eq=False)
class Recording:
    """A flight of T decisions, ready to be shown."""

    title: str
    episode: Episode
    config: DockingConfig
    """Of the environment that it was flown in."""
    times: Float[np.ndarray, "T+1"]
    """s since the first instant."""
    policy: str
    """Who flew."""
    pictures: Pictures | None = None

    @property
    def columns(self) -> dict[str, Float[np.ndarray, "T+1"]]:
        """The lines of `CURVES` by name; of the last instant, which starts no decision, force and torque are zero."""
        seen, goal = View.of(self.episode.true_state), self.episode.goal_pose
        cosine = np.abs(seen.attitude @ goal[3:]) / np.linalg.norm(seen.attitude, axis=1)
        errors = {
            "distance": np.linalg.norm(seen.position - goal[:3], axis=1),
            "speed": np.linalg.norm(seen.velocity, axis=1),
            "attitude": np.degrees(2 * np.arccos(np.clip(cosine, 0, 1))),
            "rate": np.degrees(np.linalg.norm(seen.rate, axis=1)),
        }
        return errors | dict(zip(HELD, np.pad(self.episode.action, ((0, 1), (0, 0))).T))

    @property
    def boxes(self) -> Float[np.ndarray, "N 2 3"]:
        """Lower and upper corners of all that must not be touched, m."""
        return np.array([*(hull_boxes() if self.config.hull == "iss" else self.config.hull), *self.config.obstacles])

    @property
    def clearance(self) -> float:
        """Least distance of the chaser's bounding sphere to the boxes, m; at or below zero on contact."""
        return float(distance_to(self.boxes, self.episode.true_state[:, :3]).min() - self.config.chaser.radius)

    @property
    def delta_v(self) -> float:
        """The integral of the commanded force over the mass, m/s."""
        force = np.linalg.norm(np.nan_to_num(self.episode.action[:, :3]), axis=1)  # an invalid action commands nothing
        return float(force @ np.diff(self.times) / self.config.chaser.mass)

    @property
    def dated(self) -> bool:
        """Whether it is known when it was flown, and so where Sun and Earth stood."""
        return _KNOWN[0] < self.episode.epoch[0, 0] < _KNOWN[1]


def load(run: str | Path, split: str | None = None, number: int = 0, title: str | None = None) -> Recording:
    """Read one episode of a dataset, with the frames that were recorded with it.

    Args:
        run: folder of a dataset, or what `owm fly` wrote.
        split: of the dataset; val by default where there is one.
        number: of the episode, from 0.
        title: what to call it.

    Raises:
        FileNotFoundError, ValueError: no such dataset or split, or a number out of range.
    """
    run = Path(run)
    if split is None and (run / "val" / "meta" / "info.json").is_file():
        split = "val"
    folder = dataset_folder(run, split)
    episode = read_episode(folder, None, number)
    info = read_info(folder)
    policy = info.get("policy", episode.policy_name)
    title = title or f"{policy} to {PORT_NAMES[episode.port]}, episode {number} of {run.resolve().name}".replace(
        "_", " "
    )
    return recorded(title, episode, read_config(folder), info.get("fps"), policy)


def recorded(
    title: str, episode: Episode, config: DockingConfig, fps: float | None = None, policy: str | None = None
) -> Recording:
    """Make ready an episode that is at hand, with the frames that it observed.

    Args:
        title: what to call it.
        config: of the environment.
        fps: instants a second where the epochs do not tell; those of `config` when None.
        policy: who flew; as the episode says when None.
    """
    times = (episode.epoch - episode.epoch[0]) @ _SECONDS
    if not (np.diff(times) > 0).all():
        times = np.arange(len(episode) + 1) / (fps or 1 / config.decision_dt)
    return Recording(title, episode, config, times, policy or episode.policy_name, _pictures(episode))


def _pictures(episode: Episode) -> Pictures | None:
    """The recorded frames, each once: a camera that was not due repeats its last one."""
    frames = episode.observation.get("pixels")
    if frames is None or frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[-1] not in (1, 3):
        return None
    fresh = [0, *(row for row in range(1, len(frames)) if not np.array_equal(frames[row], frames[row - 1]))]
    images = np.broadcast_to(frames[fresh], (len(fresh), *frames.shape[1:3], 3))
    return Pictures(np.array(fresh), images, "what the chaser's camera recorded")


def film(
    recording: Recording, size: int = 256, fps: float = 2.0, progress: Callable[[int, int], None] = lambda *_: None
) -> Pictures:
    """Draw what the nose camera would have seen.

    Args:
        size: rows and columns of a picture.
        fps: pictures a second of flight.
        progress: told of how many are done.

    Raises:
        ValueError: no size, or no pictures a second.
    """
    from owm_envs.camera.views import camera
    from owm_envs.film import frames

    if not fps > 0:
        raise ValueError(f"fps must be above 0, got {fps}")
    lens = camera("chaser_fpv", height=size, width=size)
    times, episode = recording.times, recording.episode
    rows = np.unique(np.searchsorted(times, np.arange(0, times[-1] + 1e-6, 1 / fps) - 1e-6))
    images = []
    for image in frames(episode.true_state[rows], episode.epoch[rows], lens, recording.config):
        images.append(image)
        progress(len(images), len(rows))
    return Pictures(rows, np.stack(images), f"nose camera, drawn {fps:g} times a second")
