"""The things used last, up to a number of bytes."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import Any


class Cache:
    """Keep values by key; those not used for longest go first. Copies for other processes begin empty.

    Args:
        limit: bytes of all values together; a value larger than that is not kept.
    """

    def __init__(self, limit: int):
        self.limit = limit
        self.bytes = 0
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()

    def get(self, key: Hashable) -> Any | None:
        """The value of a key, or None."""
        if key not in self._kept:
            return None
        self._kept.move_to_end(key)
        return self._kept[key][0]

    def put(self, key: Hashable, value: Any, size: int) -> None:
        """Keep a value of so many bytes, if there is room for it at all."""
        if key in self._kept:
            self.bytes -= self._kept.pop(key)[1]
        if size > self.limit:
            return
        self._kept[key] = value, size
        self.bytes += size
        while self.bytes > self.limit:
            self.bytes -= self._kept.popitem(last=False)[1][1]

    def __getstate__(self) -> dict[str, int]:
        return {"limit": self.limit}

    def __setstate__(self, state: dict[str, int]) -> None:
        self.__init__(state["limit"])
