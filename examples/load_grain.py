"""Batches of windows for JAX, by Grain: `python examples/load_grain.py runs/dataset`.

`Windows` is a source of random access as it is. The pipeline shuffles, repeats, normalises and batches; where it is can
be saved and taken up again, so that a training run that was killed sees no window twice.

Needs Grain (`pip install grain`), and for a dataset with videos PyAV (`pip install av`).
"""

import argparse
import time

import grain
import numpy as np

from owm_envs import datasets


def pipeline(dataset: datasets.Dataset, batch: int, seed: int = 0) -> grain.IterDataset:
    """An endless stream of shuffled batches; actions are normalised by the dataset's statistics."""
    statistics = dataset.statistics["action"]
    mean, deviation = (np.asarray(statistics[key], np.float32) for key in ("mean", "std"))

    def normalised(window: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return window | {"action": (window["action"] - mean) / np.maximum(deviation, 1e-6)}

    windows = dataset.windows(context=8, rollout=16, stride=5)
    shuffled = grain.MapDataset.source(windows).shuffle(seed=seed).map(normalised).repeat()
    return shuffled.batch(batch).to_iter_dataset()


def main() -> None:
    """Go through a number of batches, and once back."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", help="folder or name of a dataset, ours or any of LeRobot's")
    parser.add_argument("--split", default="train")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--batches", type=int, default=50)
    options = parser.parse_args()

    stream = iter(pipeline(datasets.open(options.dataset, options.split), options.batch))
    for name, values in next(stream).items():
        print(f"{name}: {values.shape} {values.dtype}")
    began = time.perf_counter()
    for _ in range(options.batches):
        here, batch = stream.get_state(), next(stream)
    rate = options.batches * options.batch / (time.perf_counter() - began)
    stream.set_state(here)
    again = all(np.array_equal(values, batch[name]) for name, values in next(stream).items())
    print(f"{options.batches} batches, {rate:,.0f} windows a second")
    print("taken up again: " + ("the same" if again else "another"))


if __name__ == "__main__":
    main()
