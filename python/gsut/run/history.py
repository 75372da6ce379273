"""The history of a run: a file of one JSON object a line, written row by row."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from gsut.files import FileError, append_text, parse_json, read_bytes, to_plain, write_file


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
        rows = []
        lines = read_bytes(self._path).splitlines() if self._path.is_file() else ()
        for line in lines:
            with contextlib.suppress(FileError):
                rows.append(parse_json(line, self._path, {"step": int}))
        return rows

    def roll_back(self, step: int) -> None:
        """Drops the rows that come after `step`."""
        if self._path.is_file() and not self._stays:
            rows = (json.dumps(row) for row in self.read() if row["step"] <= step)
            write_file(self._path, "".join(row + "\n" for row in rows))
