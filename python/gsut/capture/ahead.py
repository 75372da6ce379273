"""Does the work of a film's frames beside each other, and returns the results in their order."""

from __future__ import annotations

import collections
import concurrent.futures
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from gsut._core import num_threads

_Result = TypeVar("_Result")


class WorkAhead(Generic[_Result]):
    """Work that a pool of threads does, of which few results wait to be taken.

    Args:
        pool: may be shared by several; no work in it waits for other work.
    """

    def __init__(self, pool: concurrent.futures.Executor) -> None:
        self._pool = pool
        self._most = 2 * num_threads()  # pictures that wait take memory
        self._begun: collections.deque[concurrent.futures.Future[_Result]] = collections.deque()

    def submit(self, work: Callable[..., _Result], *arguments: Any) -> None:
        """Starts `work(*arguments)`."""
        self._begun.append(self._pool.submit(work, *arguments))

    def take_due(self) -> Iterator[_Result]:
        """Yields the first results as long as too many wait."""
        while len(self._begun) > self._most:
            yield self._begun.popleft().result()

    def take_all(self) -> Iterator[_Result]:
        """Yields all results that were not taken."""
        while self._begun:
            yield self._begun.popleft().result()


def make_pool() -> concurrent.futures.ThreadPoolExecutor:
    """Makes threads for all cores but that of the caller, which decodes."""
    return concurrent.futures.ThreadPoolExecutor(max(1, num_threads() - 1))
