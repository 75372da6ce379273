"""Rows of a benchmark as a table for people, and as JSON and CSV files that appear whole."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.files import write_file

# (heading, key, format) of the columns; a key of a dict within the row is written a.b.
RENDER_COLUMNS = (
    ("scene", "name", ""),
    ("isa", "isa", ""),
    ("thr", "threads", "d"),
    ("pairs/px", "pairs_per_pixel", ".1f"),
    ("forward ms", "forward_ms", ".1f"),
    ("blend ms", "blend_ms", ".1f"),
    ("cpu", "blend_cpu_ms", ".1f"),
    ("x scalar", "blend_cpu_speedup", ".0f"),
    ("backward ms", "backward_ms", ".1f"),
    ("tiles ms", "backward_tiles_ms", ".1f"),
    ("cpu", "backward_tiles_cpu_ms", ".1f"),
    ("x scalar", "backward_tiles_cpu_speedup", ".0f"),
    ("step ms", "step_ms", ".1f"),
    ("cpu", "step_cpu_ms", ".1f"),
    ("image rms", "image_rms_error", ".1e"),
    ("gradients", "gradient_relative_error", ".1e"),
)


def table_text(rows: Sequence[dict[str, Any]], columns: Sequence[tuple[str, str, str]]) -> str:
    """The rows as lines of aligned text; what is null is a dash."""
    cells = [[heading for heading, _, _ in columns]]
    for row in rows:
        flat = _flattened(row)
        cells.append([_cell(flat.get(key), form) for _, key, form in columns])
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    left = [form == "" for _, _, form in columns]
    lines = [
        "  ".join(
            cell.ljust(width) if to_left else cell.rjust(width)
            for cell, width, to_left in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in cells
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def _cell(value: Any, form: str) -> str:
    return "-" if value is None else format(value, form)


def write_json(path: str | os.PathLike[str], rows: Any) -> None:
    """The rows as a JSON file."""
    text = json.dumps(rows, indent=2, allow_nan=False) + "\n"
    write_file(path, text)


def read_rows(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """The rows that `write_json` wrote; none where there is no such file.

    Raises:
        InputError: the file cannot be read or holds something else.
    """
    if not Path(path).exists():
        return []
    try:
        rows = json.loads(Path(path).read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {error}; remove it or leave --resume out") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path} holds no rows of a benchmark; name another file with --json")
    return rows


def write_csv(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """The rows as a CSV file: a heading, then one line a row; what is null is empty.

    A dict within a row becomes one column an entry, named a.b.
    """
    flat = [_flattened(row) for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    write_file(path, buffer.getvalue())


def _flattened(row: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, dict):
            flat |= _flattened(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat
