"""What is made of pictures and kept, up to a number of bytes."""

from __future__ import annotations

import collections
import threading
from collections.abc import Callable

import numpy as np


class LruCache:
    """Tuples of arrays by key, the least recently used dropped beyond a number of bytes.

    Safe to use from many threads.
    """

    def __init__(self, limit_bytes: float) -> None:
        self.limit_bytes = limit_bytes
        self._items: collections.OrderedDict = collections.OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def __contains__(self, key: object) -> bool:
        return key in self._items

    def get(self, key: object, make: Callable[[], tuple]) -> tuple:
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key]
        value = make()  # outside the lock: two threads may make the same, with equal result
        for array in value:
            if isinstance(array, np.ndarray):
                array.setflags(write=False)
        with self._lock:
            if key not in self._items:
                self._items[key] = value
                self._bytes += _count_bytes(value)
                self._drop_oldest()
            return self._items.get(key, value)

    def limit(self, limit_bytes: float) -> None:
        """Sets the number of bytes that may be kept, and drops what exceeds it."""
        with self._lock:
            self.limit_bytes = limit_bytes
            self._drop_oldest()

    def _drop_oldest(self) -> None:
        while self._bytes > self.limit_bytes and len(self._items) > 1:
            self._bytes -= _count_bytes(self._items.popitem(last=False)[1])


def _count_bytes(arrays: tuple) -> int:  # of anything that has nbytes
    return sum(array.nbytes for array in arrays if array is not None)
