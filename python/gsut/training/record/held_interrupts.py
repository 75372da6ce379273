"""Holds Ctrl-C back while a training step is made, so that no state is left half changed."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


class HeldInterrupts:
    """Lets the first Ctrl-C wait for the end of a step; a second one raises at once."""

    def __init__(self) -> None:
        self._holds, self._came = False, False

    @contextlib.contextmanager
    def hold(self) -> Iterator[None]:
        """Holds Ctrl-C back during the block, where it would raise KeyboardInterrupt."""
        raises = (
            threading.current_thread() is threading.main_thread()
            and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        )
        self._holds = True
        if raises:
            signal.signal(signal.SIGINT, self._handle_signal)
        try:
            yield
        finally:
            if raises:
                signal.signal(signal.SIGINT, signal.default_int_handler)

    @contextlib.contextmanager
    def release(self) -> Iterator[None]:
        """Raises KeyboardInterrupt if Ctrl-C came, and as soon as it comes during the block."""
        self._holds = False
        if self._came:
            raise KeyboardInterrupt
        yield
        self._holds = True

    def _handle_signal(self, number: int, frame: Any) -> None:
        if self._came or not self._holds:
            signal.default_int_handler(number, frame)
        self._came = True
