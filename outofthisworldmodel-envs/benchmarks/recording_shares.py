"""What recording with a camera spends its time on: simulating, drawing, encoding; and how long a corpus takes.

python benchmarks/recording_shares.py                       # small-64
python benchmarks/recording_shares.py --recipe small-64 --episodes 32 --decisions 240

The same flights are flown without the camera and with it, and the frames of the latter are encoded; each alone. Then
episodes are recorded by `generate`, which encodes one chunk while it flies the next. Programs are compiled before
anything is timed. The last line is all figures as JSON.
"""

import argparse
import itertools
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from owm_envs.config import DockingConfig, load_config
from owm_envs.datasets.generate import generate
from owm_envs.datasets.pieces import Film
from owm_envs.datasets.recipe import Request, flights, load_recipe, splits
from owm_envs.env import DockingEnv
from owm_envs.policies import make_policy
from owm_envs.rollout import Chunk, rollout

CHUNK = 60
CORPUS = 500_000


def flown(config: DockingConfig, request: Request, decisions: int) -> Iterator[Chunk]:
    """Chunks of a batch of the recipe's train flights."""
    env, split = DockingEnv(config), splits(request, config)["train"]
    names = [name for name, share in split.policies.items() if share]
    batch = list(itertools.islice(flights(split), request.episodes_per_batch))
    chunks = rollout(
        env,
        [make_policy(name, env) for name in names],
        jax.random.split(jax.random.key(request.seed), len(batch)),
        np.array([flight.port for flight in batch]),
        which=np.array([names.index(flight.policy) for flight in batch]),
        chunk=CHUNK,
    )
    return itertools.islice(chunks, decisions // CHUNK)


def timed(chunks: Iterator[Chunk]) -> tuple[float, list[Chunk]]:
    """Seconds of all chunks but the first, which compiles; these chunks."""
    next(chunks)
    start = time.perf_counter()
    kept = list(chunks)
    return time.perf_counter() - start, kept


def encoded(chunks: list[Chunk], folder: Path, fps: float) -> tuple[float, int]:
    """Seconds that it takes to encode the chunks' frames, a film a slot; how many frames."""
    start, frames = time.perf_counter(), 0
    for slot in range(len(chunks[0].policy)):
        film = Film(folder / f"{slot}.mp4", fps)
        for chunk in chunks:
            film.write(chunk.frames.observation["pixels"][:, slot])
        frames += film.frames
        film.close()
    return time.perf_counter() - start, frames


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", default="small-64")
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("--decisions", type=int, default=300, help="of each episode, for the parts")
    options = parser.parse_args()
    values, environment = load_recipe(options.recipe)
    config = load_config(environment)
    request = Request(**{**values, "episodes_per_batch": options.episodes})
    blind = load_config({**environment, "observation": "state", "camera": {}})
    figures, console = {}, Console()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        simulating, _ = timed(flown(blind, request, options.decisions))
        both, chunks = timed(flown(config, request, options.decisions))
        encoding, frames = encoded(chunks, folder, 1 / config.decision_dt)
        del chunks
        few = Request(episodes=options.episodes, transitions=None, val_episodes=8, val_transitions=None)
        generate(folder / "warm", config, few)
        start = time.perf_counter()
        summary = generate(
            folder / "timed", config, Request(**{**vars(few), "seed": 1, "episodes": 2 * options.episodes})
        )
        seconds = time.perf_counter() - start
    rows = sum(split["transitions"] + split["episodes"] for split in summary.values())
    table = Table("what", "frames/s", "s a frame, of all apart")
    apart = {"simulating": simulating, "drawing": both - simulating, "encoding": encoding}
    for name, own in apart.items():
        figures[name] = frames / own
        table.add_row(name, f"{frames / own:,.0f}", f"{own / sum(apart.values()):.1%}")
    figures["recorded"], figures["minutes"] = rows / seconds, CORPUS / (rows / seconds) / 60
    table.add_row("recorded, all of it", f"{rows / seconds:,.0f}", "")
    console.print(table, f"{CORPUS:,} transitions of {options.recipe}: {figures['minutes']:.0f} minutes at that rate")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
