"""Batches of windows for PyTorch: `python examples/load_torch.py runs/dataset`.

`Windows` has a length and items, which is all that a `DataLoader` asks for. Arrays become tensors, uint8 frames too.
Each worker opens the files by itself. Numbers are normalised by the statistics that came with the dataset.

Needs torch (`pip install torch`), and for a dataset with videos PyAV (`pip install av`).
"""

import argparse
import time

import torch
from torch.utils.data import DataLoader

from owm_envs import datasets


def main() -> None:
    """Go through a number of batches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", help="folder or name of a dataset, ours or any of LeRobot's")
    parser.add_argument("--split", default="train")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--batches", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()

    dataset = datasets.open(options.dataset, options.split)
    windows = dataset.windows(context=8, rollout=16, stride=5)
    # Processes of their own, not copies of this one: JAX and others hold threads that a copy has not.
    how = {"multiprocessing_context": "spawn", "persistent_workers": True} if options.workers else {}
    order = torch.Generator().manual_seed(0)
    loader = DataLoader(windows, options.batch, shuffle=True, generator=order, num_workers=options.workers, **how)
    statistics = dataset.statistics["action"]
    mean, deviation = (torch.as_tensor(statistics[key], dtype=torch.float32) for key in ("mean", "std"))

    print(f"{len(dataset)} episodes, {len(windows):,} windows")
    began, count = time.perf_counter(), 0
    for batch in loader:
        action = (batch["action"] - mean) / deviation.clamp(min=1e-6)
        if count == 0:
            for name, values in batch.items():
                print(f"{name}: {tuple(values.shape)} {values.dtype}")
            began = time.perf_counter()  # workers have started
        count += 1
        if count == options.batches:
            break
    rate = (count - 1) * options.batch / max(time.perf_counter() - began, 1e-9)
    print(f"{count} batches, {rate:,.0f} windows a second; actions {action.mean():.3f} on the mean, {action.std():.3f}")


if __name__ == "__main__":
    main()
