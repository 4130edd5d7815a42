"""Rows of a matrix flown in processes side by side, each on cores of its own.

On a CPU that is faster than one process on all cores: a program's short loops gain little from a second core.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

from owm_envs.cores import core_shares, settings, settle


def fly_side_by_side(
    stores: Sequence, slots: int, processes: int, report: Callable[[int, str, str], None], poll: float = 1.0
) -> None:
    """Fly what stores miss, a row to a process at a time.

    Args:
        stores: of rows with flights missing.
        slots: most flights side by side in each process.
        processes: how many; each is held to its share of the cores, if there are enough.
        report: called with the flights of these rows that are missing, which row, and how far.
        poll: seconds between reports.

    Raises:
        RuntimeError: a process has died. What had landed is kept.
    """
    context = multiprocessing.get_context("spawn")
    with _left_alone():
        shares = context.SimpleQueue()
    for share in core_shares(processes):
        shares.put(share)
    began, at_first = time.monotonic(), missing_flights(stores)
    with ProcessPoolExecutor(processes, context, _settle, (shares, settings())) as pool:
        with _left_alone():
            flying = {pool.submit(_fly, store, slots) for store in stores}
        try:
            while flying:
                ended, flying = wait(flying, timeout=poll, return_when=FIRST_COMPLETED)
                for future in ended:
                    future.result()
                missing = missing_flights(stores)
                landed = at_first - missing
                seconds = missing * (time.monotonic() - began) / landed if landed else None
                left = "compiling" if seconds is None else f"about {spell(seconds)} left"
                report(missing, f"{len(stores) - len(flying)}/{len(stores)} rows, {processes} processes", left)
        except BrokenProcessPool:
            raise RuntimeError(
                "a process that flew has died, of memory perhaps; what has landed is kept: run it again"
            ) from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)  # those that fly end their row


@contextlib.contextmanager
def _left_alone() -> Iterator[None]:
    """Begin processes that leave Ctrl-C to this one, and do not complain of what it leaves when it ends."""
    before = os.environ.get("PYTHONWARNINGS")
    quiet = "ignore::UserWarning:multiprocessing.resource_tracker"
    os.environ["PYTHONWARNINGS"] = f"{before},{quiet}" if before else quiet
    if os.name != "nt":
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited
    try:
        yield
    finally:
        if os.name != "nt":
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before


def missing_flights(stores: Sequence) -> int:
    """Flights that have not landed, by what the processes that fly have noted so far."""
    for store in stores:
        store.claim.look()
    return sum(store.row.flights * len(store.missing()) for store in stores)


def spell(seconds: float) -> str:
    """A time as people say it."""
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"


def _settle(shares, taken_over: dict) -> None:
    """Hold a new process to its cores, and to the life of the one that watches it."""
    settle(shares.get(), taken_over)

    def follow():
        multiprocessing.parent_process().join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _fly(store, slots: int) -> None:
    for port in store.missing():
        store.fly(port, slots, lambda *_: None)
