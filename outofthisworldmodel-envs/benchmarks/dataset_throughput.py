"""How quickly episodes become a dataset: ours, and LeRobot's own writer on the same frames where it is installed.

python benchmarks/dataset_throughput.py                   # vectors, 64x64 and 512x512
python benchmarks/dataset_throughput.py --sides 64

Frames are made once, by the camera along an approach, and repeated. Encoding and writing alone are timed, in turns. The
last line is all figures as JSON.
"""

import argparse
import json
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from owm_envs.camera.views import camera
from owm_envs.config import load_config
from owm_envs.datasets.pieces import Film, Pieces
from owm_envs.datasets.writer import write_meta, write_split
from owm_envs.episode import Episode
from owm_envs.film import frames
from owm_envs.station import goal_poses

FPS = 20


class Part:
    """Shape and dtype of a part of the observation."""

    def __init__(self, side: int):
        self.shape, self.dtype = (side, side, 3), "uint8"


def made_up(rng: np.random.Generator, length: int) -> Episode:
    """An episode of random numbers."""
    last = np.arange(length) == length - 1
    seconds = 1000.0 + np.arange(length + 1) / FPS
    return Episode(
        observation={"state": rng.normal(size=(length + 1, 13)).astype(np.float32)},
        true_state=rng.normal(size=(length + 1, 13)),
        epoch=np.stack([np.full(length + 1, 61_253.0), seconds], axis=1),
        action=rng.normal(size=(length, 6)).astype(np.float32),
        reward=rng.normal(size=length).astype(np.float32),
        done=last,
        success=last,
        port=3,
        goal_pose=goal_poses()[3],
        policy=2,
        outcome=1,
    )


def approach(side: int, count: int) -> np.ndarray:
    """Frames of the nose camera on its way in to the first port."""
    goal = goal_poses()[0]
    views = np.zeros((count, 13))
    views[:, :3] = goal[:3] + np.linspace(60.0, 5.0, count)[:, None] * np.array([0.0, -1.0, 0.0])
    views[:, 6:10] = goal[3:]
    epochs = np.stack([np.full(count, 61_253.0), 40_000.0 + np.arange(count) / FPS], axis=1)
    eye = camera("chaser_fpv", height=side, width=side)
    return np.stack(list(frames(views, epochs, eye, load_config(fidelity="iss"))))


def ours(folder: Path, episode: Episode, images: np.ndarray | None, count: int) -> tuple[float, int]:
    """Frames a second, and bytes a frame."""
    parts = {} if images is None else {"pixels": Part(images.shape[1])}
    start = time.perf_counter()
    pieces = Pieces(folder / "pieces")
    for number in range(count):
        seen = dict(episode.observation)
        if images is not None:
            film = Film(folder / "film.mp4", FPS)
            film.write(images)
            seen["pixels"] = film.close()
        pieces.put(number, Episode(**{**vars(episode), "observation": seen}), FPS)
    split = write_split(folder / "set", pieces, range(count), FPS, parts)
    write_meta(folder / "set", split, split.statistics, FPS, parts)
    seconds = time.perf_counter() - start
    size = sum(file.stat().st_size for file in (folder / "set").rglob("*") if file.is_file())
    return split.frames / seconds, size // split.frames


def theirs(folder: Path, episode: Episode, images: np.ndarray | None, count: int) -> tuple[float, int]:
    """The same of LeRobot's writer, with its own settings."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    columns = {
        "observation.state": episode.observation["state"],
        "observation.environment_state": episode.true_state.astype(np.float32),
        "action": np.concatenate([episode.action, np.zeros((1, 6), np.float32)]),
    }
    features = {
        name: {"dtype": "float32", "shape": values.shape[1:], "names": None} for name, values in columns.items()
    }
    if images is not None:
        shape = images.shape[1:]
        features["observation.images.fpv"] = {
            "dtype": "video",
            "shape": shape,
            "names": ["height", "width", "channels"],
        }
    start = time.perf_counter()
    dataset = LeRobotDataset.create("local/benchmark", FPS, features, root=folder / "theirs", use_videos=True)
    rows = len(episode) + 1
    for _ in range(count):
        for row in range(rows):
            frame = {name: values[row] for name, values in columns.items()}
            if images is not None:
                frame["observation.images.fpv"] = images[row]
            dataset.add_frame({**frame, "task": "Dock."})
        dataset.save_episode()
    if hasattr(dataset, "finalize"):
        dataset.finalize()
    seconds = time.perf_counter() - start
    size = sum(file.stat().st_size for file in (folder / "theirs").rglob("*") if file.is_file())
    return count * rows / seconds, size // (count * rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="*", default=[0, 64, 512], help="of frames; 0 is vectors alone")
    options = parser.parse_args()
    rng, console, figures = np.random.default_rng(0), Console(), {}
    table = Table("frames", "ours, frames/s", "B a frame", "LeRobot's writer", "B a frame", "ratio")
    # Decisions an episode, and episodes: of ours enough for a second or so, of theirs what a minute allows.
    sizes = {0: (7200, 40, 1), 64: (720, 20, 2), 512: (120, 6, 1)}
    for side in options.sides:
        length, count, their_count = sizes[side]
        images = approach(side, length + 1) if side else None
        episode = made_up(rng, length)
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "warm").mkdir()
            ours(Path(folder, "warm"), made_up(rng, 9), None if images is None else images[:10], 1)
            rate, size = ours(Path(folder), episode, images, count)
            row = {"ours": rate, "ours_bytes": size}
            if find_spec("lerobot"):
                row["lerobot"], row["lerobot_bytes"] = theirs(Path(folder), episode, images, their_count)
        figures[f"{side}"] = row
        told = "---"
        if "lerobot" in row:
            told = [f"{row['lerobot']:,.0f}", f"{row['lerobot_bytes']:,}", f"{rate / row['lerobot']:.1f}"]
        table.add_row(f"{side}x{side}" if side else "vectors", f"{rate:,.0f}", f"{size:,}", *told)
    console.print(table)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
