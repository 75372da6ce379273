"""Writes to a terminal, which takes no orders from the names and texts of files."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

# Characters that move the cursor, change colours or titles, or turn the direction of what follows:
# C0 and C1 controls but tab and line feed, and the marks of bidirectional text.
_ORDERS = (*range(0x09), *range(0x0B, 0x20), *range(0x7F, 0xA0), 0x061C, 0x200E, 0x200F,
           *range(0x2028, 0x202F), *range(0x2066, 0x206A), 0xFEFF)  # fmt: skip
_ESCAPES = {code: f"\\u{code:04x}" for code in _ORDERS}  # as JSON has them


def escape_controls(text: str) -> str:
    """Replaces control characters by their numbers, such as \\u001b."""
    return text.translate(_ESCAPES)


class TerminalStream:
    """A text stream that escapes control characters; progress bars may go back to a line's start.

    Args:
        stream: where it is written.
        lenient: drops what cannot be written, as on a full disk, except that nobody reads it.

    Attributes:
        failed: whether something was dropped.
    """

    def __init__(self, stream: Any, lenient: bool = False) -> None:
        self.stream, self._lenient = stream, lenient
        self.failed = False

    def write(self, text: str) -> int:
        words = text.lstrip("\r")
        self._try(self.stream.write, text[: len(text) - len(words)] + escape_controls(words))
        return len(text)

    def flush(self) -> None:
        self._try(self.stream.flush)

    def _try(self, write: Any, *text: str) -> None:
        if self.failed:
            return
        try:
            write(*text)
        except OSError as error:
            self.failed = self._lenient
            if not self._lenient or isinstance(error, BrokenPipeError):
                raise

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def say(text: str, before: str = "") -> None:
    """Prints a message as one line on standard error, which nobody may read any more."""
    with contextlib.suppress(OSError):
        print(f"{before}gsut: {' '.join(text.splitlines())}", file=sys.stderr, flush=True)
