"""How many windows a step may have: found from what compiled steps say they need, before any is run."""

from collections.abc import Callable
from typing import Any

import jax

LARGEST = 65_536
"""Most windows that are tried."""


def memory_budget(memory_gb: float | None, device: Any = None) -> int:
    """Return the bytes a step may take: those stated, or nine tenths of what the device has.

    Raises:
        ValueError: nothing is stated and the device does not tell.
    """
    if memory_gb is not None:
        return int(memory_gb * 1e9)
    device = jax.local_devices()[0] if device is None else device
    limit = (device.memory_stats() or {}).get("bytes_limit")
    if not limit:
        raise ValueError(f'memory_gb must be given for batch="auto": {device} does not tell its memory')
    return int(0.9 * limit)


def compiled_bytes(compiled: Any) -> int:
    """Return the bytes that a compiled program needs on each device while it runs: arguments, results, temporaries."""
    memory = compiled.memory_analysis()
    shared = memory.alias_size_in_bytes
    return memory.argument_size_in_bytes + memory.output_size_in_bytes + memory.temp_size_in_bytes - shared


def largest_batch(needs: Callable[[int], int], budget: int, smallest: int = 1, largest: int = LARGEST) -> int:
    """Return the largest power-of-two multiple of `smallest` that needs at most `budget` bytes.

    What a step needs grows about linearly with its batch, so two compilations tell where the limit lies; the size
    they point to is compiled too, and the next ones until the answer is sure.

    Args:
        needs: bytes that a step of so many windows needs; each call compiles one.
        budget: bytes.
        smallest: least batch, such as the number of devices.
        largest: most windows to try.

    Raises:
        ValueError: not even `smallest` fits.
    """
    known: dict[int, int] = {}

    def fits(batch: int) -> bool:
        if batch not in known:
            known[batch] = needs(batch)
        return known[batch] <= budget

    if not fits(smallest):
        raise ValueError(
            f"memory_gb must be at least {known[smallest] / 1e9:.3g} for a batch of {smallest}, got {budget / 1e9:.3g}"
        )
    probe = smallest * 8
    if not fits(probe):
        batch = probe // 2
    else:
        slope = max((known[probe] - known[smallest]) / (probe - smallest), 1e-9)
        room, batch = (budget - known[smallest]) / slope + smallest, probe
        while 2 * batch <= min(room, largest):
            batch *= 2
    while not fits(batch):
        batch //= 2
    while 2 * batch <= largest and fits(2 * batch):
        batch *= 2
    return batch
