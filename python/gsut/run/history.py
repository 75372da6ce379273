"""The history of a run: a file of one JSON object a line, written row by row."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from gsut.files import (
    FileError,
    append_text,
    parse_json,
    read_bytes,
    register_reader,
    to_plain,
    write_file,
)


class History:
    """The rows of a run, in the order of their steps.

    Args:
        path: of history.jsonl; without it there are no rows.
        stays: nothing is written.
    """

    def __init__(self, path: Path, stays: bool) -> None:
        self._path, self._stays = path, stays

    def append(self, row: dict[str, Any]) -> None:
        """Adds one line; `row` holds at least `step`."""
        if self._stays:
            return
        append_text(self._path, json.dumps(to_plain(row)) + "\n")

    def read(self) -> list[dict[str, Any]]:
        """Reads all complete rows; a line torn by a crash is left out."""
        return read_history(self._path) if self._path.is_file() else []

    def roll_back(self, step: int) -> None:
        """Drops the rows that come after `step`."""
        if self._path.is_file() and not self._stays:
            rows = (json.dumps(row) for row in self.read() if row["step"] <= step)
            write_file(self._path, "".join(row + "\n" for row in rows))


@register_reader("history of a run", ".jsonl")
def read_history(path: Path) -> list[dict[str, Any]]:
    """Reads all complete rows, see `History.read`."""
    rows = []
    for line in read_bytes(path).splitlines():
        with contextlib.suppress(FileError):
            rows.append(parse_json(line, path, {"step": int}))
    return rows
