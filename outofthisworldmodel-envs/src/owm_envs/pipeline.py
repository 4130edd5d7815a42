"""Work that is done one step ahead of its reader."""

import queue
import threading
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from typing import TypeVar

Item = TypeVar("Item")
_POLL = 0.1  # s between looks whether a thread that was told to stop has stopped


def ahead(items: Iterable[Item], size: int = 1) -> Iterator[Item]:
    """Read items in a thread of its own, before they are asked for.

    The thread waits while `size` items lie ready: none is dropped, and no more are held than these, the one being made
    and the one in use. What goes wrong in the thread is raised here. Closing this stops the thread at its next item.
    """
    ready: queue.Queue[tuple[bool, object]] = queue.Queue(size)
    over = threading.Event()

    def work() -> None:
        try:
            for item in items:
                ready.put((True, item))
                del item
                if over.is_set():
                    break
            ending: object = None
        except BaseException as error:
            ending = error
        if isinstance(items, Generator):
            items.close()
        ready.put((False, ending))

    thread = threading.Thread(target=work, name="ahead", daemon=True)
    thread.start()
    try:
        while True:
            going, item = ready.get()
            if not going:
                if item is not None:
                    raise item
                return
            yield item
            del item
    finally:
        over.set()
        while thread.is_alive():
            with suppress(queue.Empty):
                ready.get(timeout=_POLL)
